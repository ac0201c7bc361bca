"""The noise of the references, where the body moves fast between them."""

import numpy as np
import pytest
import scipy.signal
from scipy.spatial.transform import Rotation

from diagnosis.detectors.reference_noise import ReferenceSeries, estimate_reference_noise

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
    )
    return estimate_reference_noise(series, DENSITY, motion=motion)


def test_an_error_that_follows_the_motion_is_no_noise():
    assert level_of(delay=0.02).is_unusual
    left = level_of(delay=0.02, motion=MOTION)
    assert not left.is_unusual
    assert np.abs((left.factor - 1) / left.sigma).max() < 4


@pytest.mark.parametrize(
    ("excess", "axis"),
    [((0.88, 3.0, 1.12), 1), ((2.9, 3.1, 3.0), None), ((1.0, 1.0, 0.4), 2)],
)
def test_one_axis_departs_alone_if_the_others_are_rather_as_stated_than_as_it_is(excess, axis):
    """Also where the others are off by two or three sigmas, which is one in a hundred."""
    assert level_of(excess=np.array(excess)).axis == axis


def likeness_of(noise):
    """Likeness of errors (n, 3) of the references, in stated sigmas."""
    count = len(noise)
    series = ReferenceSeries(
        np.arange(count) * SPACING, np.zeros(count, dtype=int), np.full((count, 3), SIGMA), np.tile(np.eye(3), (count, 1, 1)),
        SIGMA * noise,
    )  # fmt: skip
    return estimate_reference_noise(series, DENSITY).likeness


def test_white_noise_of_another_level_has_a_p_value_as_its_likeness():
    """Below 0.1 in no more than a tenth of the draws, within three sigmas of their number."""
    draws = 100
    p = np.array([likeness_of(3 * np.random.default_rng(seed).standard_normal((60, 3))) for seed in range(draws)])
    assert np.mean(p < 0.1) < 0.1 + 3 * np.sqrt(0.1 * 0.9 / draws)


@pytest.mark.parametrize("kind", ["correlated", "tails", "wave"])
def test_other_errors_are_unlike_white_noise(kind):
    rng, count = np.random.default_rng(4), 300
    noise = rng.standard_normal((count, 3))
    if kind == "correlated":
        noise = noise + scipy.signal.lfilter([4.0], [1.0, -np.exp(-1 / 3)], rng.standard_normal((count, 3)), axis=0)
    elif kind == "tails":
        noise = 3 * rng.standard_t(3, (count, 3))
    else:
        noise += 3 * np.sin(2 * np.pi * np.arange(count) / 4.7)[:, None]
    assert likeness_of(noise) < 1e-3


def spinning(rate_deg_s, seed, of_references=1.0, of_angle=0.0, slow=0.0):
    """A body that spins about an axis near x, references each second, and the level of their noise."""
    rng = np.random.default_rng(seed)
    axis = np.array([0.9, 0.1, 0.2]) / np.linalg.norm([0.9, 0.1, 0.2])
    A = Rotation.from_rotvec(-np.deg2rad(rate_deg_s) * T[:, None] * axis).as_matrix()
    errors = np.einsum("mji,mj->mi", A, rng.normal(0.0, of_references * SIGMA, (COUNT, 3)))
    turned = np.cumsum(np.einsum("mji,mj->mi", A, rng.normal(0.0, of_angle * SIGMA, (COUNT, 3))), axis=0)
    wander = slow * SIGMA * np.cumsum(np.cumsum(rng.normal(size=(COUNT, 3)), axis=0), axis=0) / 100
    series = ReferenceSeries(
        t_s=T,
        interval=np.arange(COUNT) // 50,
        sigma=np.full((COUNT, 3), SIGMA),
        to_inertial=A.transpose(0, 2, 1),
        residuals=errors - turned - wander,
    )
    return estimate_reference_noise(series, DENSITY)


@pytest.mark.parametrize("rate_deg_s", [0.0, 110.0])
@pytest.mark.parametrize("seed", range(2))
def test_an_excess_is_told_from_one_of_the_angle_however_fast_the_body_turns(rate_deg_s, seed):
    of_references = spinning(rate_deg_s, seed, of_references=1.5)
    assert of_references.departs
    assert np.abs((of_references.factor - 1.5) / of_references.sigma).max() < 4
    assert spinning(rate_deg_s, seed, of_references=1.5, slow=30.0).departs
    of_angle = spinning(rate_deg_s, seed, of_angle=2.0)
    assert of_angle.p_value < of_angle.event_p
    assert of_angle.of_gyro
    assert not of_angle.departs
