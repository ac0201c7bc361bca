"""Discrepancies that are on no list: their columns against closed forms, and their breadth."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from diagnosis.diagnose import diagnose
from diagnosis.model import unlisted
from diagnosis.model.candidates import unlisted_groups
from diagnosis.model.linearise import linearised
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared, recorded

LATE = 1e-5  # of the time since an interval's start, that a reading is late by


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def bins(model):
    return unlisted.binned(model, 8.0)


@pytest.fixture(scope="module")
def families(model):
    return {(family.effect, family.axis): family.columns for family in unlisted.build_families(model)}


def test_bins_add_up_to_the_steps(model, bins):
    for number, block in enumerate(model.blocks):
        own = bins.interval == number
        expected = (model.to_inertial[block.steps] * model.dt[block.steps][:, None, None]).sum(axis=0)
        np.testing.assert_allclose(bins.turned[own].sum(axis=0), expected, rtol=1e-9, atol=1e-6)
        assert bins.ends[number][-1] == own.sum()
        assert bins.since_s[own][0] == pytest.approx(0.0, abs=8.0)


def test_at_a_reference_the_step_and_the_bin_that_follow_it_are_in_progress_and_at_the_end_the_last(model, bins):
    expected = [np.minimum(block.steps.start + block.ends, block.steps.stop - 1) for block in model.blocks]
    np.testing.assert_array_equal(model.steps_at_references, np.concatenate(expected))
    found = unlisted.bins_at_references(model, bins)
    np.testing.assert_array_equal(bins.interval[found], model.interval_of_reference)
    last = np.flatnonzero(np.append(np.diff(model.interval_of_reference) != 0, True))
    np.testing.assert_array_equal(found[last], np.searchsorted(bins.interval, np.arange(len(model.blocks)), "right") - 1)


def test_a_constant_regressor_is_the_column_of_a_bias(model, bins):
    for axis in range(3):
        column = unlisted.observed(model, bins, axis, np.ones((len(bins.t_s), 1)))[:, 0]
        np.testing.assert_allclose(column, model.calibration[:, 9 + axis], atol=1e-9 * np.abs(column).max())


def test_bins_change_a_slow_regressor_little(model, bins):
    """A regressor that follows the rate, of unit size, bin by bin against step by step."""
    square = model.rates[:, 1] ** 2
    exact = model.whitened(model.rate_error(np.eye(3)[None, :, 2, None] * square[:, None, None]))[:, 0]
    binned = unlisted.observed(model, bins, 2, bins.rates[:, [1]] ** 2)[:, 0]
    assert np.linalg.norm(binned - exact) < 0.02 * np.linalg.norm(exact)


def test_every_family_is_about_each_axis_with_columns_that_can_be_seen(model, families):
    of_axes = Counter(name for name, axis in families if axis is not None)
    assert set(of_axes.values()) == {3}
    assert [name for name, axis in families if axis is None] == ["time tags run late"]
    for options in families.values():
        assert options
        for columns in options:
            assert columns.shape[0] == model.size
            assert np.isfinite(columns).all()
            assert (np.linalg.norm(columns, axis=0) > 0).all()


def test_errors_of_references_leave_the_steps_before_them_alone(model, families):
    """A step of the references inside one interval shows in no other interval."""
    for columns in families["references step at a time", "x"]:
        shown = {model.observation_block[row // 3] for row in np.flatnonzero(np.abs(columns[:, 0]) > 1e-9)}
        before = [k for k in range(len(model.blocks)) if k < min(shown)]
        assert all(np.abs(columns[model.blocks[k].rows]).max() == 0 for k in before)


def test_periods_from_an_interval_s_start_need_no_orbit(families):
    waves = families["bias of a period counted from each interval's start", "z"]
    assert len(waves) == unlisted.SETTINGS.periods
    assert {columns.shape[1] for columns in waves} == {2}


def test_time_offset_are_what_a_later_reading_leaves(model, bins):
    """Against readings that are interpolated at the time they are late by, a share of the time since its interval began."""
    recording = model.recording
    gyro, rates = recording.gyro, recording.gyro.rates.copy()
    for interval in recording.intervals:
        own = (gyro.t_s >= interval.start_s) & (gyro.t_s < interval.stop_s)
        t_s, length = gyro.t_s[own], gyro.sample_s
        edges = np.append(t_s, t_s[-1] + length)
        angle = CubicSpline(edges, np.vstack([np.zeros(3), np.cumsum(rates[own] * length, axis=0)]))
        late = LATE * (edges - interval.start_s)
        rates[own] = np.diff(angle(edges) - late[:, None] * angle(edges, 1), axis=0) / length
    changed = linearised(replace(recording, gyro=replace(gyro, rates=rates)), model.G, model.bias).y - model.y
    expected = LATE * model.projected(unlisted.build_late_tags(model, bins).columns[0][:, 0] * max(1.0, bins.since_s.max()))
    assert np.linalg.norm(changed - expected) < 0.05 * np.linalg.norm(changed)


def test_of_two_intervals_a_value_of_each_is_a_step_between_them():
    """It is a rival of its own where there are three, or where no step is on the list."""
    model = prepared(3).model
    two, three = (
        linearised(model.recording, model.G, model.bias, pieces=model.recording.intervals[:count]) for count in (2, 3)
    )
    steps = [EFFECTS["bias_step"], EFFECTS["g_matrix_step"]]
    rivals = {"bias differs between intervals", "scale factor or misalignment differs between intervals"}

    def left(model, effects):
        return {one.effect for one in unlisted_groups(model, {}, effects)} & rivals

    assert left(two, steps) == set()
    assert left(three, steps) == rivals
    assert left(two, []) == rivals
    assert left(two, steps[:1]) == {"scale factor or misalignment differs between intervals"}


# ---- directions, temperatures and the past -------------------------------------------------------------------------------


def test_a_direction_follows_the_attitude_matrix(model, bins, families):
    """Its columns about z from components along x are those of rate errors a_xj, step by step."""
    columns = families["bias follows the direction to something in inertial space", "z"][0]
    A = model.to_inertial.transpose(0, 2, 1)
    error = np.zeros((len(A), 3, 3))
    error[:, 2] = A[:, 0]
    exact = model.projected(model.whitened(model.rate_error(error)))
    for found, one in zip(model.projected(columns).T, exact.T, strict=True):
        cosine = found @ one / np.linalg.norm(found) / np.linalg.norm(one)
        assert cosine > 0.999


def test_a_direction_that_turns_with_the_orbit_is_a_product(bins, model):
    components, orbit = np.random.default_rng(1).standard_normal((5, 3)), 100.0
    t_s = np.arange(5) * 7.0
    once, twice = (unlisted.turn_with_orbit(components, t_s, orbit, order) for order in (1, 2))
    angle = 2 * np.pi * t_s / orbit
    np.testing.assert_allclose(once, np.hstack([components * np.cos(angle)[:, None], components * np.sin(angle)[:, None]]))
    np.testing.assert_allclose(twice[:, :3], components)
    np.testing.assert_allclose(twice[:, 6:], components * np.sin(2 * angle)[:, None])


def test_the_past_decays(bins):
    """A constant since each interval's start is approached as 1 − exp(−t/τ)."""
    found = unlisted.filter_low_pass(np.ones((len(bins.t_s), 1)), bins, 300.0)[:, 0]
    own = bins.interval == 0
    np.testing.assert_allclose(found[own], 1 - np.exp(-(bins.since_s[own] + 0.5 * bins.dt[own]) / 300.0), atol=0.03)


