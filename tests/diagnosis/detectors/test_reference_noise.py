"""The noise of the references, where the body moves fast between them."""

import numpy as np
import pytest

from diagnosis.detectors.reference_noise import ReferenceSeries, reference_noise

COUNT, SPACING, SIGMA = 600, 1.0, 1e-4
DENSITY = np.full(3, 1e-12)
T = SPACING * np.arange(COUNT)
RATES = 0.02 * np.column_stack([np.sin(2 * np.pi * T / period) for period in (3.1, 4.3, 5.9)])
# Late tags turn the attitude by the rate times the delay; another error of the rates is no part of this one.
MOTION = np.stack([RATES, np.roll(RATES, 1, axis=1), np.abs(RATES)], axis=-1)


def level_of(excess=1.0, delay=0.0, motion=None):
    noise = np.random.default_rng(3).normal(0.0, excess * SIGMA, (COUNT, 3))
    series = ReferenceSeries(
        t_s=T,
        interval=np.zeros(COUNT, dtype=int),
        sigma=np.full((COUNT, 3), SIGMA),
        to_inertial=np.tile(np.eye(3), (COUNT, 1, 1)),
        residuals=noise - delay * RATES,
        rates=RATES,
    )
    return reference_noise(series, DENSITY, T, np.zeros((COUNT, 3), dtype=bool), motion=motion)


def test_an_error_that_follows_the_motion_is_no_noise():
    assert level_of(delay=0.02).odd
    left = level_of(delay=0.02, motion=MOTION)
    assert not left.odd
    assert np.abs((left.factor - 1) / left.sigma).max() < 4


@pytest.mark.parametrize("delay", [0.0, 0.02])
def test_noise_of_another_level_stays_so_without_the_motion(delay):
    left = level_of(excess=1.4, delay=delay, motion=MOTION)
    assert left.departs
    assert np.abs((left.factor - 1.4) / left.sigma).max() < 4


def test_noise_as_stated_has_its_level_without_the_motion():
    left = level_of(motion=MOTION)
    assert not left.odd
    assert np.abs((left.factor - 1) / left.sigma).max() < 4
