"""The linearisation of a recording against the calibrator, finite differences, brute force and its own noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.model import linearise
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.prepare import prepare
from gyrocal import GyroParameters, calibrate, residual_table
from simulator import load, motion, override
from simulator.simulate import add_effects_and_noise, make_noise_streams, simulate
from tests.diagnosis.recordings import plan, recorded


@pytest.fixture(scope="module")
def recording():
    return recorded(3, sample_s=1.0)


@pytest.fixture(scope="module")
def model(recording, quiet):
    result = calibrate(recording)
    return linearise_recording(recording, result.G, result.bias, smooth=quiet.recording.gyro.rates)


@pytest.fixture(scope="module")
def quiet():
    """A recording without noise, about the truth."""
    base = plan(1.0)
    return linearise_recording(simulate(base, noise=False), np.array(base.gyro.true_G), np.deg2rad(base.gyro.true_bias_deg_s))


def test_observations_are_the_calibrators_residuals_and_columns_what_they_lack(recording, model, quiet):
    """In inertial axes with the sign turned; the calibrator has none for the first reference of an interval, which is zero."""
    table = residual_table(recording, GyroParameters(model.G, model.bias))
    theta = np.deg2rad(table[[f"before_{axis}_deg" for axis in ("roll", "pitch", "yaw")]].to_numpy())
    A = model.at_reference.transpose(0, 2, 1)
    ours = -np.einsum("mij,mj->mi", A, model.residuals)
    first = np.diff(model.interval_of_reference, prepend=-1) > 0
    np.testing.assert_allclose(ours[first], 0, atol=1e-15)
    np.testing.assert_allclose(ours[~first], theta, atol=1e-12)
    np.testing.assert_array_equal(model.zeta, model.residuals.ravel())
    # Finite differences in all twelve parameters, without noise, which turns them by tenths of a percent.
    scale = np.append(np.full(9, 1e-6), np.full(3, np.deg2rad(5e-8)))
    for k in range(12):
        change = np.zeros(12)
        change[k] = scale[k]
        moved = linearise_recording(quiet.recording, quiet.G + change[:9].reshape(3, 3), quiet.bias + change[9:])
        difference = quiet.whiten(moved.zeta - quiet.zeta) / change[k]
        assert np.allclose(difference, -quiet.calibration[:, k], atol=1e-4 * np.abs(quiet.calibration[:, k]).max())


def test_a_reference_error_moves_its_own_observation_and_cells_add_up(recording, model):
    """The turn of one reference by a small angle, against its column."""
    row, angle = 5, np.deg2rad([1e-3, -2e-3, 5e-4])
    error = np.zeros((len(model.at_reference), 3, 1))
    error[row, :, 0] = angle
    expected = model.observe_reference_error(error)[:, 0]
    q = recording.attitudes.quaternions.copy()
    own = model.reference_rows[row]
    # A_obs' = exp([e×]) A_obs, and as an active rotation q is its transpose.
    q[own] = (Rotation.from_quat(q[own]) * Rotation.from_rotvec(-angle)).as_quat()
    moved = linearise_recording(replace(recording, attitudes=replace(recording.attitudes, quaternions=q)), model.G, model.bias)
    # The residual there, 1e-4 rad, is turned as well.
    assert np.allclose(moved.zeta - model.zeta, expected, atol=3e-8)
    assert np.count_nonzero(expected) == 3
    columns = model.reference_columns[:, :, row]  # of each body axis, whitened
    assert np.allclose(angle @ columns, model.whiten(expected), atol=1e-9)
    # A constant rate error about one axis is that of all cells together, and cells end at every reference.
    cells = model.cells
    assert cells.duration_s.sum() == pytest.approx(model.dt.sum())
    for block in model.blocks:
        ends = set(cells.last[cells.interval == model.blocks.index(block)] - block.steps.start)
        assert set(block.ends[1:].tolist()) <= ends
    for axis in range(3):
        error = np.zeros((model.t_s.size, 3, 1))
        error[:, axis] = 1e-6
        whole = model.whiten(model.observe_rate_error(error))[:, 0]
        np.testing.assert_allclose(1e-6 * model.cell_columns[axis].sum(axis=1), whole, atol=1e-10 * np.abs(whole).max())


def brute_force_covariance(model, block, power, sigma):
    """(3m, 3m) of the references of a block, one noise increment of each step at a time, before any averaging."""
    starts = np.cumsum([0, *(one.references.size for one in model.blocks)])
    number = model.blocks.index(block)
    A_T = model.at_reference[starts[number] : starts[number + 1]]
    count = len(A_T)
    V = np.zeros((3 * count, 3 * count))
    turned = model.to_inertial[block.steps] @ model.G
    for k in range(block.steps.stop - block.steps.start):
        seen = np.repeat((block.ends > k).astype(float), 3)[:, None] * np.tile(turned[k], (count, 1))
        V += seen @ np.diag(power[block.steps][k]) @ seen.T
    for m in range(count):
        V[3 * m : 3 * m + 3, 3 * m : 3 * m + 3] += A_T[m] @ np.diag(sigma[block.references[m]] ** 2) @ A_T[m].T
    return V


def averaging(block):
    """(3r, 3m) means over the references of each observation."""
    M = np.zeros((block.groups.size, block.references.size))
    for row, (first, count) in enumerate(zip(block.groups, block.counts, strict=True)):
        M[row, first : first + count] = 1 / count
    return np.kron(M, np.eye(3))


def test_covariance_of_averaged_references_is_that_of_brute_force(recording, model, monkeypatch):
    """With a density of its own for each axis and time."""
    monkeypatch.setattr(linearise, "MOST_OBSERVATIONS", len(model.reference_rows) // 3 + 1)
    rng = np.random.default_rng(4)
    arw2 = recording.gyro.arw**2
    density = arw2 * rng.uniform(0.3, 3.0, recording.gyro.rates.shape)
    sigma = recording.attitudes.sigma * rng.uniform(0.5, 2.0, recording.attitudes.sigma.shape)
    made = linearise_recording(recording, np.eye(3), model.bias, density=density, sigma=sigma)
    assert {int(count) for block in made.blocks for count in block.counts} >= {3}
    t = recording.gyro.t_s
    for block in made.blocks[1:3]:
        middle = made.t_s[block.steps]
        rows = np.searchsorted(t, middle, side="right") - 1
        per_step = np.full((made.t_s.size, 3), np.nan)
        per_step[block.steps] = density[rows] * made.dt[block.steps, None]
        V = brute_force_covariance(made, block, per_step, sigma)
        M = averaging(block)
        np.testing.assert_allclose(block.whitener @ block.whitener.T, M @ V @ M.T, rtol=2e-4, atol=1e-5 * V.max())


SCENARIO = override(load("trmm_series"), {"gyro.sample_s": 2.0, "reference.every_s": 50.0})
M = Rotation.from_rotvec([0.4, 0.9, -0.5]).as_matrix()
COVARIANCE = M @ np.diag(np.deg2rad([1e-3, 1e-3, 2e-2]) ** 2) @ M.T  # one star tracker, turned against the body


def test_residuals_and_the_test_of_noise_know_the_covariance_that_is_stated():
    plain, path = simulate(SCENARIO, noise=False), motion(SCENARIO)
    P = np.tile(COVARIANCE, (plain.attitudes.t_s.size, 1, 1))
    plain = replace(plain, attitudes=plain.attitudes.replace_covariance(P))
    recordings = [add_effects_and_noise(plain, path, (), *make_noise_streams(seed, 0, True), seed, 0) for seed in range(4)]
    z = []
    for recording in recordings:
        result = calibrate(recording)
        model = linearise_recording(recording, result.G, result.bias)
        z.append((result.chi2 - result.dof) / np.sqrt(2 * result.dof))
        assert model.y @ model.y == pytest.approx(result.chi2, rel=0.02)
        assert model.degrees_of_freedom == result.dof
    assert abs(np.mean(z)) < 3.5 / np.sqrt(len(z))
    prepared = prepare(recordings[0])
    noise = prepared.reference_noise
    assert noise is not None
    assert not noise.departs
    assert noise.factor == pytest.approx(np.ones(3), abs=0.25)
