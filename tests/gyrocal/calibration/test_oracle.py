"""The calibrator against one that shares nothing with it: ψ by quadrature, its own columns and normal equations."""

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.spatial.transform import Rotation

from gyrocal import GyroParameters, InputError, UnobservableError, calibrate
from gyrocal.calibration.gyro_space import (
    GYRO_NAMES,
    SPACES,
    compute_gyro_jacobian,
    convert_from_gyro_space,
    convert_to_gyro_space,
)
from tests.builders import PLAN, TRUTH, piecewise_recording

PRELAUNCH = GyroParameters(
    np.eye(3) + np.deg2rad([[0, -0.036, 0.006], [0.059, 0, -0.033], [0.005, 0.03, 0]]), np.deg2rad([-1.41e-4, 1.58e-4, 0.86e-4])
)
NODES, WEIGHTS = leggauss(10)
ARW = np.deg2rad(2e-4)


@pytest.fixture(scope="module")
def noisy():
    return piecewise_recording(arw=ARW, rng=np.random.default_rng(12), sample_s=10.0, series_s=300.0)


def columns(space, raw, G, bias):
    """F (n, 3, 12) of each step, from the gyro equation alone."""
    n, identity = len(raw), np.eye(3)
    if space == "gain":
        parts = [raw[:, [j]] * identity[i] for i in range(3) for j in range(3)]
        return np.stack([*parts, *np.broadcast_to(identity[:, None], (3, n, 3))], axis=2)
    # ω = K⁻¹ (ω_raw − c): implicit differentiation of s_i (u_i · ω) + c_i = ω_raw,i.
    K = np.linalg.inv(G)
    omega = np.linalg.solve(K, (raw + K @ bias).T).T
    scale = np.sqrt((K**2).sum(axis=1))
    out = np.empty((n, 3, 12))
    for i in range(3):
        u = K[i] / scale[i]
        for j in range(3):
            along = u if i == j else scale[i] * (identity[j] - u[j] / u[i] * identity[i])
            out[:, :, 3 * i + j] = -np.linalg.solve(K, identity[i]) * (omega @ along)[:, None]
        out[:, :, 9 + i] = -np.linalg.solve(K, identity[i])
    return out


def psi_by_quadrature(omega, dt, linear):
    """∫₀^Δt exp(−[ω×]τ) dτ, (n, 3, 3)."""
    if linear:
        return dt * np.broadcast_to(np.eye(3), (len(omega), 3, 3))
    return sum(
        0.5 * dt * w * Rotation.from_rotvec(-omega * 0.5 * dt * (1 + x)).as_matrix()
        for x, w in zip(NODES, WEIGHTS, strict=True)
    )


def evaluated(recording, space, G, bias, linear):
    """Residuals (3m,), Θ (3m, 12) and V (3m, 3m) of a recording whose references fall on its samples, interval by interval."""
    theta, Theta, V = [], [], []
    t_ref, q, sigma = recording.attitudes.t_s, recording.attitudes.quaternions, recording.attitudes.sigma
    for interval in recording.intervals:
        rows = np.flatnonzero((t_ref >= interval.start_s - 1e-6) & (t_ref <= interval.stop_s + 1e-6))
        A = Rotation.from_quat(q[rows]).inv().as_matrix()
        inside = (recording.gyro.t_s > interval.start_s - 1e-6) & (recording.gyro.t_s < interval.stop_s - 1e-6)
        raw, t, dt = recording.gyro.rates[inside], recording.gyro.t_s[inside], recording.gyro.sample_s
        omega = raw @ G.T + bias
        steps = Rotation.from_rotvec(-omega * dt).as_matrix()
        moved = psi_by_quadrature(omega, dt, linear) @ columns(space, raw, G, bias)
        R, sensitivity, turns, spans = np.eye(3), np.zeros((3, 12)), [], []
        for k in range(len(raw)):
            R, sensitivity = steps[k] @ R, moved[k] + steps[k] @ sensitivity
            at = np.flatnonzero(np.abs(t_ref[rows] - t[k] - dt) < 1e-6)
            if at.size:
                theta.append(Rotation.from_matrix(A[at[0]] @ (R @ A[0]).T).as_rotvec())
                Theta.append(sensitivity)
                turns.append(R)
                spans.append((at[0], t[k] + dt - interval.start_s))
        block = np.zeros((3 * len(turns), 3 * len(turns)))
        for a, (row_a, T_a) in enumerate(spans):
            for b, (_, T_b) in enumerate(spans):
                value = turns[a] @ (np.diag(sigma[rows[0]] ** 2) + ARW**2 * min(T_a, T_b) * np.eye(3)) @ turns[b].T
                block[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] = value + (a == b) * np.diag(sigma[rows[row_a]] ** 2)
        V.append(block)
    return np.concatenate(theta), np.concatenate(Theta), V


