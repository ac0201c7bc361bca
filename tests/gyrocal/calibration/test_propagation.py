"""ψ, R and Θ against integrals, finite differences, another implementation and each other."""

import gtsam
import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.spatial.transform import Rotation

from gyrocal import Arcs, StreamingPropagation, propagate, psi_matrix
from gyrocal.calibration.increment_packing import LANES, is_unbroken
from gyrocal.calibration.propagation import PSI_SERIES_LIMIT

RNG = np.random.default_rng(20)
G = np.eye(3) + 1e-3 * RNG.normal(size=(3, 3))
BIAS = 1e-5 * RNG.normal(size=3)


def arcs_of(raw, dt, outputs):
    """Arcs from a list of lists of step counts, one list per arc; arcs follow each other."""
    first, last, arc, offset = [], [], [], 0
    for number, ends in enumerate(outputs):
        edges = [0, *ends]
        first += [offset + e for e in edges[:-1]]
        last += [offset + e for e in edges[1:]]
        arc += [number] * len(ends)
        offset += ends[-1]
    return Arcs(raw, dt, np.arange(len(dt)), np.array(first), np.array(last), np.array(arc))


def stream(n, size=0.01, rng=RNG):
    return np.cumsum(rng.normal(size=(n, 3)), axis=0) / np.sqrt(n) * size + rng.normal(size=(n, 3)) * 1e-3, np.full(n, 0.5)


def streamed(raw, dt, psi="full"):
    propagation = StreamingPropagation(G, BIAS, psi)
    for rate, step in zip(raw, dt, strict=True):
        propagation.update(rate, step)
    return propagation


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.05, 0.0999999, 0.1000001, 0.7, 6.0])
def test_psi_is_its_integral(angle):
    omega = np.array([0.36, -0.48, 0.8]) * angle / 0.5
    integral, _ = quad_vec(lambda tau: Rotation.from_rotvec(-omega * tau).as_matrix(), 0, 0.5, epsabs=1e-15, epsrel=1e-14)
    np.testing.assert_allclose(psi_matrix(omega, 0.5), integral, atol=2e-15)


@pytest.mark.parametrize("psi", ["full", "linear"])
@pytest.mark.parametrize("size", [0.01, 0.5])  # below the series' limit, and across it
def test_compiled_pass_equals_the_streaming_recursion(psi, size):
    raw, dt = stream(700, size)
    outputs = [[1, 40, 333], [9], [300, 358]]
    result = propagate(arcs_of(raw, dt, outputs), G, BIAS, psi)
    offset, row = 0, 0
    for ends in outputs:
        for end in ends:
            expected = streamed(raw[offset : offset + end], dt[offset : offset + end], psi)
            np.testing.assert_allclose(result.R[row], expected.R, atol=1e-12)
            np.testing.assert_allclose(result.Theta[row], expected.Theta, rtol=0, atol=1e-12 * np.abs(expected.Theta).max())
            row += 1
        offset += ends[-1]
    assert size < 0.1 or np.linalg.norm(raw * 0.5, axis=1).max() > PSI_SERIES_LIMIT


@pytest.mark.parametrize("n", [1, 2, LANES - 1, LANES, LANES + 1, 3 * LANES + 5])
def test_every_length_fills_the_lanes_rightly(n):
    raw, dt = stream(n)
    dt = dt * np.linspace(0.5, 1.5, n)
    result = propagate(arcs_of(raw, dt, [[n]]), G, BIAS)
    expected = streamed(raw, dt)
    np.testing.assert_allclose(result.R[0], expected.R, atol=1e-13)
    np.testing.assert_allclose(result.Theta[0], expected.Theta, atol=1e-12)


def test_rates_and_durations_of_any_layout_and_kind_are_read():
    # The packing reads memory by its address.
    raw, dt = stream(3 * LANES + 5)
    counts = np.round(1e6 * raw).astype(np.float32)
    other = arcs_of(np.asfortranarray(counts), np.repeat(dt, 2)[::2], [[len(dt)]])
    np.testing.assert_array_equal(other.increments, arcs_of(counts.astype(float), dt, [[len(dt)]]).increments)


def test_samples_left_out_or_held_twice_break_a_piece():
    starts, lengths = np.array([0, 4]), np.array([4, 4])
    # Between pieces a sample may be held again: a reference cuts it in two.
    assert is_unbroken(np.array([5, 6, 7, 8, 8, 9, 10, 11]), starts, lengths)
    assert not is_unbroken(np.array([5, 6, 6, 8, 8, 9, 10, 11]), starts, lengths)
    assert not is_unbroken(np.array([5, 6, 7, 8, 8, 9, 10, 12]), starts, lengths)


def test_theta_is_the_derivative_of_the_attitude():
    raw, dt = stream(400)
    arcs = arcs_of(raw, dt, [[400]])
    base = propagate(arcs, G, BIAS)
    derivative = np.empty((3, 12))
    for k in range(12):
        h = 1e-6 if k < 9 else 1e-8
        turned = []
        for sign in (1, -1):
            x = np.concatenate([G.ravel(), BIAS])
            x[k] += sign * h
            turned.append(propagate(arcs, x[:9].reshape(3, 3), x[9:]).R[0])
        # A_prop → exp(-[Θ dx ×]) A_prop, so θ = log(A A_propᵀ) grows by Θ dx.
        derivative[:, k] = Rotation.from_matrix(turned[1] @ turned[0].T).as_rotvec() / (2 * h)
    scale = np.abs(base.Theta[0]).max(axis=0)
    np.testing.assert_allclose(derivative / scale, base.Theta[0] / scale, atol=2e-7)


def test_bias_columns_agree_with_gtsam_preintegration():
    raw, dt = stream(500, 0.02)
    integration = gtsam.PreintegratedRotation(gtsam.PreintegratedRotationParams())
    for rate, step in zip(raw, dt, strict=True):
        integration.integrateGyroMeasurement(rate, np.zeros(3), step)
    result = propagate(arcs_of(raw, dt, [[500]]), np.eye(3), np.zeros(3))
    active = integration.deltaRij().matrix()  # body(t) to body(0)
    np.testing.assert_allclose(result.R[0], active.T, atol=1e-12)
    # gtsam: ∂ log(delta R)/∂(gyro bias) in the end frame, for rates measured minus bias; ours is for rates plus b.
    np.testing.assert_allclose(result.Theta[0][:, 9:], -integration.delRdelBiasOmega(), rtol=0, atol=1e-9)
