"""Dates of the yaw maneuvers of Mission Mode: the Sun's angle to the orbit plane, and the days on which it passes zero.

R keeps the Sun on the −Y side of the spacecraft, between 0° and 58.4° from the XZ plane, by turning 180° about nadir "every
few weeks when the Sun crosses the orbit plane". Flying +x forward −Y is the orbit normal, flying −x forward its opposite, so
that with the Sun's direction s and the orbit normal N the angle

    β = asin(s·N)

is to be positive in the one and negative in the other. Its largest value is the inclination plus the obliquity, 58.4°.
"""

import numpy as np

from gyrocal.arrays import Array
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector

SEARCH_STEP_S = 3600.0  # s, of the search; β passes zero twice in 46 days


def compute_sun_angle(epoch: str, orbit: CircularOrbit, t: Array | float) -> Array:
    """Compute β of the Sun above the orbit plane, positive toward the orbit normal, rad; t (n,) s since the epoch."""
    times = np.asarray(t, dtype=float)
    normal = -compute_lvlh_attitude(orbit, times)[..., 1, :]
    return np.arcsin((normal * compute_sun_vector(compute_julian_date(epoch) + times / DAY)).sum(axis=-1))


def find_plane_crossings(epoch: str, orbit: CircularOrbit, days: float) -> Array:
    """Find the moments at which the Sun crosses the orbit plane, s since the epoch, ascending."""
    t = np.arange(0.0, days * DAY + SEARCH_STEP_S, SEARCH_STEP_S)
    beta = compute_sun_angle(epoch, orbit, t)
    before = np.flatnonzero(beta[:-1] * beta[1:] < 0)
    moments = t[before] - beta[before] * SEARCH_STEP_S / (beta[before + 1] - beta[before])
    return np.asarray(moments[moments < days * DAY])
