"""The attitude by gyro alone: unbiased, with the covariance of its errors, and none of what it was not told."""

import tracemalloc

import numpy as np
import pytest

from gyrocal import GyroParameters, InputError, attitude, calibrate
from gyrocal.calibration.remainder_processes import Process
from gyrocal.estimation.error_smoother import ErrorStates
from gyrocal.estimation.predict import _check_memory, predict, prior_covariance
from gyrocal.estimation.remainder_noise import RemainderNoise
from tests.builders import RPO, TRUTH, mean_bounds, piecewise_recording

DEG_S = np.deg2rad(1.0)
PLAN = (
    (
        ((0.0, -RPO, 0.0), 200.0),
        ((0.1 * DEG_S, 0.0, 0.0), 200.0),
        ((0.0, 0.0, 0.15 * DEG_S), 200.0),
        ((0.05 * DEG_S, -0.1 * DEG_S, 0.0), 200.0),
        ((0.0, 0.08 * DEG_S, -0.1 * DEG_S), 200.0),
    ),
)
SIGMA_G, SIGMA_BIAS, FROM_S = 2e-3, np.deg2rad(2.0 / 3600), 650.0
P0 = prior_covariance(SIGMA_G, SIGMA_BIAS)
ARW = 2e-7
QUIET = piecewise_recording(PLAN, series_s=20.0)


def drawn(seed):
    """A noisy recording whose a-priori parameters are drawn about the truth."""
    rng = np.random.default_rng(seed)
    start = GyroParameters.from_vector(TRUTH.vector + rng.normal(size=12) * np.sqrt(np.diag(P0)))
    return piecewise_recording(PLAN, series_s=20.0, rng=rng, arw=ARW, apriori=start)


def error(found):
    """(k, 3) of a prediction at the times of references, against the attitudes without noise."""
    rows = np.searchsorted(QUIET.attitudes.t_s, found.t_s - 1e-6)
    return attitude.residual(attitude.matrix_from_quaternion(QUIET.attitudes.quaternions[rows]), found.A)


def test_errors_have_the_covariance_that_is_claimed():
    cases, times = 60, np.array([660.0, 800.0, 1000.0])
    nees = np.zeros((cases, times.size))
    whole = np.zeros(cases)
    chi2 = np.zeros(cases)
    for seed in range(cases):
        found = predict(drawn(seed), FROM_S, times, P0)
        nees[seed] = np.einsum("ki,kij,kj->k", error(found), np.linalg.inv(found.covariance), error(found))
        off = found.parameters.vector - TRUTH.vector
        whole[seed] = off @ np.linalg.solve(found.parameter_covariance, off)
        chi2[seed] = found.chi2 - found.dof + 3  # three of the residuals made the anchor
    low, high = mean_bounds(3, cases)
    assert ((nees.mean(axis=0) > low) & (nees.mean(axis=0) < high)).all(), nees.mean(axis=0)
    low, high = mean_bounds(12, cases)
    assert low < whole.mean() < high
    assert abs(chi2.mean()) < 4 * np.sqrt(2 * found.dof / cases)


@pytest.mark.parametrize(("from_s", "words"), [(-5.0, "no interval begins before"), (1e6, "the gyro ends at")])
def test_what_cannot_be_predicted_is_said(from_s, words):
    with pytest.raises(InputError, match=words):
        predict(QUIET, from_s)


STATED = np.deg2rad(0.01)


def condition_densely(observed_s, at_s, processes):
    """Smoothing about still axes by matrices of all pairs of times: gain, covariances of walk and reading, and L⁻¹."""
    every, n = np.append(observed_s, at_s), observed_s.size
    walk = ARW**2 * np.minimum.outer(every, every)
    lasting = np.zeros((every.size, every.size))
    for process in processes:
        decay = np.exp(-np.abs(np.subtract.outer(every, every)) / process.time_scale_s)
        if process.kind == "rate":  # ∫∫ exp(−|s − t|/τ) over both spans
            tau, low = process.time_scale_s, np.minimum.outer(every, every)
            one = np.exp(-every / tau)
            walk += process.variance * (2 * tau * low - tau**2 * (1 - one[:, None] - one + decay))
        else:
            lasting += process.variance * decay
    V = (walk + lasting)[:n, :n] + STATED**2 * np.eye(n)
    gain = np.linalg.solve(V, walk[:n, n:]).T
    reading = (walk + lasting)[n:, n:] - gain @ lasting[:n, n:] - (gain @ lasting[:n, n:]).T - gain @ walk[:n, n:]
    return gain, walk[n:, n:] - gain @ walk[:n, n:], reading, np.linalg.inv(np.linalg.cholesky(V))


@pytest.mark.parametrize("kinds", [(), ("rate",), ("reference",), ("rate", "reference")], ids=str)
def test_states_are_smoothed_as_by_the_covariance_of_all_times(kinds):
    known = {
        "rate": Process("rate", (9, 10, 11), 15.0, (2e-6) ** 2),
        "reference": Process("reference", (0, 1, 2), 40.0, (2 * STATED) ** 2),
    }
    processes, rng = [known[kind] for kind in kinds], np.random.default_rng(1)
    nodes = np.cumsum(rng.uniform(1.0, 9.0, size=30))
    turns = np.zeros((30, 3, 12))
    turns[:, :, 9:] = np.diff(nodes, prepend=0.0)[:, None, None] * np.eye(3)
    states = ErrorStates.build(turns, np.diff(nodes, prepend=0.0), ARW, processes)
    noise = RemainderNoise(tuple(processes))
    seen, wanted = np.arange(3, 20), np.array([1, 12, 19, 25, 30])
    H = np.concatenate([np.tile(np.eye(3), (31, 1, 1)), noise.build_reference_columns(np.zeros((31, 3)))], axis=2)
    z = rng.normal(size=(seen.size, 3, 2))
    stated = np.tile(STATED**2 * np.eye(3), (seen.size, 1, 1))
    white, smoothed, covariance = states.smooth(seen, H[seen], stated, z)
    gain, walk, reading, root = condition_densely(nodes[seen - 1], nodes[wanted - 1], processes)
    np.testing.assert_allclose(smoothed[wanted, :3], np.einsum("wn,nij->wij", gain, z), rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(covariance[wanted, 0, 0], np.diag(walk), rtol=1e-8)
    both = covariance[wanted, 0] @ H[0, 0]
    own = covariance[wanted, 0, 0] + 2 * (both - covariance[wanted, 0, 0]) + (states.variance * H[0, 0, 3:]).sum()
    np.testing.assert_allclose(own, np.diag(reading), rtol=1e-8)
    np.testing.assert_allclose(white, np.einsum("mn,nij->mij", root, z), rtol=1e-8, atol=1e-8 * np.abs(white).max())


def test_memory_grows_with_the_number_of_references_and_not_with_its_square():
    """5,000 references, whose whole covariance would have 1.8 GB; and more than fit are refused before anything is computed."""
    turns = (((0.0, DEG_S, 0.0), 70.0), ((DEG_S, 0.0, 0.0), 70.0), ((0.0, 0.0, DEG_S), 60.0))
    recording = piecewise_recording((turns,), sample_s=0.04, series_s=0.04, rng=np.random.default_rng(1), arw=ARW)
    tracemalloc.start()
    found = predict(recording, 199.0, np.array([199.5, 200.0]))
    calibrate(recording, solve_for="bias")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.used > 4_700
    assert peak < 75e6
    with pytest.raises(InputError, match=r"need \d+\.\d GB, the limit is 4 GB: give a larger --step"):
        _check_memory(10**7, RemainderNoise())
