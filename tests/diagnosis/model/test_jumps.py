"""Steps at each place of a recording, and a state that no random process may be named for."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.diagnose import diagnose
from diagnosis.inference.few_jumps import log_evidence
from diagnosis.model.candidates import linear_model
from diagnosis.model.jumps import jumps_instead, place_weights, step_columns, turn_places
from diagnosis.model.linear import Member
from diagnosis.model.prepare import prepare
from diagnosis.model.steps import switched_columns
from diagnosis.settings import DEFAULT
from gyrocal.recording import Recording
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared, recorded


@pytest.fixture(scope="module")
def model():
    return prepared(11).model


def test_a_step_at_a_cell_is_the_step_of_the_bias_from_there_on(model):
    effect, deg_h = EFFECTS["bias_step"], np.deg2rad(1.0) / 3600
    steps = step_columns(model, 1, on_references=False)
    for cell in (3, 40, len(model.cells.first) - 2):
        listed = model.projected(switched_columns(model, effect, "y", {}, model.cells.first[[cell]]))[:, 0]
        own = steps[:, cell] * deg_h
        # The rate is that of the body, and G mixes a few thousandths of the gyros.
        own *= np.sign(own @ listed) * np.linalg.norm(listed) / np.linalg.norm(own)
        assert np.linalg.norm(own - listed) < 0.005 * np.linalg.norm(listed)


def test_a_step_of_the_references_is_there_from_its_observation_on(model):
    """From the first on it is a rotation, which G takes up but for its departure from one of some thousandths."""
    steps = step_columns(model, 2, on_references=True)
    assert np.linalg.norm(steps[:, 0]) < 1e-3 * np.linalg.norm(steps[:, 20])
    difference = model.projected(model.reference_columns[2][:, [7]])[:, 0]
    np.testing.assert_allclose(steps[:, 7] - steps[:, 8], difference, atol=1e-9 * np.abs(difference).max())


@pytest.mark.parametrize("on_references", [False, True])
def test_weights_are_a_prior_that_leaves_no_place_out(model, on_references):
    weights = place_weights(model, on_references)
    assert weights.size == step_columns(model, 0, on_references).shape[1]
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() > 0.4 / weights.size


def test_the_turns_of_the_body_are_places_of_their_own(model):
    """Each is inside a slew of the plan; between two intervals there is one where the second begins."""
    inside, with_gaps = turn_places(model, False)
    for cell in inside:
        block = model.blocks[model.cells.interval[cell]].steps
        away = np.linalg.norm(model.rates - np.median(model.rates[block], axis=0), axis=1)
        assert away[model.cells.first[cell] : model.cells.last[cell] + 1].max() > np.deg2rad(0.01)
    assert set(with_gaps) - set(inside) <= set(np.flatnonzero(np.diff(model.cells.interval)) + 1)
    assert len(with_gaps) > len(inside)
    after, _ = turn_places(model, True)
    times = model.t_s[model.cells.first[inside]]
    assert (model.observation_t_s[after] >= times[: after.size]).all()


def test_a_step_at_each_slew_is_no_random_process():
    recording = recorded(5, every_s=60.0)
    model = prepare(recording).model
    rates = recording.gyro.rates.copy()
    for cell, size in zip(turn_places(model, False)[0], np.random.default_rng(2).normal(0.0, 0.6, 40), strict=False):
        rates[recording.gyro.t_s >= model.t_s[model.cells.first[cell]], 1] += np.deg2rad(size) / 3600
    answer = diagnose(replace(recording, gyro=replace(recording.gyro, rates=rates)))
    assert answer.verdict == "unknown"


def on_and_off(recording: Recording, size_deg_h: float, shares: list[tuple[float, float]]) -> Recording:
    """A bias of the gyro about z that is there in some shares of the samples."""
    share, rates = np.arange(recording.gyro.t_s.size) / recording.gyro.t_s.size, recording.gyro.rates.copy()
    for low, high in shares:
        rates[(share >= low) & (share < high), 2] += np.deg2rad(size_deg_h) / 3600
    return replace(recording, gyro=replace(recording.gyro, rates=rates))


def test_a_bias_that_is_on_or_off_is_no_random_process():
    """Without their evidence it is a random walk with a probability of 0.71."""
    answer = diagnose(on_and_off(recorded(5, every_s=60.0), 0.4, [(0.1, 0.27), (0.45, 0.62), (0.7, 0.75)]))
    assert answer.present
    assert answer.verdict == "unknown"
    assert answer.p_values["check: a few jumps in place of bias_random_walk:z"] < 0.1


def test_two_causes_that_stand_for_one_state_are_not_named():
    """A step of the bias with one of G, or a dead zone, fits a state that is on once as well; they are two, and it is one."""
    answer = diagnose(on_and_off(recorded(5, every_s=60.0), 0.8, [(0.21, 0.33)]))
    assert answer.verdict == "unknown"


def test_what_the_jumps_are_weighed_against(model):
    """By hand: densities of the observations, averaged over the scales, and the prior of the second cause."""
    linear = linear_model(model, [EFFECTS["bias_drift"], EFFECTS["scale_quadratic"]])
    number = {one.label: k for k, one in enumerate(linear.candidates)}
    members = tuple(Member(number[label], 0, 2) for label in ("bias_drift:z", "scale_quadratic:z"))
    alone, both = jumps_instead(model, linear, members[:1], EFFECTS), jumps_instead(model, linear, members, EFFECTS)
    first, second = (linear.candidate(one) for one in members)

    def log_density(scale):
        C = linear.X[:, linear.design(members[:1])[0]] * scale
        return scipy.stats.multivariate_normal.logpdf(linear.y, np.zeros(linear.y.size), np.eye(linear.y.size) + C @ C.T)

    flat = log_density(0.0)
    of_scales = [log_density(scale) - flat for scale in first.scales]
    own = np.logaddexp.reduce(of_scales) - np.log(len(of_scales))
    D = step_columns(model, 2, on_references=False)
    jumps = log_evidence(D.T @ linear.y, D.T @ D, place_weights(model, False), turn_places(model, False))
    assert alone[0].log_bayes == pytest.approx(jumps - of_scales[2] - (own - max(of_scales)), abs=1e-6)
    assert alone[0].log_prior == 0
    assert {one.label for one in both} == {first.label, second.label}
    for one in both:
        assert one.log_prior == pytest.approx(-second.log_prior - np.log(DEFAULT.another) - np.log(2))
