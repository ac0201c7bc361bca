"""Readings of one gyro that repeat: told from number formats, zeros, clipping and stale samples, and no listed effect."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.detectors.repeats import find_repeats
from diagnosis.detectors.samples import examine
from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import of_rates

SAMPLE_S, ARW = 0.1, 1e-5
NOISE = ARW / np.sqrt(SAMPLE_S)


def turning(seed=3, count=6000):
    """A body that turns slowly and less slowly, about all axes."""
    t_s = SAMPLE_S * np.arange(count)
    rates = 2e-3 * np.sin(2 * np.pi * t_s[:, None] / np.array([170.0, 230.0, 310.0]))
    return of_rates(rates, 50, SAMPLE_S, ARW, 2e-5, seed)


def read_as(recording, change, axis=2):
    rates = recording.gyro.rates.copy()
    rates[:, axis] = change(rates[:, axis])
    return replace(recording, gyro=replace(recording.gyro, rates=rates))


def held(x, every=400, length=20):
    """Readings that stand still for a while, now and then."""
    out = x.copy()
    for low in range(every, len(x) - length, every):
        out[low : low + length] = x[low - 1]
    return out


def symptoms(recording):
    return [(one.kind, one.axis) for one in examine(recording).symptoms]


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda x: x.astype(np.float16).astype(float), id="half precision"),
        pytest.param(lambda x: np.round(x / (3 * NOISE)) * 3 * NOISE, id="a lattice"),
        pytest.param(lambda x: np.where(np.abs(x) < 2e-4, 0.0, x), id="zeros"),
        pytest.param(lambda x: np.clip(x, -1.5e-3, 1.5e-3), id="clipped"),
    ],
)
def test_what_repeats_for_another_reason_does_not_count(change):
    assert ("own_repeats", "z") not in symptoms(read_as(turning(), change))


def test_readings_that_are_held_or_hardly_change_are_seen_and_are_on_no_list():
    for digits in (np.float64, np.float32):
        made = read_as(turning(), lambda x, digits=digits: held(x.astype(digits).astype(float)))
        assert symptoms(made) == [("own_repeats", "z")]
    found = diagnose(made)
    assert found.verdict == "unknown"
    assert any("the same as before while the others change" in one.text for one in found.where)
    found = diagnose(read_as(turning(count=1500), np.zeros_like))
    assert (found.p_value < 1e-100, found.verdict) == (True, "unknown")
    coarse = diagnose(read_as(turning(count=1500), lambda x: 20 * NOISE * np.round(x / (20 * NOISE)), [0, 1, 2]))
    assert (coarse.p_value < 1e-100, coarse.verdict) == (True, "group")


SAMPLES = 6000


def repeat(share, seed=2):
    """Continuous readings (n, 3) of which a share repeats the one before, and which those are."""
    rng = np.random.default_rng(seed)
    repeats = rng.random(SAMPLES) < share
    repeats[0] = False
    source = np.maximum.accumulate(np.where(repeats, 0, np.arange(SAMPLES)))
    return rng.standard_normal((SAMPLES, 3))[source], repeats


@pytest.mark.parametrize("share", [0.01, 0.3, 0.7])
def test_continuous_readings_repeat_by_faults_alone_however_many_there_are(share):
    readings, repeats = repeat(share)
    found = find_repeats(readings, np.ones(SAMPLES, dtype=bool))
    assert found.p_value < 1e-100
    np.testing.assert_array_equal(found.mask, repeats)
    assert found.fraction == repeats.mean()
    assert abs(found.size - 1 / (1 - share)) < 4 * found.sigma


def test_readings_of_which_chance_repeats_nearly_all_tell_no_fault():
    """A lattice as coarse as the motion: most samples repeat, and nothing shows that chance does not do it."""
    t = np.arange(SAMPLES)
    readings = np.trunc(3.0 * np.sin(2 * np.pi * t[:, None] / np.array([1700.0, 2300.0, 3100.0])))
    assert find_repeats(readings, np.ones(SAMPLES, dtype=bool)) is None
