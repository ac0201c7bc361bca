"""Sun sensors: the truth against matrices, the estimator's model against finite differences, the two against each other."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import gyrocal.sensors.sun as ground
import simulator.sensors.sun as truth
from gyrocal.sensors.head_compensation import HEAD_ANGLES, PUBLISHED_COMPENSATION, compute_compensation
from gyrocal.sensors.series import SensorModel

ZERO = np.zeros(3)
SQUARE = (ZERO, ZERO)
M_DSS2 = np.array([[0.999996, -1.98736e-3, -1.99437e-3], [1.9928e-3, 0.999994, 2.7292e-3], [1.98893e-3, -2.73316e-3, 0.999994]])


def scene(sensor, rng, n, limit_deg=47.5):
    """Attitudes and inertial Sun vectors that put the Sun evenly over the tangents of a sensor's field of view."""
    a, b = np.tan(np.deg2rad(limit_deg)) * rng.uniform(-1, 1, (2, n))
    inside = np.column_stack([a, b, np.ones(n)]) / np.sqrt(a**2 + b**2 + 1)[:, None]
    A = Rotation.random(n, rng=rng).as_matrix()
    return A, np.einsum("nji,nj->ni", A, inside @ sensor.alignment.T), np.column_stack([a, b])


def compute_direction(angles):
    """Unit vectors O (n, 3) in the sensor frame of angles (α, β) (n, 2) rad, R (4)."""
    tangents = np.tan(angles)
    along = np.concatenate([tangents, np.ones((*tangents.shape[:-1], 1))], axis=-1)
    return np.asarray(along / np.linalg.norm(along, axis=-1, keepdims=True))


def kernel_tangents(s, head):
    return np.array([truth.compute_head_tangents(*row, head) for row in s])


def test_head_geometry_is_the_euler_sequence():
    """scipy's intrinsic YZX sequence is active, from head to sensor; its transpose changes components."""
    rng = np.random.default_rng(1)
    head = np.array([0.3, -0.2, 0.1])
    s = np.column_stack([rng.uniform(-0.5, 0.5, (50, 2)), np.ones(50)])
    turned = s @ Rotation.from_euler("YZX", head).as_matrix()
    expected = np.column_stack([s[:, 0] / s[:, 2], turned[:, 1] / turned[:, 2]])
    np.testing.assert_allclose(kernel_tangents(s, head), expected, rtol=1e-13)


@pytest.mark.parametrize("k", [truth.SIMULATED_ALPHA_COEFFICIENTS, truth.SIMULATED_BETA_COEFFICIENTS])
def test_counts_solve_the_transfer_function(k):
    for angle in np.deg2rad([-48.0, -20.0, 0.0, 3.7, 48.0]):

        def missing(N, angle=angle):
            return np.arctan(k[0] + k[1] * N + k[2] * np.sin(k[3] * N + k[4]) + k[5] * np.sin(k[6] * N + k[7])) + k[8] - angle

        expected = brentq(missing, 0, 16383, xtol=1e-9)
        assert truth.compute_counts(np.tan(angle), np.tan(angle), k, k)[0] == pytest.approx(expected, abs=1e-7)


def test_the_sun_is_seen_within_the_field_of_view_only():
    sensor = truth.build_trmm_sensors(heads=SQUARE)[0]
    angles = np.deg2rad([[0, 0], [47.9, -47.9], [48.1, 0], [0, -48.1], [10, 10]])
    s = compute_direction(angles)
    s[4] *= -1  # behind, where the tangents are the same
    A = np.broadcast_to(np.eye(3), (5, 3, 3))
    _, visible = truth.observe(None, sensor, A, s @ sensor.alignment.T)
    np.testing.assert_array_equal(visible, [True, True, False, False, False])


