"""Rests and their biases against simulated ones."""

import numpy as np
import pytest

from gyrocal import Attitudes, GyroStream, InputError, Interval, Recording, calibrate
from gyrocal.rests import compare_rests

RESTS = [(0, 1000), (3000, 4200), (5000, 6000)]


@pytest.mark.parametrize("sigma", [1e-4, 1e-3])
def test_rests_of_one_bias_do_not_differ_and_a_step_of_the_bias_is_said(sigma):
    rng, t = np.random.default_rng(4), 0.01 * np.arange(6000)
    said = [compare_rests(t, sigma * rng.normal(size=(6000, 3)) + 0.01, RESTS)[0] for _ in range(200)]
    assert said == [""] * 200
    rates = sigma * rng.normal(size=(6000, 3)) - [0.01, 0.02, 0.03]
    rates[4500:, 1] += sigma
    text, change = compare_rests(t, rates, RESTS)
    assert "b_y is" in text
    assert "at 50 s" in text
    np.testing.assert_allclose(np.abs(change), [0, sigma, 0], atol=5 * sigma * np.sqrt(2 / 1000))


def test_a_bias_that_differs_between_rests_is_the_reason_of_a_refusal():
    """The body turns once between two rests; the bias of z steps while it turns."""
    rng, t = np.random.default_rng(5), 0.1 * np.arange(6000)
    rate = np.where((t > 100) & (t < 160), 0.02, 0.0)
    angle = np.append(0.0, np.cumsum(rate * 0.1))[::10]
    rates = np.outer(rate, [1.0, 0, 0]) + 1e-4 * rng.normal(size=(6000, 3))
    rates[1300:, 2] += 0.01
    t_ref, zero = np.arange(601.0), np.zeros(601)
    q = np.stack([np.sin(angle / 2), zero, zero, np.cos(angle / 2)], axis=1)
    references = Attitudes(t_ref, q, np.full((601, 3), 1e-4))
    gyro = GyroStream(t, rates, 0.1, 1e-4, np.eye(3), np.zeros(3))
    made = Recording("step", "2000-01-01T00:00:00Z", gyro, references, (Interval("whole", "", 0.0, 600.0),))
    with pytest.raises(InputError, match=r"b_z is .* and -0\.57.* deg/s .* sigmas apart; use intervals") as refusal:
        calibrate(made)
    assert "are the rates in deg/s" not in str(refusal.value)
