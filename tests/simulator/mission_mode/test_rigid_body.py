import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.mission_mode.rigid_body import step_rigid_body
from simulator.mission_mode.wheels import build_wheel_pyramid, compute_unloading_moment, distribute_torque
from simulator.truth.rotation import convert_to_matrix, convert_to_quaternion, separation

INERTIA = np.array([[8500.0, 40.0, -120.0], [40.0, 6000.0, 60.0], [-120.0, 60.0, 9500.0]])
Q = np.array([0.1, -0.3, 0.2, 0.927])
Q = Q / np.linalg.norm(Q)
OMEGA = np.array([0.02, -0.03, 0.05])
N = 1.144e-3
NONE = np.zeros(3)
DOWN, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


def run(steps, dt, *, inertia=INERTIA, omega=OMEGA, h=NONE, torque=NONE, wheel=None, gradient=0.0, q=Q):
    """States after each step: q, ω, h; the orbit starts over the x axis, in the xz plane; wheel(k) is w."""
    q, omega, h, turned = q.copy(), np.array(omega, dtype=float), np.array(h, dtype=float), np.zeros(3)
    out = [(q.copy(), omega.copy(), h.copy())]
    inverse = np.linalg.inv(inertia)
    for k in range(steps):
        c, s = np.cos(N * k * dt), np.sin(N * k * dt)
        nadir, velocity = c * DOWN - s * AHEAD, c * AHEAD + s * DOWN
        w = NONE if wheel is None else wheel(k)
        step_rigid_body(q, omega, h, inertia, inverse, torque, w, nadir, velocity, N, gradient, dt, turned)
        out.append((q.copy(), omega.copy(), h.copy()))
    return [np.array(x) for x in zip(*out, strict=True)], turned


def momentum(q, omega, h):
    """Inertial angular momentum Aᵀ (I ω + h)."""
    return np.einsum("nji,nj->ni", convert_to_matrix(q), omega @ INERTIA.T + h)


def equations(t, y):
    """(1) and (2) written anew, with A carried as a matrix."""
    A, omega, h = y[:9].reshape(3, 3), y[9:12], y[12:]
    z = A @ (np.cos(N * t) * DOWN - np.sin(N * t) * AHEAD)
    outer = np.array([0.02, -0.01, 0.03]) + 3 * N**2 * np.cross(z, INERTIA @ z)
    w = np.array([0.1, 0.05, -0.2])
    rate = np.linalg.solve(INERTIA, outer - w - np.cross(omega, INERTIA @ omega + h))
    return np.concatenate([-np.cross(omega, A, axisb=0, axisc=0).ravel(), rate, w])


def test_against_another_integrator():
    start = np.concatenate([convert_to_matrix(Q).ravel(), OMEGA, [1.0, 2.0, -3.0]])
    end = solve_ivp(equations, (0, 100), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    options = {
        "h": [1.0, 2.0, -3.0],
        "torque": np.array([0.02, -0.01, 0.03]),
        "wheel": lambda k: np.array([0.1, 0.05, -0.2]),
        "gradient": 3 * N**2,
    }
    (q, omega, h), turned = run(400, 0.25, **options)
    assert np.abs(separation(convert_to_quaternion(end[:9].reshape(3, 3)), q[-1])).max() < 1e-9
    assert omega[-1] == pytest.approx(end[9:12], abs=1e-11)
    assert h[-1] == pytest.approx(end[12:], abs=1e-10)
    (_, fine, _), _ = run(1600, 0.0625, **options)
    weights = np.ones(1601)
    weights[1:-1:2], weights[2:-1:2] = 4.0, 2.0
    assert turned == pytest.approx(weights @ fine * 0.0625 / 3, abs=1e-8)


def test_pitch_libration():
    """A small pitch angle from LVLH swings at n sqrt(3 (I_x − I_z)/I_y); without gradient (negative control) it stays."""
    inertia, angle = np.diag([9000.0, 8000.0, 5000.0]), 1e-3
    period = 2 * np.pi / (N * np.sqrt(3 * (9000 - 5000) / 8000))
    steps = round(period)
    start = np.array([0.0, np.sin(angle / 2), 0.0, np.cos(angle / 2)])

    def pitch(gradient):
        # A fixed q turns with the orbit: ω = −n about y.
        (q, _, _), _ = run(steps, 1.0, inertia=inertia, omega=[0.0, -N, 0.0], gradient=gradient, q=start)
        A = convert_to_matrix(q)
        c, s = np.cos(N * np.arange(steps + 1)), np.sin(N * np.arange(steps + 1))
        z = np.einsum("nij,nj->ni", A, c[:, None] * DOWN - s[:, None] * AHEAD)
        return np.arctan2(-z[:, 0], z[:, 2])

    swing = pitch(3 * N**2)
    assert swing == pytest.approx(angle * np.cos(2 * np.pi * np.arange(steps + 1) / period), abs=2e-3 * angle)
    assert np.abs(pitch(0.0) - angle).max() < 1e-9


W = build_wheel_pyramid()
INVERSE = np.ascontiguousarray(np.linalg.pinv(W))
EMPTY = np.zeros(4)
TORQUE = np.array([0.05, -0.12, 0.2])


def wheel_torques(torque, momentum=EMPTY, torque_limit=1e3, momentum_limit=1e3):
    out = np.empty(4)
    distribute_torque(torque, INVERSE, np.array(momentum), torque_limit, momentum_limit, 0.5, out)
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


def test_moment_limit_keeps_the_direction():
    free, short = (np.array(compute_unloading_moment(5.0, -2.0, 1.0, 2e-5, 1e-5, -3e-5, 1e-2, top)) for top in (1e9, 50.0))
    assert short == pytest.approx(free * 50.0 / np.abs(free).max())
