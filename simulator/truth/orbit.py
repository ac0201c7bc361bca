"""Circular orbit, and the local frame (LVLH) whose attitude and rate a pointing mode follows.

With the argument of latitude u = u₀ + n t, node Ω = Ω₀ + Ω' t and inclination i, the LVLH axes in inertial components are

    x = (−su cΩ − cu ci sΩ,  −su sΩ + cu ci cΩ,  cu si)        along the velocity
    y = (−si sΩ, si cΩ, −ci)                                    against the orbit normal
    z = (−cu cΩ + su ci sΩ,  −cu sΩ − su ci cΩ,  −su si)        to nadir

and are the rows of A_li(t). The frame turns at n about the normal −y and at Ω' about the inertial pole k. Since
k·x = cu si, k·y = −ci, k·z = −su si, its rate in its own axes is

    ω_li = −(n + Ω' ci) y + Ω' si (cu x − su z)

Without J2, Ω' = 0 and the rate is −n about y: −1 RPO. With J2, Ω' = −1.5 n J2 (R/a)² ci. J2's change of the rate of u
(a few 1e-3 of n) is left out on purpose: it would act as a slightly different altitude and nothing else.
"""

from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array

MU = 3.986004418e14  # m³/s², WGS 84
EARTH_RADIUS = 6378137.0  # m, equatorial, WGS 84
J2 = 1.08262668e-3


@dataclass(frozen=True)
class CircularOrbit:
    """Circular orbit about the Earth."""

    altitude: float  # m above the equatorial radius
    inclination: float  # rad
    node: float = 0.0  # right ascension of the ascending node at the epoch, rad
    latitude_argument: float = 0.0  # argument of latitude at the epoch, rad
    j2: bool = False  # whether the node regresses
    # whether pointing modes hold z to geodetic nadir, see `simulator.truth.nadir`; to the Earth's centre otherwise
    geodetic: bool = False

    @property
    def radius(self) -> float:
        """Distance from the Earth's centre a, m."""
        return EARTH_RADIUS + self.altitude

    @property
    def mean_motion(self) -> float:
        """Kepler's n = sqrt(μ/a³), rad/s; 1 RPO."""
        return float(np.sqrt(MU / self.radius**3))

    @property
    def period(self) -> float:
        """2π/n, s."""
        return 2 * np.pi / self.mean_motion

    @property
    def nodal_rate(self) -> float:
        """Ω', rad/s; zero without J2."""
        if not self.j2:
            return 0.0
        return float(-1.5 * self.mean_motion * J2 * (EARTH_RADIUS / self.radius) ** 2 * np.cos(self.inclination))


def compute_lvlh_attitude(orbit: CircularOrbit, t: Array) -> Array:
    """Compute attitude matrices A_li, inertial to LVLH; (n,) s since the epoch → (n, 3, 3)."""
    u, node = orbit.latitude_argument + orbit.mean_motion * t, orbit.node + orbit.nodal_rate * t
    cu, su, cn, sn = np.cos(u), np.sin(u), np.cos(node), np.sin(node)
    ci, si = np.cos(orbit.inclination), np.sin(orbit.inclination)
    out = np.empty((*np.shape(t), 3, 3))
    out[..., 0, :] = np.stack([-su * cn - cu * ci * sn, -su * sn + cu * ci * cn, cu * si], axis=-1)
    out[..., 1, :] = np.stack([-si * sn, si * cn, np.full_like(u, -ci)], axis=-1)
    out[..., 2, :] = np.stack([-cu * cn + su * ci * sn, -cu * sn - su * ci * cn, -su * si], axis=-1)
    return out


def compute_lvlh_rate(orbit: CircularOrbit, t: Array) -> Array:
    """Compute the inertial rate of the LVLH frame in its own axes, rad/s; (n,) s since the epoch → (n, 3)."""
    out = np.zeros((*np.shape(t), 3))
    out[..., 1] = -(orbit.mean_motion + orbit.nodal_rate * np.cos(orbit.inclination))
    if orbit.j2:
        u = orbit.latitude_argument + orbit.mean_motion * t
        across = orbit.nodal_rate * np.sin(orbit.inclination)
        out[..., 0], out[..., 2] = across * np.cos(u), -across * np.sin(u)
    return out
