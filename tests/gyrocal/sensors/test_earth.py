"""The Earth sensor: simulator against calibrator, derivatives, on-board roll and pitch, the S filter and Sun intrusion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrocal.sensors.earth import TRMM_BIASES, EarthModel, EarthSensor
from simulator.sensors.earth import (
    CORRECT,
    HELD,
    OFF,
    RESTARTED,
    TrueEarthSensor,
    compute_roll_pitch,
    filter_s,
    is_sun_intruding,
    observe,
)
from simulator.sensors.horizon import AZIMUTHS, Horizon, compute_orbit_position
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from tests.simulator.sensors.nadir import bisector_attitude, compute_penetrations

ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=0.7, latitude_argument=0.2)
TIMES = np.arange(0.0, ORBIT.period, 10.0)
HORIZON = Horizon()
QUIET = TrueEarthSensor(sigma=0.0, sigma_s=0.0, swing=0.0)
ALL = np.ones(4, dtype=bool)
# Of roll, pitch, height and elongation, what four angles have for a unit of each; and the inverse.
PATTERN = np.stack([np.sin(AZIMUTHS), -np.cos(AZIMUTHS), np.ones(4), np.array([1.0, -1.0, 1.0, -1.0])], axis=1)
MODES = np.linalg.inv(PATTERN)


def turned(A: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The attitudes of a body turned from A (n, 3, 3) by rotation vectors (n, 3) in body axes, rad."""
    return np.ascontiguousarray(Rotation.from_rotvec(-np.asarray(rotation)).as_matrix() @ A)


def attitudes(n: int, tilt: float, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """n attitudes with tilts up to some rad and any yaw, and positions on the orbit."""
    rng = np.random.default_rng(seed)
    t = rng.uniform(0, ORBIT.period, n)
    A = turned(compute_lvlh_attitude(ORBIT, t), np.stack([np.zeros(n), np.zeros(n), rng.uniform(-3, 3, n)], axis=1))
    return turned(A, tilt * rng.uniform(-1, 1, (n, 3))), compute_orbit_position(ORBIT, t)


def sun_at(azimuth_deg: float, polar_deg: float) -> np.ndarray:
    """Inertial Sun in this body direction of the LVLH attitude at time zero."""
    a, p = np.deg2rad([azimuth_deg, polar_deg])
    return compute_lvlh_attitude(ORBIT, np.zeros(1))[0].T @ np.array([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)])


