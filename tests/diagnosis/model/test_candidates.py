"""Candidates of a recording: their columns against the simulator, their priors, and the times of steps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from diagnosis.inference.search import Search
from diagnosis.model.candidates import build_linear_model, place_candidates
from diagnosis.model.groups import CandidateColumns
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.periods import make_columns
from diagnosis.model.prepare import prepare
from diagnosis.model.steps import add_finer_times, step_times
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS, setting
from simulator.scenario import override
from simulator.simulate import motion, observe, simulate
from tests.diagnosis.recordings import linear, linear_of, plan, prepared


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


def test_times_of_a_step_are_weighed_by_duration_and_gaps(model):
    times, widths, weights, firsts = step_times(model)
    assert weights.sum() == pytest.approx(1.0)
    gaps = widths > 0
    assert gaps.sum() == len(model.blocks) - 1
    assert weights[gaps].sum() == pytest.approx(0.5)
    # In the middle of each gap, with the sigma of a time that may be anywhere in it.
    for place, width, before, after in zip(times[gaps], widths[gaps], model.blocks[:-1], model.blocks[1:], strict=True):
        low, high = model.t_s[before.steps.stop - 1], model.t_s[after.steps.start]
        assert place == pytest.approx(0.5 * (low + high))
        assert width == pytest.approx((high - low) / np.sqrt(12))
    inside = [(model.blocks[k].steps.start < firsts) & (firsts < model.blocks[k].steps.stop) for k in range(6)]
    shares = [weights[own].sum() for own in inside]
    lengths = [block.elapsed_s[-1] for block in model.blocks]
    np.testing.assert_allclose(shares, 0.5 * np.array(lengths) / sum(lengths), rtol=1e-9)
    assert all(own.sum() >= 3 for own in inside)


def test_finer_times_surround_the_one_that_was_found(model):
    """A step between two times that are tried is found where it is, and no prior is lost."""
    true = 21_250.0
    linear_one = linear_of(("bias_step", "bias_drift"), 5, f"bias_step:y=3,time_s={true}")
    k = linear_one.find("bias_step:y")
    search = Search(linear_one)
    member = search.optimise_members((SelectedCandidate(k, 0, 0),)).members[0]
    coarse = float(linear_one.option(member).parameters["time_s"])
    finer = linear_one.refine(linear_one, member)
    before, after = linear_one.candidates[k], finer.candidates[k]
    assert np.exp(after.log_weights).sum() == pytest.approx(np.exp(before.log_weights).sum())
    assert after.options[: len(before.options)] == tuple(
        replace(o, log_weight=a.log_weight) for o, a in zip(before.options, after.options, strict=False)
    )
    chosen = Search(finer).optimise_members((member,)).members[0]
    fine = float(finer.option(chosen).parameters["time_s"])
    assert abs(fine - true) < 32 < abs(coarse - true)  # the spacing of the finer times
    # The new columns are those of the effect, and projected like the others.
    option = finer.option(chosen)
    np.testing.assert_allclose(finer.X[:, option.start], finer.projected(finer.W[:, option.start]), atol=1e-12)
    # What has no time has nothing to refine.
    drift = SelectedCandidate(linear_one.find("bias_drift:y"), 0, 0)
    effect = EFFECTS["bias_drift"]
    assert add_finer_times(prepared(5, f"bias_step:y=3,time_s={true}").model, linear_one, drift, effect) is linear_one


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


def test_without_rivals_the_listed_effects_have_all_of_the_prior(model):
    alone = build_linear_model(model, [EFFECTS["bias_drift"], EFFECTS["time_offset"]], rivals=False)
    assert sum(np.exp(candidate.log_prior) for candidate in alone.candidates) == pytest.approx(1.0)
    assert not [c for c in alone.candidates if not c.listed]
    nothing = build_linear_model(model, [], rivals=False)
    assert nothing.candidates == ()
    assert nothing.W.shape == (model.size, 0)


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


def test_options_of_a_process_have_scales_of_their_own():
    """A quiet option reaches as far above its noise as a loud one, none beyond, and each has its own prior over its scales."""
    rng = np.random.default_rng(2)
    loud, quiet = 100 * rng.standard_normal((80, 3)), rng.standard_normal((80, 3))
    group = CandidateColumns(
        "walk", "x", True, [loud, quiet], [{"gaps": "grow"}, {"gaps": "hold"}], np.array([0.5, 0.5]), (0.0, 1e9), "", True
    )
    (entry,), _ = place_candidates([group], lambda X: X, DEFAULT)
    for k, columns in enumerate((loud, quiet)):
        largest = np.linalg.norm(columns, axis=0).max()
        ratios = entry.scales[~entry.outside_window[k]] * largest
        assert 1 <= ratios.min() < 2
        assert 150 < ratios.max() <= 300 * (1 + 1e-9)
    own = (~entry.outside_window).sum(axis=1)
    np.testing.assert_allclose(np.exp(entry.log_weights) * own / entry.scales.size, 0.5, rtol=1e-12)
    # A search holds neither where it cannot be, and averages over all that it can be.
    alone = [
        place_candidates([replace(group, columns=[columns], parameters=[{}], weights=np.ones(1))], lambda X: X, DEFAULT)
        for columns in (loud, quiet)
    ]
    y = 20 * quiet[:, 0] + rng.standard_normal(80)

    def model(candidates, X):
        return LinearModel(y=y, X=X, W=X, candidates=candidates, dof=80, projected=lambda values: values)

    table = Search(model((entry,), np.hstack([loud, quiet]))).tables(0, None)
    assert np.all(np.isneginf(table[entry.outside_window]))
    both = Search(model((entry,), np.hstack([loud, quiet]))).score(0, ()).average
    each = [Search(model(*made)).score(0, ()).average for made in alone]
    assert both == pytest.approx(logsumexp(each) - np.log(2), abs=0.2)


@pytest.mark.parametrize(
    ("arw_deg", "sigma_deg"),
    [
        pytest.param(1e-2, 0.3, id="consumer MEMS"),
        pytest.param(None, None, id="fibre-optic"),
        pytest.param(1e-6, 3e-4, id="HRG"),
    ],
)
def test_sizes_that_show_are_plausible_of_a_gyro_of_any_grade(made, arw_deg, sigma_deg):
    """Where a size is cut off short of what shows, another cause would be named; the plan itself has a fibre-optic gyro."""
    if arw_deg is not None:
        changes = {"gyro.arw_deg_per_sqrt_s": arw_deg, "reference.sigma_deg": (sigma_deg,) * 3}
        recording = simulate(override(plan(), changes), seed=1)
        made = build_linear_model(prepare(recording).model, list(EFFECTS.values()), rivals=False)
    shown = [one for one in made.candidates if one.listed and one.unit.startswith("deg")]
    for one in shown:
        norm = max(np.linalg.norm(made.X[:, own.start : own.start + own.count], axis=0).max() for own in one.options)
        assert norm * one.scales[0] <= 8
        assert norm * one.scales[-1] >= 25
    assert len({one.effect for one in shown}) >= 10
