"""Noise that depends on something: what was never thought of is found, and neither motion nor a listed effect is."""

from itertools import pairwise

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.noise_blocks import BACK, SHOWING, passes_zero
from diagnosis.detectors.noise_patterns import patterns
from diagnosis.detectors.report import SampleReport, Symptom
from diagnosis.detectors.samples import examine
from gyrocal.recording import Attitudes, GyroStream, Interval, Recording
from simulator.effects.base import SYMPTOMS
from tests.diagnosis.recordings import recorded

COUNT = 24_000
BOUNDS = (0, 9001, 16_500, COUNT)  # of three intervals, samples
SIGMA = np.deg2rad(1e-3)
P = 1e-5


def moving():
    """Rates (n, 3) in sigmas, of a body that turns about all axes, far from zero."""
    t = np.arange(COUNT)
    return np.column_stack([600 + 250 * np.sin(t / 40), 500 + 200 * np.cos(t / 530), -400 + 150 * np.sin(t / 230)])


def drawn(seed):
    return np.random.default_rng(seed).standard_normal((COUNT, 3))


def recording_of(x):
    """Of rates in sigmas, one sample a second, three intervals."""
    spans = [Interval(f"i{low}", "turns", float(low), float(high)) for low, high in pairwise(BOUNDS)]
    seen = np.arange(0.0, COUNT, 1000.0)
    attitudes = Attitudes(seen, np.tile([0.0, 0.0, 0.0, 1.0], (seen.size, 1)), np.full((seen.size, 3), 1e-4))
    stream = GyroStream(np.arange(COUNT, dtype=float), SIGMA * x, 1.0, SIGMA)
    return Recording("a body in motion", "2020-01-01T00:00:00Z", stream, attitudes, tuple(spans))


def report_of(x, *symptoms):
    none = np.zeros(COUNT, dtype=bool)
    report = SampleReport([], list(symptoms), SIGMA * x, np.full(x.shape, SIGMA**2), none, none.copy())
    patterns(report, recording_of(x), np.ones(COUNT, dtype=bool), np.zeros(3))
    return report


def chances(x):
    return [one.p_value for one in report_of(x).tests if one.statistic == "noise_pattern"]


# ---- under M0 ------------------------------------------------------------------------------------------------------------


def test_the_rows_are_orthonormal():
    np.testing.assert_allclose(BACK @ BACK.T, np.eye(SHOWING), atol=1e-8)


def test_independent_noise_alarms_no_more_often_than_stated():
    """Of a body in motion; every p-value counts all questions, which go together, so that it is too large rather."""
    p = np.concatenate([chances(moving() + drawn(seed)) for seed in range(25)])
    assert p.size == 75
    for at in (0.2, 0.05, 0.01):
        assert scipy.stats.binom.sf(np.sum(p < at) - 1, p.size, at) > 1e-3
    assert np.mean(p < 0.5) > 0.1


@pytest.mark.parametrize("size", [1.0, 5.0, 30.0])
def test_jerks_at_regular_times_are_no_pattern(size):
    """A body that is pushed every 64 samples, more and more strongly."""
    pushed = np.zeros(COUNT)
    pushed[::64] = size * np.linspace(0.0, 1.0, pushed[::64].size) * np.resize([1.0, -1.0], pushed[::64].size)
    x = moving() + drawn(5)
    x[:, 0] += np.cumsum(np.cumsum(pushed) / 32)
    assert all(p > 1e-3 for p in chances(x))


def test_blocks_that_pass_zero_are_known():
    ramp = np.linspace(-10.0, 10.0, 38)
    found = passes_zero(np.array([ramp, ramp + 20, 0 * ramp, 0.5 * ramp + 5.0]), 1.0)
    assert list(found) == [True, False, False, True]


# ---- noise that depends on something -------------------------------------------------------------------------------------


def _alternates(x, e):
    x[:, 0] += 2e-4 * x[:, 0] * (-1.0) ** np.arange(COUNT)


def _cycles_from_each_start(x, e):
    since = np.concatenate([np.arange(high - low) for low, high in pairwise(BOUNDS)])
    x[:, 0] += 0.5 * (since % 7 == 3)


def _cycles_in_power(x, e):
    x[:, 0] += 0.5 * e[:, 0] * (np.arange(COUNT) % 5 == 0)


def _steps_at_a_value(x, e):
    x[:, 0] += 1.5 * (x[:, 0] > 700.0)


def _grows_with_another_reading(x, e):
    x[:, 0] += 0.2 * e[:, 0] * (x[:, 1] - 500) / 200


def _ages(x, e):
    x[:, 0] += 0.25 * e[:, 0] * np.arange(COUNT) / COUNT


def _swells(x, e):
    """At random, for about 300 samples each time."""
    turns = np.random.default_rng(7).random(COUNT) < 1 / 300
    x[:, 0] += 0.4 * e[:, 0] * (-1.0) ** np.cumsum(turns)


