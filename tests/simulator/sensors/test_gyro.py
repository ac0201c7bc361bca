import numpy as np
import pytest

from simulator.sensors.gyro import add_white_noise, compute_raw_rates

ARW = 3.5e-6


def white_noise(rng, arw, duration):
    return add_white_noise(rng, np.zeros((len(duration), 3)), arw, duration)


def test_raw_rates_solve_the_gyro_equation():
    rng = np.random.default_rng(1)
    G = np.eye(3) + 1e-2 * rng.standard_normal((3, 3))
    bias, omega = rng.standard_normal(3), rng.standard_normal((10, 3))
    np.testing.assert_allclose(compute_raw_rates(omega, G, bias) @ G.T + bias, omega, rtol=1e-12)


@pytest.mark.parametrize("sample_s", [0.1, 0.5, 2.0])
def test_integrated_noise_does_not_depend_on_the_sampling(sample_s):
    """The angle after 100 s has variance ARW² · 100 s: 3 x 4000 draws, relative sd sqrt(2/12000) = 1.3 %, 5 sigma."""
    steps, trials = round(100 / sample_s), 4000
    rng = np.random.default_rng(2)
    noise = white_noise(rng, ARW, np.full(steps * trials, sample_s))
    angles = noise.reshape(trials, steps, 3).sum(axis=1) * sample_s
    assert np.mean(angles**2) == pytest.approx(ARW**2 * 100, rel=5 * np.sqrt(2 / angles.size))


def test_noise_is_white_and_independent_between_gyros():
    noise = white_noise(np.random.default_rng(3), ARW, np.full(100_000, 0.5)) * np.sqrt(0.5) / ARW
    lagged = np.mean(noise[1:] * noise[:-1], axis=0)
    crossed = np.mean(noise * np.roll(noise, 1, axis=1), axis=0)
    # Six means of 100 000 products of unit variance, at 5 sigma.
    assert np.abs([lagged, crossed]).max() < 5 / np.sqrt(100_000)


def test_a_shorter_sample_is_noisier():
    duration = np.repeat([0.5, 0.125], 50_000)
    noise = white_noise(np.random.default_rng(4), ARW, duration)
    ratio = noise[50_000:].std() / noise[:50_000].std()
    # Relative sd of a ratio of two standard deviations of 150 000 draws each: 1/sqrt(150 000); 5 sigma.
    assert ratio == pytest.approx(2.0, rel=5 / np.sqrt(150_000))
