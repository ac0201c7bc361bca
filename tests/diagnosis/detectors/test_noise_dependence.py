"""Noise whose level depends on the motion is seen on one gyro; white noise and a body that shakes are not."""

from dataclasses import replace

import numpy as np
import scipy.stats

from diagnosis.detectors.samples import examine
from diagnosis.settings import DEFAULT
from tests.diagnosis.recordings import of_rates

COUNT = 20_000
SAMPLE_S, SIGMA = 0.1, 1e-5  # SIGMA of a sample, rad/s


def swings(rng, count=COUNT):
    """Three slow swings of some thousand sigmas, in sigmas of the noise."""
    t = np.arange(count)
    periods, phases = rng.uniform(800, 3000, 3), rng.uniform(0, 2 * np.pi, 3)
    return 3000 * np.sin(2 * np.pi * t[:, None] / periods + phases)


def examined(rng, factor):
    """What is found of swings with noise of (n, 3) times the stated size."""
    motion = swings(rng)
    made = of_rates(SIGMA * motion, 500, SAMPLE_S, SIGMA * np.sqrt(SAMPLE_S), 1e-5, 1)
    read = SIGMA * (motion + factor(motion) * rng.standard_normal((COUNT, 3)))
    return examine(replace(made, gyro=replace(made.gyro, rates=read)))


def p_values(report):
    return {test.axis: test.p_value for test in report.tests if test.statistic == "noise_dependence"}


def test_p_values_of_white_noise_are_not_too_small():
    """They count each covariate, so that they are at most uniform."""
    found = [p for seed in range(10) for p in p_values(examined(np.random.default_rng(seed), np.ones_like)).values()]
    assert len(found) == 30
    for level in (0.01, 0.1):
        assert np.sum(np.array(found) < level) <= scipy.stats.binom.ppf(0.9999, len(found), level)


def test_noise_that_grows_with_the_rate_is_unlisted_unless_the_whole_body_shakes():
    def factor(motion):
        grown = np.ones_like(motion)
        grown[:, 1] += 0.5 * np.abs(motion[:, 1]) / 3000
        return grown

    report = examined(np.random.default_rng(0), factor)
    (found,) = [one for one in report.symptoms if one.kind == "noise_pattern"]
    assert found.axis == "y"
    assert found.p_value < DEFAULT.sample_event
    assert "depends on" in found.text
    levels = [one for one in report.symptoms if one.kind == "white_noise_level"]
    assert all(one.likeness == found.p_value for one in levels if one.axis == "y")
    report = examined(np.random.default_rng(6), lambda motion: 1 + np.abs(motion[:, :1]) / 3000 * np.ones(3))
    assert max(p_values(report).values()) < 1e-10
    assert not [one for one in report.symptoms if one.kind == "noise_pattern"]
