"""The linear model against the calibrator, finite differences and its own noise."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.samples import examine
from diagnosis.model.prepare import prepare, unclipped
from diagnosis.model.recording import linearised
from gyrocal import calibrate
from simulator import scenario
from simulator.simulate import simulate


@pytest.fixture(scope="module")
def plan():
    return scenario.override(scenario.load("trmm_series"), {"gyro.arw_deg_per_sqrt_s": 1.5e-4, "reference.every_s": 120.0})


@pytest.fixture(scope="module")
def recording(plan):
    return simulate(plan, seed=3)


@pytest.fixture(scope="module")
def model(recording):
    result = calibrate(recording)
    return linearised(recording, result.G, result.bias)


def test_calibration_columns_are_what_the_residuals_lack(recording, model):
    """Finite differences of the observations in all twelve parameters: what is added to G or b is no longer missing."""
    step = 1e-6
    scale = np.append(np.full(9, 1.0), np.full(3, np.deg2rad(0.05)))
    for k in range(12):
        change = np.zeros(12)
        change[k] = step * scale[k]
        moved = linearised(recording, model.G + change[:9].reshape(3, 3), model.bias + change[9:])
        difference = model.whitened(moved.zeta - model.zeta) / change[k]
        assert np.allclose(difference, -model.calibration[:, k], atol=2e-3 * np.abs(model.calibration[:, k]).max())


def test_a_step_is_a_reading_switched_on(model):
    high = np.tile([1e-6, -2e-6, 5e-7], (model.t_s.size, 1))
    starts = np.array([0, 700, model.blocks[1].steps.start, model.blocks[3].steps.start + 4001])
    together = model.reading_steps(high, starts)
    for k, start in enumerate(starts):
        alone = np.where((np.arange(model.t_s.size) >= start)[:, None], high, 0.0)
        assert np.allclose(together[:, [k]], model.reading(alone[:, :, None]), atol=1e-16)


def test_a_reference_error_moves_its_own_observation_only(recording, model):
    """The turn of one reference by a small angle, against its column."""
    row, angle = 5, np.deg2rad([1e-3, -2e-3, 5e-4])
    error = np.zeros((len(model.at_reference), 3, 1))
    error[row, :, 0] = angle
    expected = model.reference_error(error)[:, 0]
    from scipy.spatial.transform import Rotation

    q = recording.attitudes.quaternions.copy()
    own = model.reference_rows[row]
    # A_obs' = exp([e×]) A_obs, and as an active rotation q is its transpose.
    q[own] = (Rotation.from_quat(q[own]) * Rotation.from_rotvec(-angle)).as_quat()
    from dataclasses import replace

    moved = linearised(replace(recording, attitudes=replace(recording.attitudes, quaternions=q)), model.G, model.bias)
    # The residual there, 1e-4 rad, is turned as well.
    assert np.allclose(moved.zeta - model.zeta, expected, atol=3e-8)
    assert np.count_nonzero(expected) == 3


def test_residuals_of_m0_have_unit_variance(plan):
    """χ² of the projected observations over seeds: mean and spread of a χ² with the stated degrees of freedom."""
    values = []
    for seed in range(12):
        prepared = prepare(simulate(plan, seed=seed, case=1)).model
        values.append((prepared.y @ prepared.y, prepared.degrees_of_freedom))
    total, dof = sum(v for v, _ in values), sum(d for _, d in values)
    assert 1e-3 < scipy.stats.chi2.cdf(total, dof) < 1 - 1e-3


def test_prepare_finds_the_calibrators_parameters(recording):
    """Another implementation of the same estimate: differences are far inside the sigmas."""
    prepared = prepare(recording)
    result = calibrate(recording)
    ours = np.append(prepared.model.G.ravel(), prepared.model.bias)
    theirs = result.parameters.vector
    assert np.abs((ours - theirs) / result.sigma).max() < 0.05
    assert np.allclose(prepared.sigma, result.sigma, rtol=0.02)


def test_wrong_noise_is_felt(plan):
    """Negative control: the χ² of the residuals leaves its range when the references are noisier than stated."""
    from dataclasses import replace

    recording = simulate(plan, seed=1)
    stated = replace(recording, attitudes=replace(recording.attitudes, sigma=recording.attitudes.sigma / 2))
    result = calibrate(stated)
    y = linearised(stated, result.G, result.bias).y
    assert y @ y > 2 * y.size


def test_clipped_stretches_are_left_out(plan):
    from simulator.effects import parse

    recording = simulate(plan, seed=2, effects=[parse("rate_saturation:z=0.1")])
    report = examine(recording)
    assert report.clipped.any()
    pieces = unclipped(recording, report)
    assert len(pieces) > len(recording.intervals)
    clipped = recording.gyro.t_s[report.clipped]
    for piece in pieces:
        assert not ((clipped >= piece.start_s) & (clipped < piece.stop_s)).any()
    model = prepare(recording).model
    assert 1e-4 < scipy.stats.chi2.cdf(model.y @ model.y, model.degrees_of_freedom) < 1 - 1e-4
