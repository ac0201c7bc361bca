"""The motion by gyro and references: its columns hold no noise of the residuals, so that a clean gyro shows no effect."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from diagnosis.model.bins import build_bins, normalise_columns, observe_rate_errors
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.motion import estimate_gyro_noise
from diagnosis.model.prepare import prepare
from tests.diagnosis.recordings import of_rates

SEEDS = range(4)
SAMPLE_S, EACH = 0.02, 5  # 50 Hz, and a reference at every fifth sample
ARW, SIGMA = np.deg2rad(5e-3), np.deg2rad(5e-3)  # 0.035 deg/s in a sample
SWAY = np.deg2rad([0.4, 0.35, 0.3])


def swaying(seed):
    """Rates (n, 3) of a body that sways about each axis at a frequency of its own, and the recording of a clean gyro."""
    t_s = SAMPLE_S * np.arange(3000)
    phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, 3)
    rates = SWAY * np.sin(2 * np.pi * np.array([0.72, 0.81, 1.5]) * t_s[:, None] + phases)
    return rates, of_rates(rates, EACH, SAMPLE_S, ARW, SIGMA, seed)


@pytest.fixture(scope="module")
def clean():
    return [(rates, prepare(recording).model) for rates, recording in map(swaying, SEEDS)]


def cube_score(model):
    """χ² with one degree of freedom of an error of gyro z that follows the cube of its rate."""
    bins = build_bins(model)
    (column,) = observe_rate_errors(model, bins, 2, normalise_columns(bins.rates[:, [2]] ** 3)).T
    # The family's column is whitened, and its part beside the calibration is what can be told from that.
    basis = np.linalg.qr(np.hstack([model.starts, model.calibration]))[0]
    column = column - basis @ (basis.T @ column)
    return float((column @ model.y) ** 2 / (column @ column))


def test_columns_hold_no_noise_of_a_clean_gyro(clean):
    """The scores are χ² with one degree of freedom each; with columns of the readings themselves they are not."""
    assert scipy.stats.chi2.sf(sum(cube_score(model) for _, model in clean), len(clean)) > 1e-3
    noisy = [linearise_recording(model.recording, model.G, model.bias) for _, model in clean]
    assert scipy.stats.chi2.sf(sum(map(cube_score, noisy)), len(noisy)) < 1e-12
    # Without it the attitude wanders much less, beside what a bias makes.
    for rates, model in clean:
        noise, turned = estimate_gyro_noise(model, None)
        read = model.recording.gyro.rates - rates
        wanders = [scipy.signal.detrend(np.cumsum(one, axis=0), axis=0).std() for one in (read - noise, read)]
        assert wanders[0] < 0.5 * wanders[1]
        # What is expected of the attitude is the integral of what is expected of the rate, with the other sign.
        block = model.blocks[0]
        total = np.vstack([np.zeros(3), np.cumsum(noise @ model.G.T * SAMPLE_S, axis=0)])[block.ends]
        np.testing.assert_allclose(turned, -total, atol=0.02 * np.abs(total).max())
