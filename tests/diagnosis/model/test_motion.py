"""The motion by gyro and references: its columns hold no noise of the residuals, so that a clean gyro shows no effect."""

import numpy as np
import pytest
import scipy.signal
import scipy.stats
from scipy.spatial.transform import Rotation

from diagnosis.model.bins import build_bins, normalise_columns, observe_rate_errors
from diagnosis.model.linearise import find_relinearised_path, interpolate_turns, linearise_recording
from diagnosis.model.prepare import estimate_gyro_noise, prepare
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


def cube_score(model):
    """χ² with one degree of freedom of an error of gyro z that follows the cube of its rate."""
    bins = build_bins(model)
    (column,) = observe_rate_errors(model, bins, 2, normalise_columns(bins.rates[:, [2]] ** 3)).T
    # The family's column is whitened, and its part beside the calibration is what can be told from that.
    basis = np.linalg.qr(np.hstack([model.starts, model.calibration]))[0]
    column = column - basis @ (basis.T @ column)
    return float((column @ model.y) ** 2 / (column @ column))


def test_columns_hold_no_noise_of_a_clean_gyro():
    """The scores are χ² with one degree of freedom each; with columns of the readings themselves they are not."""
    clean = [(rates, prepare(recording).model) for rates, recording in map(swaying, SEEDS)]
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


STEP_S, COUNT, SPACING = 0.05, 6000, 60


@pytest.fixture(scope="module")
def flown():
    """Aᵀ along the true and the propagated path, both at every step, and the error of the rates."""
    t = (np.arange(COUNT) + 0.5) * STEP_S
    true = np.column_stack([0.02 * np.sin(0.01 * t), 0.03 * np.cos(0.013 * t), 0.01 + 0 * t])
    error = np.column_stack([2e-3 * np.sin(0.02 * t) + 5e-4, 1.5e-3 * (t > 100), -1e-3 * np.cos(0.005 * t)])

    def path(rates):
        turns = [Rotation.identity()]
        for rate in rates:
            turns.append(turns[-1] * Rotation.from_rotvec(rate * STEP_S))
        return Rotation.concatenate(turns)

    return path(true), path(true - error), true, error


def test_path_gives_the_integral_where_the_first_order_does_not(flown):
    true, propagated, rates, error = flown
    ends = np.arange(0, COUNT + 1, SPACING)
    zeta = (true[ends] * propagated[ends].inv()).as_rotvec()
    middle = (true[:-1] * Rotation.from_rotvec(0.5 * rates * STEP_S)).as_matrix()
    integral = np.cumsum(np.einsum("nij,nj->ni", middle, error) * STEP_S, axis=0)
    exact = np.vstack([np.zeros(3), integral])[ends]
    errors, turns = find_relinearised_path(zeta, np.full(zeta.shape, 1e-4))
    assert np.rad2deg(np.abs(zeta).max()) > 10
    assert np.abs(zeta - exact).max() > 100 * np.abs(errors - exact).max()
    assert np.abs(errors - exact).max() < 2e-4
    begun = (propagated[:-1] * Rotation.from_rotvec(0.5 * (rates - error) * STEP_S)).as_matrix()
    assert np.abs(interpolate_turns(turns, ends) @ begun - middle).max() < 2e-3
    at_references = Rotation.from_rotvec(turns).as_matrix() @ propagated[ends].as_matrix()
    assert at_references == pytest.approx(true[ends].as_matrix(), abs=1e-12)
    small = np.random.default_rng(1).normal(0, 1e-4, (50, 3))
    assert find_relinearised_path(small, np.full((50, 3), 1e-4)) is None
