"""Samples that were filled in by straight lines: told from formats, lattices and readings that stand still; on no list."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.detectors.samples import examine
from diagnosis.detectors.straight_samples import chance
from diagnosis.diagnose import diagnose
from tests.diagnosis.detectors.test_own_repeats import NOISE, held, symptoms, turning


def read_as(change, seed=3):
    made = turning(seed)
    return replace(made, gyro=replace(made.gyro, rates=change(made.gyro.rates)))


def filled(rates, length=3, places=(700, 1500, 2300, 4100, 5200)):
    """Some samples by straight lines between their neighbours."""
    out = rates.copy()
    for place in places:
        share = np.arange(1, length + 1)[:, None] / (length + 1)
        out[place : place + length] = (1 - share) * rates[place - 1] + share * rates[place + length]
    return out


def rounded(rates, step):
    return step * np.round(rates / step)


def in_digits(rates):
    return np.array([float(f"{one:.3e}") for one in rates.ravel()]).reshape(rates.shape)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda rates: rates, id="doubles"),
        pytest.param(lambda rates: rates.astype(np.float32).astype(float), id="single precision"),
        pytest.param(lambda rates: rates.astype(np.float16).astype(float), id="half precision"),
        pytest.param(in_digits, id="four digits"),
        pytest.param(lambda rates: rounded(rates, 0.1 * NOISE), id="a number format"),
        pytest.param(lambda rates: rounded(rates, 2 * NOISE), id="a lattice"),
        pytest.param(lambda rates: np.clip(rates, -5e-4, 5e-4), id="clipped"),
        pytest.param(lambda rates: np.where(np.abs(rates) < 1e-3, 0.0, rates), id="dead zones"),
        pytest.param(held, id="stale"),
    ],
)
def test_what_is_straight_for_another_reason_does_not_count(change):
    for seed in range(3):
        assert ("straight_samples", None) not in symptoms(read_as(change, seed))


@pytest.mark.parametrize("digits", [np.float64, np.float32])
def test_filled_samples_are_seen_and_are_on_no_list(digits):
    made = read_as(lambda rates: filled(rates).astype(digits).astype(float))
    test = next(one for one in examine(made).tests if one.statistic == "straight_samples")
    assert test.value == 15
    assert "in 5 stretches of up to 3" in test.text
    assert symptoms(made) == [("straight_samples", None)]
    assert diagnose(made).verdict == "unknown"


@pytest.mark.parametrize("step", [0.0, 0.02, 0.2])
def test_the_chance_of_straight_samples_is_a_bound(step):
    """Of noise with a format and without one, on a body that turns, small p-values are not more frequent than they say."""
    p = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        rates = 50 * np.sin(np.arange(3000)[:, None] / [90.0, 110.0, 70.0]) + rng.standard_normal((3000, 3))
        rates = rounded(rates, step) if step else rates
        p.append(chance(rates, np.ones(2998, dtype=bool), 1.0)[2])
    for limit in (0.01, 0.1):
        assert np.mean(np.array(p) < limit) <= limit + 3 * np.sqrt(limit * (1 - limit) / len(p))
