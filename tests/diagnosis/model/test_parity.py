"""Parity as observations: exact columns, white noise, and nothing of what K and c can do."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.gyros import check_parity
from diagnosis.model.array_model import ArrayModel
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.parity import build_parity_model
from diagnosis.model.periods import make_columns
from diagnosis.model.steps import build_switched_columns
from gyrocal import GyroArray, triad
from gyrocal.recording.gyros import select_interval_samples
from simulator.effects import EFFECTS
from tests.builders import mean_bounds
from tests.gyro_arrays import SKEWED, TETRAHEDRON, array_recording

ARW = 5e-6
SWITCHED = [None, ("1", "2", "3", "4"), ("1", "2", "4", "5"), None, ("3", "4", "5"), None]
CASES = [(TETRAHEDRON, None), (SKEWED, None), (SKEWED, SWITCHED)]


def model_of(recording, K, c):
    gyros = GyroArray(recording.gyro.names, np.asarray(K, dtype=float), np.asarray(c, dtype=float))
    return build_parity_model(recording, gyros, np.full(len(K), ARW))


@pytest.mark.parametrize(("axes", "gyros"), CASES)
def test_errors_of_the_parameters_are_nuisance(axes, gyros):
    recording, *_ = array_recording(axes, gyros=gyros)
    model = model_of(recording, axes, np.zeros(len(axes)))
    assert np.abs(model.observed).max() > 10
    assert np.abs(model.y).max() < 0.02  # of a sigma: the rates of the columns are those of the nominal axes
    assert model.degrees_of_freedom == model.size - 4 * (len(axes) - 3)


@pytest.mark.parametrize(("axes", "gyros"), CASES)
def test_noise_is_white(axes, gyros):
    found = []
    for seed in range(6):
        recording, K, c = array_recording(axes, ARW, np.random.default_rng([seed, 4]), gyros, sample_s=4.0)
        model = model_of(recording, K, c)
        found.append(model.y @ model.y)
        size, correlation = check_parity(model, model.y)
        assert min(size.p_value, correlation.p_value) > 1e-4
    low, high = mean_bounds(model.degrees_of_freedom, 6)
    assert low < np.mean(found) < high
    assert check_parity(model, 1.3 * model.y)[0].p_value < 1e-3
    smooth = np.repeat(model.y[::8], 8)[: model.size]
    assert check_parity(model, smooth)[1].p_value < 1e-6


@pytest.mark.parametrize(("axes", "gyros"), CASES)
def test_columns_are_what_an_error_of_a_reading_adds(axes, gyros):
    recording, K, c = array_recording(axes, gyros=gyros)
    plain = model_of(recording, K, c)
    t = recording.gyro.t_s
    error = 1e-6 * np.sin(t / 700.0)
    rates = recording.gyro.rates.copy()
    rates[:, 1] += error
    disturbed = model_of(replace(recording, gyro=replace(recording.gyro, rates=rates)), K, c)
    parts = np.concatenate(
        [np.arange(len(t))[select_interval_samples(recording, k)[0]] for k in range(len(recording.intervals))]
    )
    high = np.zeros((len(parts), len(axes), 1))
    high[:, 1, 0] = error[parts]
    column = plain.reading(high)[:, 0]
    np.testing.assert_allclose(disturbed.observed - plain.observed, column, atol=1e-9 * np.abs(column).max() + 1e-9)


def test_observations_of_a_switched_error_by_hand():
    model = model_of(*array_recording(TETRAHEDRON))
    high = np.zeros((model.stream.t_s.size, 4))
    high[:, 2] = 1 + np.sin(model.stream.t_s / 500.0)
    starts = np.array([0, 700, 1001, len(high) - 1])
    found = model.observe_reading_steps(high, starts)
    for k, start in enumerate(starts):
        after = np.arange(len(high)) >= start
        np.testing.assert_allclose(found[:, [k]], model.reading((high * after[:, None])[:, :, None]), atol=1e-9)


@pytest.mark.parametrize(("axes", "gyros"), CASES)
def test_attitude_and_parity_see_one_error_of_one_gyro(axes, gyros):
    """Columns of both against the observations of a recording with the error in it."""
    recording, K, c = array_recording(axes, gyros=gyros, series_s=100.0, sample_s=2.0)
    recording = replace(recording, gyro=replace(recording.gyro, arw=ARW))
    size = np.deg2rad(0.5 / 3600)
    rates = recording.gyro.rates.copy()
    rates[recording.gyro.t_s >= 4000.0, 3] += size
    worse = replace(recording, gyro=replace(recording.gyro, rates=rates))

    def of(one):
        body = linearise_recording(triad(one, K, c), np.eye(3), np.zeros(3))
        return ArrayModel(one, model_of(one, K, c), body)

    model, disturbed = of(recording), of(worse)
    first = np.searchsorted(model.stream.t_s, [4000.0])
    column = 0.5 * build_switched_columns(model, EFFECTS["bias_step"], "4", {}, first)[:, 0]
    change = np.concatenate([
        disturbed.body.whiten(disturbed.body.zeta) - model.body.whiten(model.body.zeta),
        disturbed.parity.observed - model.parity.observed,
    ])  # fmt: skip
    assert np.abs(column[: model.attitude_rows]).max() > 1
    assert np.abs(column[model.attitude_rows :]).max() > 1
    np.testing.assert_allclose(change, column, atol=2e-3 * np.abs(column).max())
    always = make_columns(model, EFFECTS["bias_step"], "4", {"time_s": 4000.0})[:, 0] * 0.5
    np.testing.assert_allclose(always, column, atol=1e-6 * np.abs(column).max())


def test_no_parity_of_three():
    recording, K, c = array_recording(SKEWED, gyros=[("1", "2", "3")] * 6)
    assert model_of(recording, K, c) is None
