"""Folds of a recording: predictions of M0 against brute force and their own noise, and the closure on them."""

import numpy as np
import pytest

from diagnosis.model.folds import BROAD, START, assign_folds, build_folds
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from tests.diagnosis.recordings import prepared


@pytest.fixture(scope="module")
def model():
    return prepared(3, every_s=300.0).model


def reverse_whitening(model, columns):
    return np.concatenate([block.whitener @ columns[block.rows] for block in model.blocks])


def test_predictions_are_those_of_the_joint_normal_distribution_with_unit_variance(model):
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
        trained = shown[~out].T @ np.linalg.solve(sigma[np.ix_(~out, ~out)], shown[~out])
        np.testing.assert_allclose(fold.train_X.T @ fold.train_X, trained, rtol=1e-4)
        left = shown[out] - gain @ shown[~out]
        np.testing.assert_allclose(fold.left_X.T @ fold.left_X, left.T @ np.linalg.solve(C, left), rtol=1e-4)
    # Over recordings of M0, the mean square of all rows held out is one.
    total, dof = 0.0, 0
    for seed in range(3):
        model = prepared(seed, every_s=300.0).model
        for fold in build_folds(model, np.empty((model.size, 0))):
            total += fold.left_y @ fold.left_y
            dof += fold.left_y.size
    # Folds of one recording share their training parts; a tenth more spread than of independent rows allows for that.
    assert abs(total / dof - 1) < 4.4 * np.sqrt(2 / dof)
