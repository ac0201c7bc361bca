"""Head compensation: (c, d) against the simulator's geometry, and the published numbers that do not follow from it."""

import numpy as np

import simulator.sensors.sun as truth
from gyrocal.sensors.head_compensation import HEAD_ANGLES, PUBLISHED_COMPENSATION, compute_compensation

DEG = np.pi / 180
BETA = np.linspace(-20, 38.4, 30) * DEG  # at the yaw update, for the default tilt


def test_compensation_at_one_alpha_is_exact():
    head = np.array([0.2, -0.1, 0.15])  # large: nothing of it is first order
    for alpha in (-0.6, 0.0, 0.3):
        found = compute_compensation(head, alpha)
        seen = np.arctan([truth.compute_head_tangents(np.tan(alpha), np.tan(beta), 1.0, head)[1] for beta in BETA])
        np.testing.assert_allclose(np.arctan(found.c * np.tan(seen - head[2]) + found.d), BETA, atol=1e-13)


def test_in_the_plane_of_the_yaw_update_nothing_is_left_to_compensate():
    """R's own conditions, the α axis as reference and the Sun in the XY plane, with the boresight in that plane."""
    for name, limit in (("DSS-1", 0.5e-6), ("DSS-2", 6.5e-6)):
        found = compute_compensation(HEAD_ANGLES[name], 0.0)
        assert abs(found.c - 1) < limit
        assert abs(found.d) < limit
        assert abs(PUBLISHED_COMPENSATION[name].c - 1) > 20e-6
        assert abs(PUBLISHED_COMPENSATION[name].d) > 50e-6
