"""The next recording of a unit: its prediction against dense normal distributions, and p-values over many draws."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis import next_recording
from diagnosis.model.folds import SETTINGS as FOLDS
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.periods import make_columns
from diagnosis.model.unit import join_recordings
from diagnosis.next_recording import compare_with_prediction, predict_next_recording
from gyrocal import InputError, calibrate, triad
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from simulator import scenario
from simulator.effects import EFFECTS, setting
from simulator.simulate import simulate
from tests.tracker_cases import AGILE, ESTIMATED

SIZE = 0.3  # deg/h, sigma of the amplitudes of the effect that all recordings have
DRAWS = 120


@pytest.fixture(scope="module")
def plan():
    return scenario.override(scenario.load("trmm_series"), {"reference.every_s": 300.0, "gyro.sample_s": 4.0})


@pytest.fixture(scope="module")
def recordings(plan):
    return {name: simulate(plan, seed=seed) for seed, name in enumerate(("one", "two", "three"), 40)}


@pytest.fixture(scope="module")
def unit(recordings):
    return join_recordings(recordings)


@pytest.fixture(scope="module")
def model(unit, plan):
    return linearise_recording(unit.recording, np.array(plan.gyro.true_G), np.deg2rad(plan.gyro.true_bias_deg_s))


@pytest.fixture(scope="module")
def orbital(model):
    return make_columns(model, EFFECTS["bias_orbital"], "z", {"phase_deg": 0.0})


def of_last(model, unit):
    names = np.array(unit.owner)[[block.interval for block in model.blocks]]
    return np.repeat(names[model.observation_block] == "three", 3)


def unwhitened(model, values):
    return np.concatenate([block.whitener @ values[block.rows] for block in model.blocks])


def drawn(model, orbital, rng):
    """The model with observations of the effect, of errors of start attitudes, G and b, and of noise."""
    nuisance = model.starts @ rng.normal(scale=1e-3, size=model.starts.shape[1])
    nuisance += model.calibration @ (0.1 * PLAUSIBLE_RANGE * rng.standard_normal(12))
    white = nuisance + orbital @ rng.normal(scale=SIZE, size=2) + rng.standard_normal(model.size)
    return replace(model, zeta=unwhitened(model, white))


def test_a_prediction_is_that_of_the_joint_normal_distribution(model, unit, orbital):
    one = drawn(model, orbital, np.random.default_rng(1))
    out = of_last(model, unit)
    # Least squares of the whitened rows, with a row of prior for each shared number and none for the start attitudes.
    y, N = one.whiten(one.zeta), model.starts
    shared = np.hstack([model.calibration * FOLDS.broad * PLAUSIBLE_RANGE, SIZE * orbital])
    train, last = N[~out][:, np.any(N[~out], axis=0)], N[out][:, np.any(N[out], axis=0)]
    A = np.vstack([np.hstack([shared[~out], train]), np.eye(shared.shape[1], shared.shape[1] + train.shape[1])])
    Q, R = np.linalg.qr(A)
    root = np.linalg.inv(R)[: shared.shape[1]]  # P = root rootᵀ
    e = y[out] - shared[out] @ root @ Q[: np.sum(~out)].T @ y[~out]
    P = np.linalg.inv(np.eye(e.size) + shared[out] @ root @ root.T @ shared[out].T)
    chi2 = e @ P @ e - e @ P @ last @ np.linalg.solve(last.T @ P @ last, last.T @ P @ e)
    found = compare_with_prediction(one, unit.owner, "three", [(SIZE, orbital)])
    assert found.dof == out.sum() - last.shape[1]
    assert found.chi2 == pytest.approx(chi2, rel=1e-3)
    assert {band.interval.split(": ")[0] for band in found.bands} == {"three"}


@pytest.mark.parametrize("own_bias", [False, True])
def test_p_values_are_uniform_if_nothing_has_changed(model, unit, orbital, own_bias):
    rng = np.random.default_rng(2)
    found = [
        compare_with_prediction(drawn(model, orbital, rng), unit.owner, "three", [(SIZE, orbital)], own_bias)
        for _ in range(DRAWS // 2)
    ]
    assert scipy.stats.kstest([one.p_value for one in found], "uniform").pvalue > 0.01
    # Those of single intervals and axes too; they hardly correlate, and a wrong band would show in all of them.
    bands = np.array([[band.p_value for band in one.bands] for one in found])
    assert scipy.stats.kstest(bands[:, 0], "uniform").pvalue > 0.01
    assert np.mean(bands) == pytest.approx(0.5, abs=0.03)
    expected = np.array([[(band.residual_deg / band.band_deg) ** 2 for band in one.bands] for one in found])
    assert np.mean(expected) == pytest.approx(1.0, abs=0.05)


def test_without_the_effect_in_it_the_prediction_fails(model, unit, orbital):
    one = drawn(model, 3 * orbital, np.random.default_rng(3))
    assert compare_with_prediction(one, unit.owner, "three", []).p_value < 1e-3


def test_an_effect_that_begins_in_the_next_recording_is_seen(model, unit, orbital):
    new = make_columns(model, EFFECTS["scale_asymmetry"], "z", {})[:, 0] * of_last(model, unit)
    one = drawn(model, orbital, np.random.default_rng(4))
    moved = replace(one, zeta=one.zeta + unwhitened(model, 600.0 * new))
    found = compare_with_prediction(moved, unit.owner, "three", [(SIZE, orbital)])
    assert compare_with_prediction(one, unit.owner, "three", [(SIZE, orbital)]).p_value > 1e-3
    assert found.p_value < 1e-6
    assert min(found.bands, key=lambda band: band.p_value).axis == "z"


def test_a_new_bias_is_a_departure_unless_each_recording_has_its_own(model, unit, orbital):
    turned = np.zeros((model.t_s.size, 3, 1))
    last = np.array(unit.owner)[[block.interval for block in model.blocks]] == "three"
    for block in np.array(model.blocks, dtype=object)[last]:
        turned[block.steps, 0] = np.deg2rad(1.0) / 3600
    one = drawn(model, orbital, np.random.default_rng(5))
    moved = replace(one, zeta=one.zeta + model.observe_rate_error(turned)[:, 0])
    assert compare_with_prediction(moved, unit.owner, "three", [(SIZE, orbital)]).p_value < 1e-6
    assert compare_with_prediction(moved, unit.owner, "three", [(SIZE, orbital)], own_bias=True).p_value > 1e-3


def test_from_the_recordings_to_the_comparison(recordings, plan):
    later = simulate(plan, seed=42, effects=[setting("scale_asymmetry", "z", 1500.0)])
    found = predict_next_recording({**recordings, "three": later}, library=["scale_asymmetry"])
    assert found.recordings == ("one", "two")
    assert found.verdict == "none"
    assert found.predicted.p_value < 1e-6
    document = found.to_json()
    assert document["next"] == "three"
    assert document["p_value"] == found.predicted.p_value
    assert len(document["bands"]) == len(found.predicted.bands)


def test_a_last_recording_that_fits_nothing_is_refused_before_the_others_are_diagnosed(recordings, monkeypatch):
    def prepare(*arguments):
        raise AssertionError("the recordings before have been prepared")

    monkeypatch.setattr(next_recording, "prepare", prepare)
    whole = recordings["three"]
    cut = replace(whole, gyro=replace(whole.gyro, t_s=whole.gyro.t_s[:2], rates=whole.gyro.rates[:2]))
    other = replace(whole, gyro=replace(whole.gyro, rates=-whole.gyro.rates))
    for bad, message in ((cut, "three: interval m1: no gyro samples between"), (other, "three: .* too large to linearise")):
        with pytest.raises(InputError, match=message):
            predict_next_recording({**recordings, "three": bad})


def test_one_recording_predicts_nothing(recordings):
    with pytest.raises(InputError, match="two recordings"):
        predict_next_recording({"one": recordings["one"]})


FOUR = scenario.override(scenario.load("trmm_tetrahedron"), {"reference.every_s": 400.0, "gyro.sample_s": 4.0})


@pytest.mark.parametrize("plan", [FOUR, AGILE, ESTIMATED], ids=["four gyros", "two trackers", "a mounting that is estimated"])
def test_recordings_of_several_gyros_and_trackers_are_as_predicted(plan):
    z = []
    for seed in range(8):
        unit = join_recordings({name: triad(simulate(plan, seed=seed, case=k)) for k, name in enumerate(("one", "three"))})
        found = calibrate(unit.recording)
        compared = compare_with_prediction(linearise_recording(unit.recording, found.G, found.bias), unit.owner, "three", [])
        z.append((compared.chi2 - compared.dof) / np.sqrt(2 * compared.dof))
    assert abs(np.mean(z)) < 3.5 / np.sqrt(len(z))


def test_several_gyros_are_compared_by_the_rates_of_the_body():
    recordings = {
        str(seed): simulate(FOUR, seed=seed, effects=[setting("bias_step", "4", 3.0 * seed, {"time_s": 13000.0})])
        for seed in (0, 1)
    }
    found = predict_next_recording(recordings, library=[])
    assert found.predicted.p_value < 1e-9
    assert "parity" in found.notes[0]


def test_the_next_recording_has_the_same_trackers(recordings):
    with pytest.raises(InputError, match="of the same star trackers"):
        join_recordings({"two": simulate(scenario.override(AGILE, {"gyro.sample_s": 4.0})), "one": recordings["one"]})
