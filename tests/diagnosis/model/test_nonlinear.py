"""Columns of effects that are not linear in their size: gyro tags that are late by much, and errors that follow the rate."""

import numpy as np
import pytest

from diagnosis.inference.amplitudes import fit
from diagnosis.model.candidates import linear_model
from diagnosis.model.linear import Member
from diagnosis.model.nonlinear import build_delay_column, with_true_rates
from diagnosis.model.prepare import prepare
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates, prepared

QUADRATIC = EFFECTS["scale_quadratic"]
DEG = np.deg2rad(1.0)


def model_and_columns(size):
    model = prepared(11, f"time_offset={size}", every_s=4.0).model
    effect = EFFECTS["time_offset"]
    small = model.whitened(model.reading(effect.columns(model.stream, None, {})))
    return model, small, build_delay_column(model, small, (5e-3, 100.0))


@pytest.mark.parametrize("size", [10.0, -10.0])
def test_the_column_of_a_large_offset_gives_it_back_and_leaves_noise(size):
    model, small, large = model_and_columns(size)
    x = model.projected(large)[:, 0]
    fitted = x @ model.y / (x @ x)
    assert abs(fitted - size) < 4 / np.linalg.norm(x)
    dof = model.degrees_of_freedom - 1
    assert np.sum((model.y - fitted * x) ** 2) < dof + 4 * np.sqrt(2 * dof)
    # That of a small one does not leave noise only.
    x = model.projected(small)[:, 0]
    assert np.sum((model.y - x @ model.y / (x @ x) * x) ** 2) > dof + 8 * np.sqrt(2 * dof)


@pytest.mark.parametrize("size", [0.0, 0.05])
def test_a_small_one_has_no_other(size):
    assert model_and_columns(size)[2] is None


def turning(size_ppm, seed):
    """A body that turns at up to 20 deg/s about each axis, seen by a y gyro whose scale factor grows with the rate."""
    t_s = 0.1 * np.arange(12_000)
    rates = np.zeros((t_s.size, 3))
    for axis in range(3):
        fast = np.random.default_rng([axis, 4]).uniform(-20, 20, 15)
        rates[:, axis] = DEG * np.interp(t_s % 80, [0, 20, 30, 60, 70], [0, 0, 1, 1, 0]) * fast[(t_s // 80).astype(int)]
    made = of_rates(rates, 40, 0.1, 2e-6, 1e-3, seed)
    error = 1e-6 * size_ppm * np.rad2deg(np.abs(rates[:, 1])) * rates[:, 1]
    made.gyro.rates[:, 1] += error
    return prepare(made).model


@pytest.mark.parametrize("size", [1000.0, -1000.0])
def test_the_size_is_that_of_the_rate_without_the_effect(size):
    """Of two percent of the fastest turns: at the rates of M0 the column alone is off by about that much of itself."""
    for seed in range(2):
        model = turning(size, seed)
        linear = linear_model(model, [QUADRATIC], rivals=False)
        entry = linear.candidates[linear.find("scale_quadratic:y")]
        member = Member(linear.find("scale_quadratic:y"), 0, int(np.argmin(np.abs(np.log(entry.scales / abs(size))))))
        found = fit(linear, [member])[0]
        assert abs(found.size - size) < 3.5 * found.sigma
        plain = float(linear.X[:, 0] @ linear.y / (linear.X[:, 0] @ linear.X[:, 0]))
        assert abs(plain - size) > 4 * found.sigma


def test_a_small_effect_keeps_its_columns():
    model = turning(20.0, 1)
    linear = linear_model(model, [QUADRATIC], rivals=False)
    assert with_true_rates(model, linear, Member(linear.find("scale_quadratic:y"), 0, 3), QUADRATIC) is linear
