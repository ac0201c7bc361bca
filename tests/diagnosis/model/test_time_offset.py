"""Gyro tags that are late by much: their columns at the delay that the data give."""

import numpy as np
import pytest

from diagnosis.model.time_offset import compute_delay_shares, fit_delays
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared


def model_and_columns(size):
    model = prepared(11, f"time_offset={size}", every_s=20.0).model
    effect = EFFECTS["time_offset"]
    small = model.whiten(model.reading(effect.columns(model.stream, None, {})))
    return model, small, fit_delays(model, small, (5e-3, 100.0))


def test_the_columns_of_a_large_offset_give_it_back_and_leave_noise():
    size = -10.0
    model, small, large = model_and_columns(size)
    best = max(large, key=lambda one: one.weight)
    x = model.project_out_nuisance(best.columns)[:, 0]
    fitted = x @ model.y / (x @ x)
    assert abs(fitted - size) < 4 / np.linalg.norm(x)
    dof = model.degrees_of_freedom - 1
    assert np.sum((model.y - fitted * x) ** 2) < dof + 4 * np.sqrt(2 * dof)
    # That of a small one does not leave noise only.
    x = model.project_out_nuisance(small)[:, 0]
    assert np.sum((model.y - x @ model.y / (x @ x) * x) ** 2) > dof + 8 * np.sqrt(2 * dof)
    assert sum(one.weight for one in large) == pytest.approx(1.0, abs=1e-12)
    # As where a dead zone makes a gap of hundreds of sigmas, and no delay is anywhere near.
    np.testing.assert_allclose(
        compute_delay_shares(np.array([1e5, 1e5 + 2.0])), [1 / (1 + np.exp(-1)), np.exp(-1) / (1 + np.exp(-1))]
    )