def _grows_until_it_is_driven_again(x, e):
    x[:, 0] += 0.3 * e[:, 0] * np.exp(3 * (np.arange(COUNT) / 1777 % 1.0 - 1))


def _is_rough_at_some_angles(x, e):
    """Of what the second gyro has turned, a thirtieth of a turn each minute."""
    angle = np.cumsum(SIGMA * x[:, 1])
    x[:, 0] += 0.3 * e[:, 0] * (np.sin(2.3 * angle) > 0.5)


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (_alternates, "mean goes with a cycle of 2 samples"),
        (_cycles_from_each_start, "mean goes with a cycle"),
        (_cycles_in_power, "power goes with a cycle"),
        (_steps_at_a_value, "step where the reading passes"),
        (_grows_with_another_reading, "level differs with the next gyro's reading"),
        (_ages, "level differs with the time"),
        (_swells, "swells and falls"),
        (_grows_until_it_is_driven_again, "level goes with the number of a sample in waves of 17"),
        (_is_rough_at_some_angles, "level goes with the angle turned about the axis of the next gyro"),
    ],
)
def test_what_noise_depends_on_is_said_of_the_gyro_that_has_it(law, says):
    for seed in range(2):
        e = drawn(seed)
        x = moving() + e
        law(x, e)
        report = report_of(x)
        assert [one.kind for one in report.symptoms] == ["noise_pattern"]
        assert report.symptoms[0].axis == "x"
        assert says in report.symptoms[0].text
        assert report.symptoms[0].p_value < P


def test_it_speaks_against_a_listed_kind_of_noise():
    """Noise that ages has another level, but is none of one level."""
    e = drawn(1)
    x = moving() + e
    level = Symptom("white_noise_level", "x", 1.2, "factor", 0.01, {}, 1e-30)
    _ages(x, e)
    assert report_of(x, level).symptoms[0].likeness < P
    assert report_of(moving() + 1.2 * e, level).symptoms[0].likeness > 1e-3


def test_it_is_a_symptom_that_no_effect_claims():
    assert "noise_pattern" in SYMPTOMS


# ---- listed effects ------------------------------------------------------------------------------------------------------


def test_readings_cut_toward_zero_have_no_pattern():
    """Of a body that drifts through zero, by steps of a quarter of the noise: near zero there is less of it."""
    x = np.trunc((drawn(3) + 3 * np.sin(np.arange(COUNT) / 4000)[:, None]) / 0.25) * 0.25
    none = np.zeros(COUNT, dtype=bool)
    for steps, speaks in ((0.25, False), (0.0, True)):
        report = SampleReport([], [], SIGMA * x, np.full(x.shape, SIGMA**2), none, none.copy())
        patterns(report, recording_of(x), np.ones(COUNT, dtype=bool), np.full(3, SIGMA * steps))
        assert any(one.p_value < 1e-3 for one in report.tests) is speaks


@pytest.mark.parametrize(
    "effect",
    [
        "spikes:x=0.02",
        "stale_samples=2",
        "rate_deadzone:y=2e-3",
        "rate_saturation:z=0.05",
        "noise_excess:x=1.5",
        "noise_angle_white:y=1.0",
        "vibration:z=5e-4",
    ],
)
def test_a_listed_effect_is_no_pattern(effect):
    assert "noise_pattern" not in [one.kind for one in examine(recorded(41, effect)).symptoms]


@pytest.mark.parametrize("share", [0.4, -0.4])
def test_noise_that_two_gyros_share_is_seen_while_the_body_moves(share):
    """A supply that both have: it adds the same white noise to two of three gyros, correlated by s²/(1 + s²)."""
    x = drawn(31)
    common = np.random.default_rng(32).standard_normal(COUNT)
    x[:, 0] += abs(share) * common
    x[:, 2] += share * common
    report = report_of(moving() + x)
    found = {one.axis: one for one in report.tests if one.statistic == "calm_noise_correlation"}
    assert found["xz"].value == pytest.approx(np.sign(share) * 0.16 / 1.16, abs=0.02)
    assert found["xz"].p_value < P
    assert found["xy"].p_value > 1e-3
    assert [one.kind for one in report.symptoms] == ["noise_correlation"]


def test_independent_noise_and_jerks_of_the_body_correlate_no_more_than_stated():
    p = []
    for seed in range(12):
        x = moving() + drawn(100 + seed)
        if seed % 2:  # a thruster about a skew axis now and then
            jumps = np.zeros(COUNT)
            jumps[np.random.default_rng(seed).integers(0, COUNT, 40)] = 5.0
            x += np.cumsum(jumps * np.resize([1, -1], COUNT))[:, None] * np.array([1.0, -0.7, 0.5])
        p += [one.p_value for one in report_of(x).tests if one.statistic == "calm_noise_correlation"]
    assert len(p) == 36
    assert scipy.stats.kstest(p, "uniform").pvalue > 1e-3
    assert min(p) > 1e-4
