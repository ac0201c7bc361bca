"""The remainder: its likelihood against a dense one, its slope against differences, and the sizes that it finds."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.model.folds import build_shared_columns
from diagnosis.model.remainder import (
    Remainder,
    _compute_negative_log_likelihood,
    add_remainder,
    add_rounding,
    build_processes,
    estimate_remainder,
    summarise_remainder,
)
from tests.diagnosis.recordings import prepared

DEG_H = np.deg2rad(1 / 3600)


@pytest.fixture(scope="module")
def model():
    return prepared(3, every_s=600.0).model


@pytest.fixture(scope="module")
def processes(model):
    return build_processes(model)


def none(model):
    return np.zeros((model.size, 0))


def some_sizes(processes):
    return np.array([0.3 / np.mean([np.trace(K) / len(K) for K in one.blocks]) for one in processes])


def log_likelihood(model, noise, theta, processes):
    y, rows = model.whiten(model.zeta), [block.rows for block in model.blocks]
    return -_compute_negative_log_likelihood(noise, theta, y, build_shared_columns(model), rows, processes)[0]


def dense(model, noise, theta, processes):
    C = noise * np.eye(model.size)
    for variance, process in zip(theta, processes, strict=True):
        for block, K in zip(model.blocks, process.blocks, strict=True):
            C[block.rows, block.rows] += variance * K
    return C


def test_its_likelihood_is_that_of_a_dense_normal_distribution(model, processes):
    theta, B = some_sizes(processes), build_shared_columns(model)
    y = model.whiten(model.zeta)
    C = dense(model, 1.3, theta, processes) + B @ B.T
    constant = 0.5 * model.size * np.log(2 * np.pi)
    expected = scipy.stats.multivariate_normal(np.zeros(model.size), C, allow_singular=True).logpdf(y) + constant
    assert log_likelihood(model, 1.3, theta, processes) == pytest.approx(expected, abs=1e-4)


def test_its_slope_is_that_of_differences(model, processes):
    y, B = model.whiten(model.zeta), build_shared_columns(model)
    rows = [block.rows for block in model.blocks]
    x = np.log(np.concatenate([[1.3], some_sizes(processes)]))

    def value(at):
        return _compute_negative_log_likelihood(np.exp(at[0]), np.exp(at[1:]), y, B, rows, processes)

    _, slope = value(x)
    for k in range(x.size):
        step = np.where(np.arange(x.size) == k, 1e-4, 0.0)
        assert (value(x + step)[0] - value(x - step)[0]) / 2e-4 == pytest.approx(slope[k], rel=1e-5, abs=1e-5)


def test_the_noise_of_the_model_with_it_is_both_together(model, processes):
    remainder = Remainder(1.3, some_sizes(processes), processes, 0.0)
    noisy = add_remainder(model, remainder)
    block, own = model.blocks[0], noisy.blocks[0]
    C = dense(model, 1.3, remainder.variances, processes)[block.rows, block.rows]
    both = block.whitener @ C @ block.whitener.T
    assert own.whitener @ own.whitener.T == pytest.approx(both, rel=1e-9, abs=1e-12 * np.abs(both).max())


def test_there_is_none_without_a_misfit():
    model = prepared(3, every_s=300.0).model
    processes = build_processes(model)
    found = estimate_remainder(model, processes, none(model))
    nothing = log_likelihood(model, 1.0, np.zeros(len(processes)), processes)
    # Sixteen sizes that cannot be negative gain about a quarter of sixteen χ² of one degree of freedom.
    assert 0 <= found.log_likelihood - nothing < 12
    noisy = add_remainder(model, found)
    assert float(noisy.y @ noisy.y) == pytest.approx(float(model.y @ model.y), rel=0.15)


def test_a_bias_that_wanders_is_found_on_the_gyros_side():
    model = prepared(4, "bias_markov:y=2,time_constant_s=2000", every_s=300.0).model
    processes = build_processes(model)
    found = estimate_remainder(model, processes, none(model))
    said = summarise_remainder(found, 1.0, (0.9, 1.0), ())
    assert said.side == "gyro"
    assert said.gyro_deg_h[1] == pytest.approx(2.0, rel=0.5)  # a few correlation times in all
    assert max(said.gyro_deg_h[0], said.gyro_deg_h[2]) < 0.5
    noisy = add_remainder(model, found)
    assert float(noisy.y @ noisy.y) / noisy.degrees_of_freedom == pytest.approx(1.0, abs=0.2)


def test_what_rounding_adds_is_of_its_axis_and_bounded_by_the_step(model, processes):
    step = 20 * DEG_H
    rough = replace(model, zeta=30 * model.zeta)  # far more than the step explains
    found = add_rounding(rough, np.array([step, 0.0, 0.0]))
    own = [one for one in processes if (one.side, one.axis) == ("gyro", "x")]
    for number, (before, after) in enumerate(zip(model.blocks, found.blocks, strict=True)):
        half = np.linalg.solve(before.whitener, after.whitener)
        added = half @ half.T - np.eye(len(half))
        most = step**2 / 3 * sum(one.blocks[number] for one in own)
        assert np.trace(added) > 0
        assert np.linalg.eigvalsh(most - added).min() > -1e-9 * np.trace(most)
