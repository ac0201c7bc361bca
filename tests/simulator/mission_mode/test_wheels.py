import numpy as np
import pytest

from simulator.mission_mode.wheels import build_wheel_pyramid, compute_unloading_moment, distribute

W = build_wheel_pyramid()
INVERSE = np.ascontiguousarray(np.linalg.pinv(W))
EMPTY = np.zeros(4)
TORQUE = np.array([0.05, -0.12, 0.2])


def wheel_torques(torque, momentum=EMPTY, torque_limit=1e3, momentum_limit=1e3):
    out = np.empty(4)
    distribute(torque, INVERSE, np.array(momentum), torque_limit, momentum_limit, 0.5, out)
    return out


def test_distribution_gives_the_torque_with_the_least_squares():
    out = wheel_torques(TORQUE)
    assert -W @ out == pytest.approx(TORQUE, abs=1e-15)
    null = np.array([1.0, -1.0, 1.0, -1.0])
    assert np.abs(W @ null).max() < 1e-15
    assert abs(out @ null) < 1e-15  # nothing spent on what gives no torque


def test_torque_limit_keeps_the_direction():
    out = wheel_torques(10 * TORQUE, torque_limit=0.1)
    assert np.abs(out).max() == pytest.approx(0.1)
    assert np.abs(np.cross(W @ out, TORQUE)).max() < 1e-15


def test_a_full_wheel_takes_no_more():
    full = -np.sign(INVERSE @ TORQUE) * 50.0  # every torque wanted would overfill its wheel
    assert wheel_torques(TORQUE, momentum=full, momentum_limit=50.0) == pytest.approx(np.zeros(4), abs=1e-15)
    assert np.abs(wheel_torques(TORQUE, momentum=-full, momentum_limit=50.0)).min() > 0  # the other way it works


def test_unloading_works_across_the_field():
    rng = np.random.default_rng(5)
    for h, B in zip(rng.normal(size=(20, 3)), 3e-5 * rng.normal(size=(20, 3)), strict=True):
        torque = np.cross(compute_unloading_moment(*h, *B, 1e-3, 1e9), B)
        along = B / np.linalg.norm(B)
        assert torque == pytest.approx(-1e-3 * (h - along * (along @ h)), abs=1e-15)
        assert torque @ h < 0
