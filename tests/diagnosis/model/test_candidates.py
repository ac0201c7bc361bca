"""Candidates of a recording: their columns against the simulator, their priors, and the times of steps."""

import numpy as np
import pytest

from diagnosis.model.candidates import place_candidates
from diagnosis.model.groups import CandidateColumns
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.periods import make_columns
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS, setting
from simulator.simulate import motion, observe
from tests.diagnosis.recordings import linear, plan, prepared


@pytest.fixture(scope="module")
def model():
    return prepared(3).model


@pytest.fixture(scope="module")
def made():
    return linear(3)


@pytest.fixture(scope="module")
def noise_free():
    """The simulator without noise, and the linear model of it about the truth."""
    base = plan(1.0)
    path = motion(base)

    def simulated(*settings):
        recording = observe(base, path, gyro_rng=None, reference_rng=None, effects=settings)
        return linearise_recording(recording, np.array(base.gyro.true_G), np.deg2rad(base.gyro.true_bias_deg_s))

    return simulated


# Sizes whose effect is far above rounding, and for the timing small enough for a derivative.
SMALL = {"scale_asymmetry": 100.0, "scale_quadratic": 1e3, "g_matrix_step": 10.0}


OF_HOUSEKEEPING = ("bias_temperature", "g_matrix_temperature", "acceleration_sensitivity")  # tests/simulator has them


@pytest.mark.parametrize(
    "name", [name for name, effect in EFFECTS.items() if effect.has_columns and name not in OF_HOUSEKEEPING]
)
def test_columns_are_what_the_simulator_adds(noise_free, name):
    """Whitened observations of a small effect of each kind, less those without it."""
    effect = EFFECTS[name]
    axis = "z" if effect.axes else None
    plain = noise_free()
    starts = np.linalg.qr(plain.starts)[0]
    for trial in effect.trials(plain.surroundings)[:2]:
        fixed = dict(trial.parameters) | ({"time_s": plain.t_s[900] + 0.5} if effect.switched else {})
        injected = setting(name, axis, SMALL.get(name, 1e-3), fixed)
        changed = plain.whiten(noise_free(injected).zeta - plain.zeta)
        expected = make_columns(plain, effect, axis, injected.parameters) @ effect.amplitudes(injected)
        # An error of an interval's first reference is taken for one of the start attitude.
        changed, expected = (values - starts @ (starts.T @ values) for values in (changed, expected))
        np.testing.assert_allclose(changed, expected, atol=0.01 * np.abs(expected).max())


def test_steps_are_columns_switched_on(model, made):
    """Options of a step against columns that begin at its time, for each set of parameters that goes with it."""
    effect = EFFECTS["g_matrix_step"]
    candidate = made.candidates[made.find("g_matrix_step:y")]
    assert {option.parameters["toward"] for option in candidate.options} == set("xyz")
    for option in candidate.options[3::17]:
        own = {name: value for name, value in option.parameters.items() if name != "time_sigma_s"}
        # Tried times are those of the middle of a step's first sample; a gap's is that of its middle.
        own["time_s"] = float(own["time_s"]) - 1.0 if not option.parameters["time_sigma_s"] else own["time_s"]
        expected = make_columns(model, effect, "y", own)[:, 0]
        np.testing.assert_allclose(made.W[:, option.start], expected, atol=1e-9 * np.abs(expected).max())


def test_priors_are_equal_for_each_effect_and_shared_by_its_axes(made):
    listed = [c for c in made.candidates if c.listed]
    rivals = [c for c in made.candidates if not c.listed]
    assert listed
    assert rivals
    share = {}
    for candidate in listed + rivals:
        weight = EFFECTS[candidate.effect].weight if candidate.listed else 1.0
        share.setdefault((candidate.listed, candidate.effect), []).append(np.exp(candidate.log_prior) / weight)
    for values in share.values():
        assert np.ptp(values) < 1e-12
    # One that cannot be seen about an axis leaves that part of its prior unused.
    of_all = {candidate.effect for candidate in rivals if candidate.axis is None}
    whole = {
        key: len(EFFECTS[key[1]].axes or (None,)) * values[0] if key[0] else (1 if key[1] in of_all else 3) * values[0]
        for key, values in share.items()
    }
    for own in (True, False):
        assert np.ptp([value for key, value in whole.items() if key[0] == own]) < 1e-12
    assert sum(value for key, value in whole.items() if not key[0]) == pytest.approx(DEFAULT.unlisted_share)


def test_what_cannot_be_seen_or_is_implausible_is_no_candidate(model):
    calibration = model.calibration[:, [9]]
    seen = np.eye(model.size)[:, [0]]
    groups = [
        CandidateColumns("taken up", None, True, [calibration], [{}], np.ones(1), (1e-9, 1e-3), ""),
        CandidateColumns("too small", None, True, [seen], [{}], np.ones(1), (1e-9, 1e-6), ""),
        CandidateColumns("fine", None, True, [seen], [{}], np.ones(1), (1e-9, 100.0), ""),
        CandidateColumns("empty", None, True, [np.empty((model.size, 0))], [{}], np.ones(1), (1e-9, 1.0), ""),
    ]
    candidates, W = place_candidates(groups, model.project_out_nuisance, DEFAULT)
    assert [candidate.effect for candidate in candidates] == ["fine"]
    (option,) = candidates[0].options
    np.testing.assert_array_equal(W[:, option.columns], seen)