def test_the_last_large_value_keeps_its_sign(bins):
    values = np.zeros(len(bins.t_s))
    own = np.flatnonzero(bins.interval == 1)
    values[own[10]], values[own[20]], values[own[30]] = 5.0, 0.1, -3.0
    found = unlisted.hold_sign(values, bins)[:, 0]
    assert (found[own[:10]] == 0).all()
    assert (found[own[10:30]] == 1).all()
    assert (found[own[30:]] == -1).all()
    assert (found[bins.interval != 1] == 0).all()


def test_housekeeping_brings_its_families(model, bins):
    """What lags behind a temperature is the temperature less its low-pass, and a constant one brings nothing."""
    known = {"gyro_temperature_c": np.sin(model.t_s / 2000.0), "bus_v": np.full(model.t_s.size, 28.0)}
    around = replace(model)
    around.__dict__["stream"] = replace(model.stream, housekeeping=known)
    found = {one.effect: len(one.columns) for one in unlisted.build_families(around) if "housekeeping" in one.effect}
    assert found == {
        "bias follows the square of a housekeeping value, or its delayed value": 1 + len(unlisted.SETTINGS.lags_s),
        "scale factor or misalignment follows a housekeeping value": 3,
        "references follow a housekeeping value": 1,
    }


def test_a_bias_that_follows_a_direction_is_unknown(model, bins):
    """Without these rivals a random walk beside an orbital bias explains it and is offered."""
    recording = recorded(3)
    shape = bins.turned[:, 0, 2] / bins.dt
    strength = np.linalg.norm(model.projected(unlisted.observed(model, bins, 1, shape[:, None])))
    gyro = recording.gyro
    high = np.interp(gyro.t_s, bins.t_s, shape) * 40.0 / strength
    rates = gyro.rates + high[:, None] * np.array([0.0, 1.0, 0.0])
    answer = diagnose(replace(recording, gyro=replace(gyro, rates=rates)))
    assert answer.verdict == "unknown"


def test_twice_a_heading_is_a_second_harmonic_of_a_direction():
    heading = np.linspace(0, 7, 50)
    direction = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(heading.size)])
    for wave in (np.sin(2 * heading), np.cos(2 * heading)):
        left = (
            wave
            - unlisted.build_second_harmonics(direction) @ np.linalg.pinv(unlisted.build_second_harmonics(direction)) @ wave
        )
        assert np.abs(left).max() < 1e-12


def test_references_that_follow_the_past_are_unknown(bins):
    """Random walks of references, and correlated errors, are free to look like it."""
    recording = recorded(21, every_s=60.0)
    references = recording.attitudes
    now = np.clip(np.searchsorted(bins.t_s, references.t_s), 0, bins.t_s.size - 1)
    past = unlisted.filter_low_pass(np.abs(bins.rates), bins, 300.0)[now, 2]
    error = np.zeros((past.size, 3))
    error[:, 2] = np.deg2rad(0.03) * past / past.std()
    turned = (Rotation.from_rotvec(-error) * Rotation.from_quat(references.quaternions).inv()).inv()
    assert diagnose(replace(recording, attitudes=replace(references, quaternions=turned.as_quat()))).verdict == "unknown"