def passage(s_filter: str, **changes: object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, angles and flags of 20 min in LVLH in which the Sun crosses quadrant 4 only."""
    t = np.arange(-600.0, 600.0, 0.5)
    sensor = replace(QUIET, s_filter=s_filter, **changes)
    sun = np.tile(sun_at(315.0, np.rad2deg(HORIZON.nominal)), (t.size, 1))
    angles, used = observe(
        np.random.default_rng(0), sensor, t, compute_lvlh_attitude(ORBIT, t), compute_orbit_position(ORBIT, t), sun
    )
    return t, angles, used


def test_both_packages_see_the_same_horizon():
    A, position = attitudes(50, 0.1)
    model = EarthModel(EarthSensor(np.zeros(4)), position)
    truth = compute_penetrations(A, position, *HORIZON.semi_axes, HORIZON.nominal)
    np.testing.assert_allclose(model.predict(A, np.arange(50)), truth, rtol=0, atol=1e-12)


def test_jacobian_is_the_finite_difference():
    A, position = attitudes(30, 0.1)
    rows = np.arange(30)
    model = EarthModel(EarthSensor(TRMM_BIASES), position)
    jacobian, h = model.jacobian(A, rows), 1e-4
    for axis in range(3):
        shifted = [model.predict(Rotation.from_rotvec(k * h * np.eye(3)[axis]).as_matrix() @ A, rows) for k in (-2, -1, 1, 2)]
        difference = (shifted[0] - 8 * shifted[1] + 8 * shifted[2] - shifted[3]) / (12 * h)
        # Truncation h^4 times a fifth derivative of order 100, rounding 1e-15 / h.
        np.testing.assert_allclose(jacobian[..., axis], difference, rtol=0, atol=1e-10)


def test_trmm_biases_as_misalignment():
    printed = dict(zip(("NE", "SE", "SW", "NW"), TRMM_BIASES, strict=True))
    biases = np.array([printed[name] for name in ("SE", "SW", "NW", "NE")])
    modes = np.rad2deg(MODES @ biases)
    np.testing.assert_allclose(modes[:3], [0.0578, -0.0130, -0.0648], atol=1e-4)
    np.testing.assert_allclose(np.deg2rad(modes[:2]), compute_roll_pitch(biases, ALL), atol=1e-16)


def test_three_quadrants_are_least_squares_with_a_height():
    angles = np.deg2rad(np.random.default_rng(2).normal(size=(40, 4)))
    for lost in (None, 0, 1, 2, 3):
        used = np.ones((40, 4), dtype=bool)
        if lost is not None:
            used[:, lost] = False
        keep = used[0]
        expected = np.linalg.lstsq(PATTERN[keep, :3], angles[:, keep].T, rcond=None)[0][:2].T
        shown = np.where(used, angles, np.nan)
        np.testing.assert_allclose([compute_roll_pitch(y, u) for y, u in zip(shown, used, strict=True)], expected, atol=1e-15)


def test_roll_and_pitch_of_a_turned_body():
    """From the bisector, at any yaw, to second order."""
    A, position = attitudes(100, 0.0)
    A = bisector_attitude(A, position, HORIZON)
    tilt = np.concatenate([np.deg2rad(np.random.default_rng(4).uniform(-0.4, 0.4, (100, 2))), np.zeros((100, 1))], axis=1)
    y = compute_penetrations(turned(A, tilt), position, *HORIZON.semi_axes, HORIZON.nominal)
    four = np.array([compute_roll_pitch(one, ALL) for one in y])
    # Slopes differ from a sphere's by under 1 %, and 2 (0.4 deg)^2 is 0.006 deg.
    np.testing.assert_allclose(np.rad2deg(four), np.rad2deg(tilt[:, :2]), atol=0.01)


@pytest.mark.parametrize("s_filter", ["off", "correct", "held", "restarted"])
def test_constant_offset_is_subtracted(s_filter):
    """Without noise, swing or Sun the angles are the true ones and the biases, whatever the offset and the filter."""
    A, position = compute_lvlh_attitude(ORBIT, TIMES), compute_orbit_position(ORBIT, TIMES)
    sensor = replace(QUIET, s_filter=s_filter, biases=TRMM_BIASES, offset=0.3)
    away = np.tile(-compute_orbit_position(ORBIT, np.array([ORBIT.period / 4]))[0] / ORBIT.radius, (TIMES.size, 1))
    angles, used = observe(np.random.default_rng(0), replace(sensor, sun_field=0.0, sun_margin=0.0), TIMES, A, position, away)
    assert used.all()
    truth = compute_penetrations(A, position, *HORIZON.semi_axes, HORIZON.nominal)
    np.testing.assert_allclose(angles, truth + TRMM_BIASES, atol=1e-14)


def test_filter_by_hand():
    assert filter_s(np.nan, 0.5, True, True, 0.25, RESTARTED, 0.0) == 0.5  # first sample
    assert filter_s(0.1, 0.5, True, True, 0.25, CORRECT, 0.0) == pytest.approx(0.2)
    assert filter_s(0.1, 0.5, True, True, 0.25, OFF, 0.0) == 0.5
    for mode in (OFF, CORRECT, HELD, RESTARTED):
        assert filter_s(0.1, 0.5, False, True, 0.25, mode, 0.9) == 0.1  # frozen
    returned = [filter_s(0.1, 0.5, True, False, 0.25, mode, 0.9) for mode in (OFF, CORRECT, HELD, RESTARTED)]
    np.testing.assert_allclose(returned, [0.5, 0.5, 0.2, 0.8])


def test_wrong_restart_is_a_spike_that_decays():
    """3 w (o - S_f) (1 - g)^k after the return."""
    t, correct, used = passage("correct")
    out = np.flatnonzero(~used[:, 3])
    assert 100 < t[out[-1]] - t[out[0]] < 240  # through 11 deg at 4 deg/min
    back = out[-1] + 1
    _, wrong, _ = passage("restarted")
    spike = (wrong - correct)[back:, 3]
    elapsed = 0.5 * np.arange(1, spike.size + 1)
    np.testing.assert_allclose(spike, 3 * QUIET.width * QUIET.offset * np.exp(-elapsed / QUIET.s_time_constant), atol=1e-13)
    np.testing.assert_array_equal((wrong - correct)[: out[0]], 0.0)
    _, held, _ = passage("held")
    np.testing.assert_allclose(held, correct, atol=1e-13)  # a constant offset: nothing went stale
    _, heated, _ = passage("restarted", s_restart=QUIET.offset + QUIET.sun_radiance)
    assert (heated - correct)[back, 3] == pytest.approx(-3 * QUIET.width * np.exp(-0.5 / 60))


def test_intrusion_field_and_eclipse():
    t = np.zeros(1)
    A, position = compute_lvlh_attitude(ORBIT, t)[0], compute_orbit_position(ORBIT, t)[0]
    nominal, cos_field = HORIZON.nominal, np.cos(np.deg2rad(5.0))
    limb_deg = np.rad2deg(nominal)
    solid = np.rad2deg(np.arcsin(6378137.0 / ORBIT.radius))  # 71.4 deg; the Earth is oblate by 0.2 deg at most there
    for i, azimuth in enumerate(np.rad2deg(AZIMUTHS)):
        for polar, expected in ((limb_deg + 4.9, True), (limb_deg + 5.1, False), (solid + 0.3, True), (solid - 0.9, False)):
            sun = sun_at(azimuth, polar)
            assert is_sun_intruding(A, position, sun, i, nominal, cos_field) is expected
            assert not any(is_sun_intruding(A, position, sun, j, nominal, cos_field) for j in range(4) if j != i)


def test_noise_is_as_stated():
    """Variance sigma^2 + (3 w sigma_s)^2 without filter, g/(2 - g) of the second part with it."""
    n = 40000
    t = 0.5 * np.arange(n)
    A, position = (
        np.repeat(x, n, axis=0) for x in (compute_lvlh_attitude(ORBIT, np.zeros(1)), compute_orbit_position(ORBIT, np.zeros(1)))
    )
    sun = np.tile(sun_at(0.0, 170.0), (n, 1))
    truth = compute_penetrations(A[:1], position[:1], *HORIZON.semi_axes, HORIZON.nominal)[0]
    sensor = TrueEarthSensor(swing=0.0, sigma_s=0.01, s_time_constant=5.0)
    gain = sensor.gain(0.5)
    s_part = (3 * sensor.width * sensor.sigma_s) ** 2
    variance = {}
    for s_filter in ("off", "correct"):
        angles, used = observe(np.random.default_rng(6), replace(sensor, s_filter=s_filter), t, A, position, sun)
        assert used.all()
        variance[s_filter] = ((angles - truth)[200:] ** 2).mean()
    # 4 n numbers; those of the filtered S are correlated over 2/g samples.
    assert variance["off"] == pytest.approx(sensor.sigma**2 + s_part, rel=4 * np.sqrt(2 / (4 * n)))
    expected = sensor.sigma**2 + s_part * gain / (2 - gain)
    assert variance["correct"] == pytest.approx(expected, rel=4 * np.sqrt(2 / (4 * n) * 2 / gain))