@pytest.mark.parametrize(("tilt", "elevation"), [(truth.SIMULATED_BORESIGHT_TILT, 0.0), (0.3, 0.2)])
def test_alignments_are_those_described_and_the_sun_crosses_at_one_alpha(tilt, elevation):
    sun = np.array([[np.cos(x), -np.sin(x), 0.0] for x in np.linspace(0, 1.0, 7)])
    pairs = zip(truth.build_trmm_alignments(tilt, elevation), ground.trmm_sun_sensors(tilt, elevation), (1, -1), strict=True)
    for N, ours, sign in pairs:
        np.testing.assert_allclose(N, ours.alignment, atol=1e-15)
        np.testing.assert_allclose(N @ N.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(N) == pytest.approx(1)
        assert N[2, 2] == pytest.approx(np.sin(elevation))
        assert np.arctan2(-N[1, 2], sign * N[0, 2]) == pytest.approx(tilt)
        angles = ground.compute_angles(sun * [sign, 1, 1] @ N)
        np.testing.assert_allclose(angles[:, 0], -sign * elevation, atol=1e-15)
        assert (np.diff(angles[:, 1]) > 0).all()  # β grows toward −Y


@pytest.mark.parametrize("which", [0, 1])
def test_counts_close_within_noise_and_quantisation(which):
    """Angle errors have the variance of the noise plus a count squared over twelve, the count's size depending on the angle."""
    n = 20_000
    rng = np.random.default_rng(3)
    misalignments = (np.eye(3), Rotation.from_matrix(M_DSS2).as_matrix())
    true = truth.build_trmm_sensors(heads=SQUARE, misalignments=misalignments)[which]
    sensor = replace(ground.trmm_sun_sensors()[which], misalignment=misalignments[which])
    A, sun, tangents = scene(true, rng, n, limit_deg=45)
    counts, visible = truth.observe(rng, true, A, sun)
    assert visible.all()
    error = sensor.angles(counts) - np.arctan(tangents)
    step = np.array([true.coefficients_alpha[1], true.coefficients_beta[1]]) / (1 + tangents**2)
    white = error / np.sqrt(true.noise**2 + step**2 / 12)
    assert np.abs(white.mean(axis=0)).max() < 4 / np.sqrt(n)
    assert np.abs(white.var(axis=0) - 1).max() < 4 * np.sqrt(2 / n)
    assert np.sqrt((error**2).mean()) < ground.SUN_ANGLE_SIGMA


@pytest.mark.parametrize(("which", "largest_deg"), [(0, 0.067), (1, 0.182)])
def test_turned_heads_show_the_errors_of_their_angles(which, largest_deg):
    """α is untouched; at the boresight β is off by e₃, and over the field of view by a few tenths of a degree (DSS-2)."""
    true, sensor = truth.build_trmm_sensors()[which], ground.trmm_sun_sensors()[which]
    A, sun, tangents = scene(true, np.random.default_rng(5), 5000, limit_deg=46)
    counts, _ = truth.observe(None, true, A, sun)
    error = np.rad2deg(sensor.angles(counts) - np.arctan(tangents))
    count = np.rad2deg(1.5e-4)
    assert np.abs(error[:, 0]).max() < count
    near = np.abs(tangents).max(axis=1) < 0.05
    np.testing.assert_allclose(error[near, 1], largest_deg, atol=2 * count)
    # To first order in the head's angles, anywhere.
    e1, e2, e3 = np.rad2deg(true.head)
    a, b = tangents.T
    expected = (e3 * (1 + b**2) - e2 * a - e1 * a * b) / (1 + b**2)
    np.testing.assert_allclose(error[:, 1], expected, atol=count)


@pytest.fixture
def model():
    rng = np.random.default_rng(9)
    sensor = replace(ground.trmm_sun_sensors()[1], misalignment=Rotation.from_rotvec([0.02, -0.03, 0.05]).as_matrix())
    true = truth.TrueSunSensor(
        "", sensor.alignment @ sensor.misalignment, truth.SIMULATED_ALPHA_COEFFICIENTS, truth.SIMULATED_BETA_COEFFICIENTS, ZERO
    )
    A, sun, tangents = scene(true, rng, 30)
    built: SensorModel = ground.SunModel(sensor, sun)
    return built, A, np.arctan(tangents)


def test_prediction_is_the_angles(model):
    sun_model, A, angles = model
    rows = np.arange(30)
    np.testing.assert_allclose(sun_model.predict(A, rows), angles, atol=1e-14)


def test_jacobians_are_finite_differences(model):
    sun_model, A, _ = model
    rows, h = np.arange(30), 1e-4
    for k in range(3):
        step = h * np.eye(3)[k]
        ahead, back = (Rotation.from_rotvec(sign * step).as_matrix() for sign in (1, -1))
        difference = (sun_model.predict(ahead @ A, rows) - sun_model.predict(back @ A, rows)) / (2 * h)
        np.testing.assert_allclose(sun_model.jacobian(A, rows)[:, :, k], difference, atol=3e-8)
        difference = (sun_model.corrected(step).predict(A, rows) - sun_model.corrected(-step).predict(A, rows)) / (2 * h)
        np.testing.assert_allclose(sun_model.partials(A, rows)[:, :, k], difference, atol=3e-8)


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