def oracle(recording, space, iterations, linear=False):
    """G and b by the normal equations of each iteration, in parameters of their own and at a scale of their own."""
    G, bias = PRELAUNCH.G, PRELAUNCH.bias
    size = np.array([1e-3] * 9 + [1e-6] * 3)
    for _ in range(iterations):
        theta, Theta, V = evaluated(recording, space, G, bias, linear)
        N, u, low = np.zeros((12, 12)), np.zeros(12), 0
        for block in V:
            high = low + len(block)
            H = Theta[low:high] * size
            N += H.T @ np.linalg.solve(block, H)
            u += H.T @ np.linalg.solve(block, theta[low:high])
            low = high
        step = size * np.linalg.solve(N, u)
        if space == "gain":
            G, bias = G - step[:9].reshape(3, 3), bias - step[9:]
        else:
            K = np.linalg.inv(G)
            scale = np.sqrt((K**2).sum(axis=1))
            axes, offset = K / scale[:, None], -K @ bias - step[9:]
            for i in range(3):
                others = [j for j in range(3) if j != i]
                axes[i, others] -= step[3 * i : 3 * i + 3][others]
                axes[i, i] = np.sqrt(1 - np.sum(axes[i, others] ** 2))
                scale[i] -= step[4 * i]
            G = np.linalg.inv(np.diag(scale) @ axes)
            bias = -G @ offset
    return G, bias


def flat(theta):
    return np.asarray(theta).ravel()


@pytest.mark.parametrize("space", ["gain", "gyro"])
@pytest.mark.parametrize("psi", ["full", "linear"])
def test_the_independent_implementation_agrees(noisy, space, psi):
    G, bias = oracle(noisy, space, 2, psi == "linear")
    result = calibrate(noisy, initial=PRELAUNCH, iterations=2, psi=psi, parametrisation=space)
    np.testing.assert_allclose(result.G, G, rtol=0, atol=1e-13)
    np.testing.assert_allclose(result.bias, bias, rtol=0, atol=1e-16)
    theta = evaluated(noisy, space, G, bias, psi == "linear")[0]
    after = result.residuals[["after_roll_deg", "after_pitch_deg", "after_yaw_deg"]]
    np.testing.assert_allclose(flat(after), np.rad2deg(flat(theta)), rtol=0, atol=1e-11)


def test_one_gyro_is_calibrated_alone():
    """Only this gyro is off: its own scale factor, axis and bias bring all of G and b back; row i of G does not."""
    recording = piecewise_recording()
    y = convert_to_gyro_space(TRUTH)
    own = [3, 4, 5, 10]
    y[own] += [1e-3, -1.5e-3, 2e-3, 1e-6]
    off = convert_from_gyro_space(y)
    gyro = calibrate(recording, initial=off, solve_for="gyro_y", parametrisation="gyro")
    assert gyro.solved_for == tuple(GYRO_NAMES[k] for k in own)
    assert gyro.converged
    np.testing.assert_allclose(gyro.G, TRUTH.G, rtol=0, atol=1e-11)
    np.testing.assert_allclose(gyro.bias, TRUTH.bias, rtol=0, atol=1e-14)
    held = [k for k in range(12) if k not in own]
    np.testing.assert_allclose(convert_to_gyro_space(gyro.parameters)[held], y[held], rtol=0, atol=1e-14)
    assert (np.flatnonzero(np.diag(gyro.own_covariance)) == sorted(own)).all()
    row = calibrate(recording, initial=off, solve_for="gyro_y")
    assert np.abs(row.G - TRUTH.G).max() > 1e-7


def test_jacobian_is_the_derivative():
    y, h = convert_to_gyro_space(PRELAUNCH), np.array([1e-4] * 9 + [1e-6] * 3)
    for k in range(12):
        step = h[k] * np.eye(12)[k]
        # Central differences, Richardson's: exact to the fifth order.
        once, twice = (
            (convert_from_gyro_space(y + m * step).vector - convert_from_gyro_space(y - m * step).vector) / (2 * m * h[k])
            for m in (1, 2)
        )
        np.testing.assert_allclose(compute_gyro_jacobian(PRELAUNCH)[:, k], (4 * once - twice) / 3, rtol=0, atol=2e-11)
    np.testing.assert_array_equal(SPACES["gain"].jacobian(PRELAUNCH), np.eye(12))


def test_what_gyro_space_cannot_describe_is_refused():
    recording = piecewise_recording()
    swapped = GyroParameters(np.eye(3)[[1, 0, 2]], np.zeros(3))
    with pytest.raises(InputError, match="axis of gyro x, y is more than 84 deg"):
        calibrate(recording, initial=swapped, parametrisation="gyro")
    with pytest.raises(InputError, match=r"unknown parameter 'G_xx'; known: all, .*s_x, u_xy"):
        calibrate(recording, parametrisation="gyro", solve_for="G_xx")


def test_what_is_free_is_named_in_the_parameters_of_gyro_space():
    plan = tuple((((0.0, -0.001, 0.0), 600.0 + 60 * k),) for k in range(6))
    recording = piecewise_recording(plan, arw=ARW, rng=np.random.default_rng(8))
    result = calibrate(recording, solve_for="s_y,c_y", parametrisation="gyro")
    (name,) = result.observability.unobservable
    assert name.startswith("1 s_y + ")
    assert name.endswith("deg/s c_y")
    with pytest.raises(UnobservableError, match=r"in s and u, .* deg/h in c"):
        calibrate(piecewise_recording(PLAN[1:2], sigma_deg=20.0), parametrisation="gyro")
