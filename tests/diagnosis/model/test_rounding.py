"""What rounding leaves: its likelihood against a dense one, its slope against differences, and its bound."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.model.folds import build_shared_columns
from diagnosis.model.rounding import add_rounding, build_kernels, compute_negative_log_likelihood
from tests.diagnosis.recordings import prepared

DEG_H = np.deg2rad(1 / 3600)


@pytest.fixture(scope="module")
def model():
    return prepared(3, every_s=600.0).model


def likelihood(model, theta, kernels):
    rows = [block.rows for block in model.blocks]
    return compute_negative_log_likelihood(theta, model.whiten(model.zeta), build_shared_columns(model), rows, kernels)


def test_its_likelihood_is_a_dense_one_and_its_slope_that_of_differences(model):
    kernels = [one for axis in range(3) for one in build_kernels(model, axis)]
    sizes = np.array([0.3 / np.mean([np.trace(K) / len(K) for K in one]) for one in kernels])
    B = build_shared_columns(model)
    C = np.eye(model.size) + B @ B.T
    for variance, kernel in zip(sizes, kernels, strict=True):
        for block, K in zip(model.blocks, kernel, strict=True):
            C[block.rows, block.rows] += variance * K
    constant = 0.5 * model.size * np.log(2 * np.pi)
    y = model.whiten(model.zeta)
    expected = scipy.stats.multivariate_normal(np.zeros(model.size), C, allow_singular=True).logpdf(y) + constant
    assert -likelihood(model, sizes, kernels)[0] == pytest.approx(expected, abs=1e-4)
    x = np.log(sizes)
    _, slope = likelihood(model, sizes, kernels)
    for k in range(x.size):
        step = np.where(np.arange(x.size) == k, 1e-4, 0.0)
        more, less = (likelihood(model, np.exp(x + way * step), kernels)[0] for way in (1, -1))
        assert (more - less) / 2e-4 == pytest.approx(slope[k], rel=1e-5, abs=1e-5)


def test_what_rounding_adds_is_of_its_axis_and_bounded_by_the_step(model):
    step = 20 * DEG_H
    rough = replace(model, zeta=30 * model.zeta)  # far more than the step explains
    found = add_rounding(rough, np.array([step, 0.0, 0.0]))
    own = build_kernels(model, 0)
    for number, (before, after) in enumerate(zip(model.blocks, found.blocks, strict=True)):
        half = np.linalg.solve(before.whitener, after.whitener)
        added = half @ half.T - np.eye(len(half))
        most = step**2 / 3 * sum(one[number] for one in own)
        assert np.trace(added) > 0
        assert np.linalg.eigvalsh(most - added).min() > -1e-9 * np.trace(most)


def test_half_steps_of_cut_readings_are_no_misfit():
    """Readings cut to a step of one and a half sigmas, with the half step as a nuisance parameter and without it."""
    model = prepared(5, "rate_truncation=1.5e-4").model
    assert model.y @ model.y == pytest.approx(model.degrees_of_freedom, abs=5 * np.sqrt(2 * model.degrees_of_freedom))
    without = replace(model, nuisance_errors=None)
    assert without.y @ without.y > 2 * without.degrees_of_freedom
