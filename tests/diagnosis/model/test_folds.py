"""Folds of a recording: predictions of M0 against brute force and their own noise, and the closure on them."""

import numpy as np
import pytest

from diagnosis.inference.closure import compute_closure
from diagnosis.inference.search import Search
from diagnosis.model.folds import BROAD, PARTS, START, assign_folds, build_folds, reverse_whitening
from diagnosis.model.linear import SelectedCandidate
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from tests.diagnosis.recordings import linear_of, prepared, recorded

ORBITAL = "bias_orbital:z=0.3,phase_deg=25"


@pytest.fixture(scope="module")
def model():
    return prepared(3, every_s=300.0).model


def member(made, label):
    search = Search(made)
    score = search.score(made.find(label), ())
    return SelectedCandidate(made.find(label), score.option, score.scale)


def test_every_observation_is_held_out_once_and_every_interval_has_a_share_in_each_fold(model):
    part = assign_folds(model)
    assert set(part) == set(range(PARTS))
    for number in range(len(model.blocks)):
        own = part[model.observation_block == number]
        if own.size >= PARTS:
            assert set(own) == set(range(PARTS))
        # In one stretch each, so that what is held out lies apart in time.
        assert (np.diff(own) != 0).sum() <= PARTS
    first = [part[model.observation_block == number][0] for number in range(len(model.blocks))]
    assert len(set(first)) == len(first)


def test_predictions_are_those_of_the_joint_normal_distribution(model):
    """Mean and covariance of one fold from the inverse of the training part's covariance, with broad priors on what M0 fits."""
    sigma = np.zeros((model.size, model.size))
    for block in model.blocks:
        sigma[block.rows, block.rows] = block.whitener @ block.whitener.T
    scale = np.concatenate([np.full(3 * len(model.blocks), START), BROAD * PLAUSIBLE_RANGE])
    columns = reverse_whitening(model, np.hstack([model.starts, model.calibration]))
    sigma += (columns * scale) @ (columns * scale).T
    W = np.random.default_rng(1).standard_normal((model.size, 2))
    part = np.repeat(assign_folds(model), 3)
    for number, fold in enumerate(build_folds(model, W)):
        if number not in (0, 5):
            continue
        out = part == number
        gain = np.linalg.solve(sigma[np.ix_(~out, ~out)], sigma[np.ix_(~out, out)]).T
        C = sigma[np.ix_(out, out)] - gain @ sigma[np.ix_(~out, out)]
        error = model.zeta[out] - gain @ model.zeta[~out]
        assert fold.left_y @ fold.left_y == pytest.approx(error @ np.linalg.solve(C, error), rel=1e-4)
        assert fold.train_y @ fold.train_y == pytest.approx(
            model.zeta[~out] @ np.linalg.solve(sigma[np.ix_(~out, ~out)], model.zeta[~out]), rel=1e-4
        )
        shown = reverse_whitening(model, W)
        left = shown[out] - gain @ shown[~out]
        np.testing.assert_allclose(fold.left_X.T @ fold.left_X, left.T @ np.linalg.solve(C, left), rtol=1e-4)


def test_errors_of_m0s_predictions_have_unit_variance():
    """Over recordings of M0, the mean square of all rows held out is one."""
    total, dof = 0.0, 0
    for seed in range(3):
        model = prepared(seed, every_s=300.0).model
        for fold in build_folds(model, np.empty((model.size, 0))):
            total += fold.left_y @ fold.left_y
            dof += fold.left_y.size
    # Folds of one recording share their training parts; a tenth more spread than of independent rows allows for that.
    assert abs(total / dof - 1) < 4.4 * np.sqrt(2 / dof)


def test_closure_of_the_truth_of_nothing_and_of_a_wrong_effect():
    made = linear_of(("bias_orbital", "scale_quadratic"), 21, ORBITAL)
    named = [member(made, "bias_orbital:z")]
    right = compute_closure(made, named)
    nothing = compute_closure(made, [])
    wrong = compute_closure(made, [member(made, "scale_quadratic:y")])
    assert right.closed > 0.85
    assert right.interval_90[0] < right.closed < right.interval_90[1]
    assert nothing.closed == pytest.approx(0.0, abs=1e-12)
    assert wrong.closed < 0.2
    assert right.floor == pytest.approx(1.0)
    assert right.split == made.split == "an eighth of each interval at a time"
    assert set(right.by_interval["interval"]) == {interval.name for interval in recorded(21, ORBITAL).intervals}


def test_a_step_that_begins_in_a_fold_is_still_predicted():
    made = linear_of(("bias_step",), 23, "bias_step:y=0.5,time_s=22000")
    found = compute_closure(made, [member(made, "bias_step:y")])
    assert found.closed > 0.85
