"""Candidates of a recording: their columns against the simulator, their priors, and the times of steps."""

import numpy as np
import pytest

from diagnosis.model.candidates import build_linear_model, place_candidates
from diagnosis.model.linear import CandidateColumns, Room, SelectedCandidate
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.periods import make_columns
from diagnosis.model.steps import FINE_STEP_TIMES, MOST_MOMENTS, ResidualProducts, add_step_times
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS, setting
from simulator.simulate import motion, observe
from tests.diagnosis.recordings import linear, plan, prepared


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


def test_priors_are_equal_for_each_effect_and_shared_by_its_axes():
    made = linear(3)
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


def test_what_cannot_be_seen_or_is_implausible_is_no_candidate():
    model = prepared(3).model
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


RNG = np.random.default_rng(1)


def test_columns_are_copied_where_there_is_no_room_or_others_have_it():
    room = Room(np.empty((5, 6)))
    room.memory[:, :3], room.used = RNG.standard_normal((5, 3)), 3
    first = room.memory[:, :3]
    one, other = RNG.standard_normal((2, 5, 2))
    beside = room.append_columns(first, one)
    # A second model made from the first columns must not write over those of the first.
    again = room.append_columns(first, other)
    np.testing.assert_array_equal(beside[:, 3:], one)
    np.testing.assert_array_equal(again[:, 3:], other)
    full = room.append_columns(beside, other)
    assert not np.shares_memory(full, beside)
    np.testing.assert_array_equal(full, np.hstack([beside, other]))
    elsewhere = RNG.standard_normal((5, 5))
    np.testing.assert_array_equal(room.append_columns(elsewhere, one[:, :1]), np.hstack([elsewhere, one[:, :1]]))


BIAS, SCALE = EFFECTS["bias_step"], EFFECTS["g_matrix_step"]


@pytest.fixture(scope="module")
def stepped():
    """A step of G between the times that are tried, and its linear model."""
    one = prepared(11, "g_matrix_step:y=3000,toward=y,time_s=21456")
    return one.model, build_linear_model(one.model, [BIAS, SCALE], rivals=False)


def test_a_likelihood_ratio_is_that_of_the_dense_covariance(stepped):
    _, linear = stepped
    first = linear.find("bias_step:x")
    members = (SelectedCandidate(first, 1, 2), SelectedCandidate(linear.find("bias_step:z"), 3, 1))
    places, scales, _ = linear.build_design(members)
    C = linear.X[:, places] * scales
    S = np.eye(len(linear.y)) + C @ C.T
    X = linear.X[:, :3] + linear.X[:, 3:6]
    solved = np.linalg.solve(S, X)
    expected = (solved.T @ linear.y) ** 2 / (2 * np.einsum("nk,nk->k", X, solved))
    np.testing.assert_allclose(ResidualProducts(linear, members).log_ratio(X), expected, rtol=1e-8)


def test_the_moment_between_two_that_are_tried_is_found(stepped):
    model, linear = stepped
    place = linear.find("g_matrix_step:y")
    finer = add_step_times(model, linear, {one.name: one for one in (BIAS, SCALE)}, [((), 20.0)])
    more = finer.candidates[place].options[len(linear.candidates[place].options) :]
    best = max(more, key=lambda one: abs(finer.X[:, one.start] @ finer.y) / np.linalg.norm(finer.X[:, one.start]))
    assert best.parameters["toward"] == "y"
    assert abs(best.parameters["time_s"] - 21456) < 60  # half of the spacing of the references
    assert abs(finer.X[:, best.start] @ finer.y) > 0.99 * max(
        abs(finer.X[:, k] @ finer.y) / np.linalg.norm(finer.X[:, k]) for k in range(finer.X.shape[1])
    ) * np.linalg.norm(finer.X[:, best.start])
    # The prior of the step as a whole stays what it was, and no candidate grows without bound.
    for one, other in zip(linear.candidates, finer.candidates, strict=True):
        assert np.exp(other.log_weights).sum() == pytest.approx(np.exp(one.log_weights).sum())
        assert len(other.options) <= len(one.options) + MOST_MOMENTS * FINE_STEP_TIMES
