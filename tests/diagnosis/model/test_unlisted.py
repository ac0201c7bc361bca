"""Discrepancies that are on no list: their columns against closed forms, and their breadth."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from diagnosis.model import bins as bins_of
from diagnosis.model import deterministic_alternatives
from diagnosis.model.groups import list_alternative_groups
from diagnosis.model.linearise import linearise_recording
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared

LATE = 1e-5  # of the time since an interval's start, that a reading is late by


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def bins(model):
    return bins_of.build_bins(model, 8.0)


@pytest.fixture(scope="module")
def families(model):
    return {(family.name, family.axis): family.columns for family in deterministic_alternatives.build_families(model)}


def test_bins_add_up_to_the_steps(model, bins):
    for number, block in enumerate(model.blocks):
        own = bins.interval == number
        expected = (model.to_inertial[block.steps] * model.dt[block.steps][:, None, None]).sum(axis=0)
        np.testing.assert_allclose(bins.turned[own].sum(axis=0), expected, rtol=1e-9, atol=1e-6)
        assert bins.ends[number][-1] == own.sum()
        assert bins.since_s[own][0] == pytest.approx(0.0, abs=8.0)


def test_a_constant_regressor_is_the_column_of_a_bias(model, bins):
    for axis in range(3):
        column = bins_of.observe_rate_errors(model, bins, axis, np.ones((len(bins.t_s), 1)))[:, 0]
        np.testing.assert_allclose(column, model.calibration[:, 9 + axis], atol=1e-9 * np.abs(column).max())


def test_bins_change_a_slow_regressor_little(model, bins):
    """A regressor that follows the rate, of unit size, bin by bin against step by step."""
    square = model.rates[:, 1] ** 2
    exact = model.whiten(model.observe_rate_error(np.eye(3)[None, :, 2, None] * square[:, None, None]))[:, 0]
    binned = bins_of.observe_rate_errors(model, bins, 2, bins.rates[:, [1]] ** 2)[:, 0]
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
    assert len(waves) == deterministic_alternatives.PERIODS
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
    changed = linearise_recording(replace(recording, gyro=replace(gyro, rates=rates)), model.G, model.bias).y - model.y
    expected = LATE * model.project_out_nuisance(
        deterministic_alternatives.build_late_tags(model, bins).columns[0][:, 0] * max(1.0, bins.since_s.max())
    )
    assert np.linalg.norm(changed - expected) < 0.05 * np.linalg.norm(changed)


def test_of_two_intervals_a_value_of_each_is_a_step_between_them():
    """It is a rival of its own where there are three, or where no step is on the list."""
    model = prepared(3).model
    two, three = (
        linearise_recording(model.recording, model.G, model.bias, pieces=model.recording.intervals[:count]) for count in (2, 3)
    )
    steps = [EFFECTS["bias_step"], EFFECTS["g_matrix_step"]]
    rivals = {"bias differs between intervals", "scale factor or misalignment differs between intervals"}

    def left(model, effects):
        return {one.effect for one in list_alternative_groups(model, {}, effects)} & rivals

    assert left(two, steps) == set()
    assert left(three, steps) == rivals
    assert left(two, []) == rivals
    assert left(two, steps[:1]) == {"scale factor or misalignment differs between intervals"}
