"""What a plan predicts, against algebra and against the whole simulator."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import gyrocal
import simulator
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import prepare
from diagnosis.plan import visibility
from diagnosis.plan.columns import Signature, build_signatures, linearise_noise_free
from diagnosis.plan.extras import list_maneuvers
from diagnosis.plan.invisible import find_invisible_effects
from diagnosis.plan.pipeline import plan
from diagnosis.plan.result import SETTINGS
from diagnosis.plan.separability import compute_confusion_shares, list_pairs
from diagnosis.plan.visibility import DetectionPower, find_visible_size
from diagnosis.settings import DEFAULT
from gyrocal import calibrate
from simulator.effects import EFFECTS, parse, setting
from simulator.scenario import load, override
from simulator.simulate import motion, observe
from simulator.streams import generator

SEEDS = 24


@pytest.fixture(scope="module")
def scenario():
    """Coarse samples and few references: the same physics in a tenth of the time."""
    return override(load("trmm_series"), {"reference.every_s": 600.0, "gyro.sample_s": 5.0})


@pytest.fixture(scope="module")
def model(scenario):
    return linearise_noise_free(scenario)


@pytest.fixture(scope="module")
def power(model):
    return DetectionPower(build_linear_model(model, list(EFFECTS.values())))


@pytest.fixture(scope="module")
def every(model):
    return {signature.label: signature for signature in build_signatures(model, list(EFFECTS))}


def linearise_calibrated(recording):
    """The linear model about a calibration, without a look at the samples, which takes most of the time."""
    found = calibrate(recording)
    return linearise_recording(recording, found.G, found.bias)


def linearise_prepared(recording):
    """The linear model of the diagnosis itself."""
    return prepare(recording).model


@pytest.fixture(scope="module")
def detected(scenario, power):
    """How many of `SEEDS` simulated recordings have a gap in the attitude, with one linear model for all."""
    path = motion(scenario)

    def count(effects, entropy, see=linearise_calibrated):
        seen = []
        for case in range(SEEDS):
            gyro, references = generator(entropy, case, "gyro_noise"), generator(entropy, case, "reference_noise")
            recording = observe(
                scenario, path, gyro_rng=gyro, reference_rng=references, effects=effects, seed=entropy, case=case
            )
            seen.append(see(recording).y)
        return int(np.sum(power.search.compute_null_statistic(power.linear.X.T @ np.column_stack(seen)) > power.threshold))

    return count


def setting_at(one, seen):
    """The typical case of an effect at its smallest visible size."""
    parameters = dict(one.parameters[one.middle])
    if one.X.shape[2] > 1:
        parameters |= EFFECTS[one.effect].from_amplitudes(one.amplitudes)[1]
    return setting(one.effect, one.axis, seen.size, parameters)


@pytest.mark.parametrize(
    ("label", "see"),
    [
        ("scale_asymmetry:z", linearise_calibrated),
        pytest.param("bias_drift:z", linearise_prepared, marks=pytest.mark.long),
        pytest.param("reference_orbital:x", linearise_prepared, marks=pytest.mark.long),
    ],
)
def test_nine_recordings_in_ten_with_the_predicted_size_show_a_gap(label, see, every, power, detected):
    seen = find_visible_size(every[label], power)
    count = detected([setting_at(every[label], seen)], 21, see)
    assert scipy.stats.binomtest(count, SEEDS, SETTINGS.power).pvalue > 0.005


def test_without_an_effect_there_is_no_gap(detected):
    count = detected([], entropy=22)
    assert scipy.stats.binom.sf(count - 1, SEEDS, DEFAULT.false_alarm_rate) > 0.002


def made(label, X):
    X = np.asarray(X, dtype=float)
    options = X.shape[1]
    return Signature(label.split(":")[0], None, label, X, np.ones(options), np.ones(options) / options, ({},) * options)


def test_pairs_share_the_squared_cosine_and_lag_and_time_offset_are_the_same(every, power):
    one, other = made("bias_drift:x", [[[2.0]], [[0.0]]]), made("bias_step:x", [[[3.0]], [[4.0]]])
    rho, ratio = compute_confusion_shares([one, other])
    assert rho[0, 1] == pytest.approx(0.36)
    assert ratio[0, 1] == pytest.approx(2.0 * 0.6 / 5.0)
    both = [every["time_offset"], every["rate_lag"]]
    found = list_pairs(both, [find_visible_size(one, power) for one in both])
    assert [(one.effect, one.other, one.snr) for one in found] == [
        ("rate_lag", "time_offset", np.inf),
        ("time_offset", "rate_lag", np.inf),
    ]


def test_plan_of_a_scenario_with_references_at_the_ends(monkeypatch):
    """Fewer draws than usual move a size by a few per cent, and no verdict."""
    monkeypatch.setattr(visibility, "SETTINGS", replace(SETTINGS, null_draws=500, power_draws=60))
    told = []
    scenario = override(load("trmm"), {"gyro.sample_s": 10.0})
    chosen = {name: part for name, part in list_maneuvers(scenario).items() if name.startswith("roll")}
    found = plan(scenario, extras=chosen, progress=lambda text, share: told.append(share))
    assert told == sorted(told)
    assert found.degrees_of_freedom == 6
    assert "6 degrees of freedom" in found.notes[0]
    by_label = {effect.label: effect for effect in found.effects}
    assert by_label["time_offset"].verdict != "visible"
    assert by_label["bias_drift:y"].verdict == "visible"
    # Steps of different elements cannot be told apart by so few numbers.
    assert all(np.isnan(pair.snr) or pair.snr > SETTINGS.limit_snr for pair in found.pairs)
    (extra,) = found.extras
    assert extra.ratio < 1
    assert all(value < 1 + 1e-9 for label, value in extra.by_effect.items() if not label.startswith("reference"))
    assert "scale_asymmetry:x" in extra.gained
    assert extra.resolved


SCENARIO = simulator.load("trmm_series")


@pytest.fixture(scope="module")
def found():
    recording = simulator.simulate(SCENARIO, seed=1)
    result = gyrocal.calibrate(recording)
    effects = find_invisible_effects(recording, result.parameters.G, result.parameters.bias, result.sigma)
    return result, {effect.label: effect for effect in effects}


@pytest.mark.parametrize("label", ["scale_quadratic:z", "scale_asymmetry:x"])
def test_a_hidden_effect_moves_the_calibration_as_predicted_and_leaves_no_misfit(found, label):
    """The noise of both recordings is the same, so that their difference is that of the effect."""
    plain, effects = found
    one = effects[label]
    moved = gyrocal.calibrate(simulator.simulate(SCENARIO, seed=1, effects=[parse(f"{label}={one.size}")]))
    change = moved.parameters.vector - plain.parameters.vector
    np.testing.assert_allclose(change, one.change, atol=0.3 * plain.sigma.max() + 0.02 * np.abs(one.change).max())
    assert np.abs(one.sigmas).max() > 10
    assert moved.p_value > 1e-3
    assert "would show it" in one.describe()


def test_effects_that_leave_a_misfit_are_not_listed(found):
    """The slews about y go both ways, and a bias that follows the orbit is seen within an interval."""
    _, effects = found
    assert not {"scale_asymmetry:z", "bias_orbital:y"} & set(effects)
