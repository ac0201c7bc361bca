"""The horizon's closed form against a search along rays, a sphere, and the nadirs against the geodetic formulas."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from simulator.sensors.horizon import (
    AZIMUTHS,
    Horizon,
    compute_limb_angle,
    compute_orbit_position,
)
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from tests.simulator.sensors.nadir import bisector_attitude, compute_penetrations, geocentric_nadir, geodetic_nadir

ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=0.7, latitude_argument=0.2)
TIMES = np.linspace(0.0, ORBIT.period, 361)
HORIZON = Horizon()


def between(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Angles between unit vectors, deg."""
    return np.rad2deg(np.linalg.norm(np.cross(u, v), axis=-1))


def turned(A: np.ndarray, rotation: list[float]) -> np.ndarray:
    """The attitude of a body turned from A by a rotation vector in body axes, rad."""
    return np.ascontiguousarray(Rotation.from_rotvec(-np.array(rotation)).as_matrix() @ A)


def searched_limb(A: np.ndarray, position: np.ndarray, azimuth: float, axes: np.ndarray) -> float:
    """Bisection on whether the point of the ray that is deepest in the ellipsoid is inside it."""

    def outside(eta: float) -> bool:
        d = A.T @ np.array([np.sin(eta) * np.cos(azimuth), np.sin(eta) * np.sin(azimuth), np.cos(eta)])
        depth = minimize_scalar(
            lambda x: (((position + x * 1e6 * d) / axes) ** 2).sum(),
            bounds=(0.0, 12.0),
            method="bounded",
            options={"xatol": 1e-9},
        )
        return bool(depth.fun > 1)

    low, high = 0.3, np.pi - 0.6
    assert not outside(low)
    assert outside(high)
    while high - low > 1e-12:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if outside(middle) else (middle, high)
    return low


def test_limb_is_where_rays_begin_to_miss():
    rng = np.random.default_rng(1)
    axes = np.array([*HORIZON.semi_axes[:1] * 2, HORIZON.semi_axes[1]])
    for tilt in (0.0, 0.02, 0.1, 0.45):  # the last takes some lines of sight beyond 90 deg from +z
        t = rng.uniform(0, ORBIT.period, 3)
        for A, position in zip(compute_lvlh_attitude(ORBIT, t), compute_orbit_position(ORBIT, t), strict=True):
            A = turned(A, [*tilt * rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
            azimuth = rng.uniform(0, 2 * np.pi)
            eta = compute_limb_angle(A, position, np.cos(azimuth), np.sin(azimuth), *HORIZON.semi_axes)
            # The depth's rounding, 1e-16, moves the limb by about as much over its slope, 2 k^(1/2) = 0.6.
            assert eta == pytest.approx(searched_limb(A, position, azimuth, axes), abs=3e-11)


def test_bisector_is_a_hundredth_of_a_degree_from_geodetic_nadir():
    """R: "approximately 0.01 deg". Here 0.0081 deg at most and 0.0060 RMS, against 0.163 deg from geocentric nadir."""
    A, position = compute_lvlh_attitude(ORBIT, TIMES), compute_orbit_position(ORBIT, TIMES)
    start = np.stack([turned(matrix, [0.0, 0.0, 0.6]) for matrix in A])
    pointed = bisector_attitude(start, position, HORIZON)
    y = compute_penetrations(pointed, position, *HORIZON.semi_axes, HORIZON.nominal)
    np.testing.assert_allclose(y @ np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=1), 0.0, atol=1e-13)
    bisector = pointed[:, 2]
    geodetic = between(bisector, geodetic_nadir(position))
    geocentric = between(bisector, geocentric_nadir(position))
    assert geodetic.max() == pytest.approx(0.0081, abs=1e-4)
    assert np.sqrt((geodetic**2).mean()) == pytest.approx(0.0060, abs=1e-4)
    assert geocentric.max() == pytest.approx(0.1633, abs=2e-4)
    assert between(geodetic_nadir(position), geocentric_nadir(position)).max() == pytest.approx(0.1713, abs=2e-4)
