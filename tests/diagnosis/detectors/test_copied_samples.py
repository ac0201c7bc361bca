"""Samples that come a second time: told from formats, lattices, stale samples and clipped readings, and no listed effect."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.detectors.copied_samples import chance, copied_samples, copies
from diagnosis.detectors.report import SampleReport
from diagnosis.detectors.samples import examine
from diagnosis.diagnose import diagnose
from tests.diagnosis.detectors.test_own_repeats import NOISE, held, symptoms, turning


def read_as(change, seed=3):
    made = turning(seed)
    return replace(made, gyro=replace(made.gyro, rates=change(made.gyro.rates)))


def resent(rates, length=8, places=(900, 2500, 4100)):
    """Packets that come again in place of the next one."""
    out = rates.copy()
    for place in places:
        out[place : place + length] = rates[place - length : place]
    return out


def rounded(rates, step):
    return step * np.round(rates / step)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda rates: rates, id="doubles"),
        pytest.param(lambda rates: rates.astype(np.float16).astype(float), id="half precision"),
        pytest.param(lambda rates: rounded(rates, 0.1 * NOISE), id="a number format"),
        pytest.param(lambda rates: rounded(rates, 2 * NOISE), id="a lattice"),
        pytest.param(lambda rates: rounded(rates, 300 * NOISE), id="a coarse lattice"),
        pytest.param(lambda rates: np.clip(rates, -5e-4, 5e-4), id="clipped"),
        pytest.param(lambda rates: np.where(np.abs(rates) < 1e-3, 0.0, rates), id="dead zones"),
        pytest.param(held, id="stale"),
    ],
)
def test_what_comes_again_for_another_reason_does_not_count(change):
    for seed in range(3):
        assert ("copied_samples", None) not in symptoms(read_as(change, seed))


@pytest.mark.parametrize("step", [0.0, 0.1])
def test_packets_that_come_again_are_seen_and_are_on_no_list(step):
    made = read_as(lambda rates: resent(rounded(rates, step * NOISE) if step else rates))
    test = next(one for one in examine(made).tests if one.statistic == "copied_samples")
    assert test.value == 24
    assert "the longest 8 samples later" in test.text
    assert symptoms(made) == [("copied_samples", None)]
    assert diagnose(made).verdict == "unknown"


def test_copies_are_found_wherever_they_are():
    rng = np.random.default_rng(1)
    rates = rng.standard_normal((5000, 3))
    every = np.ones(5000, dtype=bool)
    assert copies(rates, every, every).count == 0
    rates[4000:4005], rates[10:13] = rates[300:305], rates[2000:2003]
    found = copies(rates, every, every)
    assert (found.count, found.longest, found.samples, found.later) == (2, 5, 8, 3700)
    follows = every.copy()
    follows[302] = False  # a gap splits the longer one in two, of which one is too short
    found = copies(rates, every, follows)
    assert (found.count, found.longest, found.samples) == (2, 3, 6)


@pytest.mark.parametrize("step", [0.8, 0.3])
def test_the_chance_of_copies_is_a_bound(step):
    """Of white noise on a lattice, runs as long as the longest are at least as rare as is said."""
    longest, p = [], []
    for seed in range(100):
        rates = rounded(np.random.default_rng(seed).standard_normal((1500, 3)), step)
        every = np.ones(len(rates), dtype=bool)
        longest.append(copies(rates, every, every).longest)
        p.append(chance(rates, longest[-1], 1.0))
    assert max(longest) >= (3 if step > 0.5 else 0)
    for limit in (0.01, 0.1):
        assert np.mean(np.array(p) < limit) <= limit + 3 * np.sqrt(limit * (1 - limit) / len(p))
    # Ten in a row would be no chance, and are not said to be any.
    assert chance(rates, 10, 1.0) < 1e-5


def test_nothing_is_said_of_samples_without_noise():
    made = turning()
    none = np.zeros(len(made.gyro.t_s), dtype=bool)
    report = SampleReport([], [], made.gyro.rates, np.zeros(made.gyro.rates.shape), none, none)
    copied_samples(report, read_as(resent), ~none, 0.0)
    assert [one.p_value for one in report.tests] == [1.0]
