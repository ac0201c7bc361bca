"""Number formats: rounded, floored and cut readings, and recordings that leave the format open."""

import numpy as np
import pytest

from diagnosis.detectors.number_format import (
    FORMATS,
    compute_log_likelihood,
)

STEP = 0.37
HOW = {
    "rounded": np.round,
    "floored": np.floor,
    "cut": np.trunc,
}
MOTIONS = {
    "rest at zero": lambda t: 0.0 * t,
    "rest": lambda t: 0.3 + 0.0 * t,
    "slow swing": lambda t: 40 * np.sin(2 * np.pi * t / 3017.3),
    "fast swing": lambda t: 400 * np.sin(2 * np.pi * t / 151.37),
}


def odds(readings, noise):
    """Log odds of each format against rounding."""
    found = compute_log_likelihood([readings * STEP], STEP, noise * STEP)
    return dict(zip(FORMATS, found - found[0], strict=True))


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("noise", [0.3, 3.0])
def test_no_format_is_taken_for_another_of_the_listed(motion, noise):
    rng = np.random.default_rng(4)
    t = np.arange(20_000.0)
    true = MOTIONS[motion](t) + noise * rng.standard_normal(t.size)
    found = {name: odds(how(true), noise) for name, how in HOW.items()}
    assert found["rounded"]["cut"] < 3
    assert found["floored"]["cut"] < 3
    assert found["cut"]["cut"] > -3
    if noise >= 1 and not (motion == "fast swing" and noise > 1):
        assert found["rounded"]["cut"] < -10
        assert found["floored"]["cut"] < -10
        assert found["cut"]["cut"] > 10


def test_readings_of_one_sign_and_rests_in_one_bin_leave_the_format_open():
    rng = np.random.default_rng(5)
    noisy = 400 + 3 * rng.standard_normal(5000)
    assert odds(np.trunc(noisy), 3.0) == dict.fromkeys(FORMATS, 0.0)
    assert odds(np.trunc(0.1 * rng.standard_normal(5000)), 0.1) == dict.fromkeys(FORMATS, 0.0)
