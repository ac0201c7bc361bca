"""Sizes of effects that are not linear in the rate, where they are a good part of it."""

import numpy as np
import pytest

from diagnosis.inference.amplitudes import fit
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import SelectedCandidate
from diagnosis.model.prepare import prepare
from diagnosis.model.time_offset import compute_delay_shares, fit_delays
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates, prepared

QUADRATIC = EFFECTS["scale_quadratic"]
DEG = np.deg2rad(1.0)


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


def test_the_size_is_that_of_the_rate_without_the_effect():
    """Of two percent of the fastest turns: at the rates of M0 the column alone is off by about that much of itself."""
    size = -1000.0
    linear = build_linear_model(turning(size, 1), [QUADRATIC], rivals=False)
    entry = linear.candidates[linear.find("scale_quadratic:y")]
    member = SelectedCandidate(linear.find("scale_quadratic:y"), 0, int(np.argmin(np.abs(np.log(entry.scales / abs(size))))))
    found = fit(linear, [member])[0]
    assert abs(found.size - size) < 3.5 * found.sigma
    plain = float(linear.X[:, 0] @ linear.y / (linear.X[:, 0] @ linear.X[:, 0]))
    assert abs(plain - size) > 4 * found.sigma


def model_and_columns(size):
    model = prepared(11, f"time_offset={size}", every_s=20.0).model
    effect = EFFECTS["time_offset"]
    small = model.whiten(model.reading(effect.columns(model.stream, None, {})))
    return model, small, fit_delays(model, small, (5e-3, 100.0))


def test_the_columns_of_a_large_offset_give_it_back_and_leave_noise():
    size = -10.0
    model, small, large = model_and_columns(size)
    best, _ = max(large, key=lambda one: one[1])
    x = model.project_out_nuisance(best)[:, 0]
    fitted = x @ model.y / (x @ x)
    assert abs(fitted - size) < 4 / np.linalg.norm(x)
    dof = model.degrees_of_freedom - 1
    assert np.sum((model.y - fitted * x) ** 2) < dof + 4 * np.sqrt(2 * dof)
    # That of a small one does not leave noise only.
    x = model.project_out_nuisance(small)[:, 0]
    assert np.sum((model.y - x @ model.y / (x @ x) * x) ** 2) > dof + 8 * np.sqrt(2 * dof)
    assert sum(weight for _, weight in large) == pytest.approx(1.0, abs=1e-12)
    # As where a dead zone makes a gap of hundreds of sigmas, and no delay is anywhere near.
    np.testing.assert_allclose(
        compute_delay_shares(np.array([1e5, 1e5 + 2.0])), [1 / (1 + np.exp(-1)), np.exp(-1) / (1 + np.exp(-1))]
    )
