"""Direction of the Sun, Julian dates, and eclipses by the Earth.

The Sun's apparent ecliptic longitude by the Astronomical Almanac's low-precision formula ("Low precision formulas for the
Sun", its section C), with n days since J2000.0:

    L = 280.460° + 0.9856474° n    (mean longitude, corrected for aberration)
    g = 357.528° + 0.9856003° n    (mean anomaly)
    λ = L + 1.915° sin g + 0.020° sin 2g,    latitude 0
    ε = 23.439° − 0.0000004° n
    s = (cos λ, cos ε sin λ, sin ε sin λ)    in the mean equator and equinox of date

It is stated to 0.01° between 1950 and 2050, where it stays within 0.011° of ERFA's apparent Sun (0.0033° RMS). In 64 s, the
difference between dynamical and universal time in 1999, the Sun moves by 0.0007°, so any of the time scales will do. Seen
from an orbit instead of the Earth's centre the Sun moves by 0.0026° at most, which is left out.

The shadow is a cylinder behind a sphere of the equatorial radius. The umbra's cone and the penumbra, ± 11 km where a 350 km
orbit crosses the shadow's edge, or ± 1.5 s, are left out, and so are the atmosphere and the oblateness (21 km at the poles).
"""

from datetime import UTC, datetime

import numpy as np

from gyrocal.arrays import Array, Mask
from simulator.truth.orbit import EARTH_RADIUS

J2000 = 2451545.0  # Julian date of 2000-01-01 12:00
DAY = 86400.0  # s


def compute_julian_date(epoch: str | datetime) -> float:
    """Compute the Julian date of a moment, in its own time scale, days, good to 40 µs; without a time zone as it stands."""
    moment = datetime.fromisoformat(epoch) if isinstance(epoch, str) else epoch
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return J2000 + (moment - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / DAY


def compute_sun_vector(julian_date: Array | float) -> Array:
    """Compute unit vectors (..., 3) to the Sun in the mean equator and equinox of date, of `julian_date(epoch) + t / DAY`."""
    n = np.asarray(julian_date, dtype=float) - J2000
    g = np.deg2rad(357.528 + 0.9856003 * n)
    longitude = np.deg2rad(280.460 + 0.9856474 * n + 1.915 * np.sin(g) + 0.020 * np.sin(2 * g))
    obliquity = np.deg2rad(23.439 - 4e-7 * n)
    sine = np.sin(longitude)
    return np.stack([np.cos(longitude), np.cos(obliquity) * sine, np.sin(obliquity) * sine], axis=-1)


def is_eclipsed(position: Array, sun: Array) -> Mask:
    """Flag positions (..., 3), m from the Earth's centre, in its cylindrical shadow; sun: unit vectors (..., 3) to the Sun."""
    along = (position * sun).sum(axis=-1)
    across = np.linalg.norm(position - along[..., None] * sun, axis=-1)
    return np.asarray((along < 0) & (across < EARTH_RADIUS))
