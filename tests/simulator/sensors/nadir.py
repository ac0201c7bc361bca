"""Directions to the Earth that tests hold the horizon and the on-board attitude against."""

import numpy as np

from gyrocal.attitude import rotation_matrix
from simulator.sensors.horizon import COSINES, FLATTENING, SINES, compute_penetration
from simulator.truth.orbit import EARTH_RADIUS


def geocentric_nadir(position):
    """Unit vectors to the Earth's centre, inertial, of positions (..., 3) in m."""
    return np.asarray(-position / np.linalg.norm(position, axis=-1, keepdims=True))


def geodetic_nadir(position):
    """Unit vectors along the inward normal of WGS 84, inertial, at positions (..., 3) in m outside the ellipsoid."""
    # In units of the equatorial radius; Newton from the left of the root of a convex function never overshoots it.
    axes = np.array([1.0, 1.0, (1 - FLATTENING) ** 2])
    squares = (np.asarray(position, dtype=float) / EARTH_RADIUS) ** 2
    multiplier = np.zeros((*squares.shape[:-1], 1))
    for _ in range(8):
        terms = squares * axes / (axes + multiplier) ** 2
        slope = -2 * (terms / (axes + multiplier)).sum(axis=-1, keepdims=True)
        multiplier = multiplier - (terms.sum(axis=-1, keepdims=True) - 1) / slope
    normal = position / (axes + multiplier)
    return np.asarray(-normal / np.linalg.norm(normal, axis=-1, keepdims=True))


def compute_penetrations(A, position, a, c, nominal):
    """True penetration angles (n, 4), rad, of attitudes (n, 3, 3) at positions (n, 3), m."""
    return np.array([[compute_penetration(*one, i, a, c, nominal) for i in range(4)] for one in zip(A, position, strict=True)])


def bisector_attitude(A, position, horizon):
    """Attitudes (n, 3, 3) within a few degrees of A for which four quadrants without error show no roll and no pitch."""
    A = np.array(A, dtype=float)
    for _ in range(10):  # each round leaves about a hundredth of the error
        y = compute_penetrations(A, np.ascontiguousarray(position, dtype=float), *horizon.semi_axes, horizon.nominal)
        turn = np.stack([0.5 * y @ SINES, -0.5 * y @ COSINES, np.zeros(len(y))], axis=-1)
        A = rotation_matrix(turn) @ A
    return A
