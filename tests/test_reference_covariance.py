"""Batch attitudes given to the calibrator: their covariance is that of simulated residuals, and leaving part out shows."""

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from gyrocal import GyroStream, InputError, Interval, Recording, calibrate
from gyrocal.attitude import matrix_from_quaternion, residual, rotation_matrix
from gyrocal.propagation import propagate
from gyrocal.reference import batch
from gyrocal.reference_covariance import (
    correlated_intervals,
    interval_covariance,
    reference_attitudes,
    residual_covariance,
)
from gyrocal.sampling import measurements
from simulator.streams import generator
from tests.attitude_sensors import ARW, RPO, TRUE_BIAS, star_series, timeline
from tests.builders import TRUE_G

SIGMA = 5e-4
SLEW = np.deg2rad(0.3)
TRUE = np.concatenate([TRUE_G.ravel(), TRUE_BIAS])
EPOCH = "2000-01-01T00:00:00Z"
FORWARD, BACKWARD, SIDEWAYS, STILL = (0, -RPO, 0), (0, RPO, 0), (RPO, 0, 0), (0, 0, 0)


def references(motion, gyro, low, high, times, rng, weighting="plain", every_s=30.0):
    """A batch between two times, with attitudes wanted at some."""
    series = star_series(motion, low, high, every_s, SIGMA, rng)
    return batch(series, gyro, motion.at(low), epoch_s=low, times=times, weighting=weighting)


def solved(recording, V, iterations=4):
    """The calibration with one covariance V of all residuals: parameters and P. What `calibrate` does block by block."""
    prepared, A = measurements(recording), matrix_from_quaternion(recording.attitudes.quaternions)
    scale = np.array([1e-3] * 9 + [1e-7] * 3)
    x, W = np.concatenate([np.eye(3).ravel(), np.zeros(3)]), np.linalg.inv(V)
    for _ in range(iterations):
        passed = propagate(prepared.arcs, x[:9].reshape(3, 3), x[9:])
        theta = residual(A[prepared.row], passed.R @ A[prepared.start]).ravel()
        H = passed.Theta.reshape(-1, 12) * scale
        P = np.linalg.inv(H.T @ W @ H)
        x = x - scale * (P @ H.T @ W @ theta)
    return x, P * np.outer(scale, scale)


def nees(error, covariance):
    return error @ np.linalg.solve(covariance, error)


def inside(values, p, confidence=0.999):
    n = len(values)
    low, high = scipy.stats.chi2.ppf([(1 - confidence) / 2, (1 + confidence) / 2], n * p) / n
    return low < np.mean(values) < high


@pytest.mark.parametrize("weighting", ["plain", "exact"])
def test_residuals_have_the_stated_covariance_with_all_that_is_shared(weighting):
    """Both ends of one batch, a batch that overlaps the interval, neighbours that share a batch: in one timeline."""
    cases, arw = 300, 4 * ARW
    motion = timeline([(FORWARD, 600.0), ((0, 0, SLEW), 200.0), (BACKWARD, 600.0), (BACKWARD, 400.0)], np.eye(3), arw=arw)
    intervals = (Interval("within", "", 0, 400), Interval("slew", "", 400, 1000), Interval("rest", "", 1200, 1800))
    spans = ((0, 600, (0, 400)), (800, 1400, (1000, 1200)), (1500, 1700, (1800,)))
    draws = []
    for case in range(cases):
        rng = generator(52, case, weighting)
        gyro = motion.gyro(rng)
        batches = [references(motion, gyro, *span, rng, weighting, every_s=60.0) for span in spans]
        recording = Recording("shared", EPOCH, gyro, reference_attitudes(batches), intervals)
        prepared, A = measurements(recording), matrix_from_quaternion(recording.attitudes.quaternions)
        R = propagate(prepared.arcs, np.eye(3), TRUE_BIAS).R
        draws.append(residual(A[prepared.row], R @ A[prepared.start]).ravel())
    draws = np.array(draws)
    V = residual_covariance(batches, intervals, arw)
    white = np.linalg.solve(np.linalg.cholesky(V), draws.T)
    # Elements of a whitened covariance scatter by 1/sqrt(cases), its diagonal by sqrt(2/cases); 5 sigma.
    np.testing.assert_allclose(white @ white.T / cases, np.eye(9), atol=5 * np.sqrt(2 / cases))
    blocks = interval_covariance(batches, intervals, arw)
    np.testing.assert_array_equal(blocks[1], V[3:6, 3:6])
    assert correlated_intervals(batches, intervals, arw) > 0.1
    # What the references' sigmas say by themselves is something else.
    sigma = [one.attitude_sigma for one in batches]
    alone = sigma[0][1, 0] ** 2 + sigma[1][0, 0] ** 2 + arw**2 * 600
    assert abs(blocks[1][0, 0] / alone - 1) > 0.15


def test_two_attitudes_of_one_plain_batch_measure_the_bias_and_nothing_else():
    motion = timeline([(FORWARD, 1200.0)], np.eye(3))
    found = references(motion, motion.gyro(), 0, 1200, (0, 900), generator(52, 0, "one"))
    C = interval_covariance([found], [Interval("all", "", 0, 900)], ARW)[0]
    # ψ over 900 s at a constant rate, N (11), by quadrature.
    tau = np.linspace(0, 900, 2001)
    turns = rotation_matrix(-tau[:, None] * (np.array(FORWARD) + found.bias - TRUE_BIAS))
    S = np.trapezoid(turns, tau, axis=0)
    np.testing.assert_allclose(C, S @ found.covariance[3:6, 3:6] @ S.T, rtol=1e-5, atol=1e-14)


def test_references_come_in_the_order_of_time_and_once():
    motion = timeline([(FORWARD, 1200.0)], np.eye(3))
    rng = generator(52, 0, "two")
    late = references(motion, motion.gyro(), 600, 1200, (1200, 700), rng)
    early = references(motion, motion.gyro(), 0, 500, (0,), rng)
    found = reference_attitudes([late, early])
    np.testing.assert_array_equal(found.t_s, [0, 700, 1200])
    np.testing.assert_array_equal(found.sigma, [early.attitude_sigma[0], late.attitude_sigma[1], late.attitude_sigma[0]])
    whole, half = Interval("whole", "", 0, 1200), Interval("half", "", 0, 600)
    assert residual_covariance([late, early], [whole], ARW).shape == (6, 6)
    for match, call in (
        ("of one time, 0 s", lambda: reference_attitudes([early, early])),
        ("no batch", lambda: reference_attitudes([])),
        ("whole has 3 references", lambda: interval_covariance([late, early], [whole], ARW)),
        ("half: 1 reference", lambda: residual_covariance([late, early], [half], ARW)),
    ):
        with pytest.raises(InputError, match=match):
            call()


@pytest.fixture(scope="module")
def separate():
    """NEES of a calibration from intervals apart, with the intervals' C and with references taken as independent.

    Four stretches at constant rate, both ends of each extrapolated by the gyro from one batch in its middle third; four slews
    between batches before and after.
    """
    flights = []
    for k, rate in enumerate((FORWARD, BACKWARD, SIDEWAYS, STILL)):
        flights.append(([(rate, 1800.0)], [(600, 1200, (0, 1800))], (0, 1800), 4000.0 * k))
    slews = ((FORWARD, (0, 0, SLEW), BACKWARD), (BACKWARD, (SLEW, 0, 0), STILL))
    slews += ((FORWARD, (0, SLEW, 0), STILL), (SIDEWAYS, (0, 0, -SLEW), FORWARD))
    for k, (before, slew, after) in enumerate(slews):
        parts = [(before, 900.0), (slew, 600.0), (after, 900.0)]
        flights.append((parts, [(0, 900, (900,)), (1500, 2400, (1500,))], (900, 1500), 16000.0 + 4000.0 * k))
    motions = [
        timeline(parts, TRUE_G, start_s=start_s, start=rotation_matrix(np.array([0.1, 0.2 * k, 0.3])))
        for k, (parts, _, _, start_s) in enumerate(flights)
    ]
    intervals = tuple(Interval(f"m{k}", "", at + low, at + high) for k, (_, _, (low, high), at) in enumerate(flights))
    out = {"given": [], "independent": []}
    for case in range(100):
        rng = generator(53, case, "separate")
        gyros = [motion.gyro(rng) for motion in motions]
        batches = [
            references(motion, gyro, at + low, at + high, [at + t for t in times], rng)
            for motion, gyro, (_, spans, _, at) in zip(motions, gyros, flights, strict=True)
            for low, high, times in spans
        ]
        stream = GyroStream(np.concatenate([g.t_s for g in gyros]), np.concatenate([g.rates for g in gyros]), 2.0, ARW)
        recording = Recording("separate", EPOCH, stream, reference_attitudes(batches), intervals)
        C = interval_covariance(batches, intervals, ARW)
        for name, options in (("given", {"interval_covariance": C}), ("independent", {})):
            result = calibrate(recording, **options)
            error = TRUE - result.parameters.vector
            out[name].append((nees(error, result.covariance), nees(error[9:], result.covariance[9:, 9:])))
    assert correlated_intervals(batches, intervals, ARW) < 1e-12
    return {name: np.array(values).T for name, values in out.items()}


def test_the_calibration_from_batch_attitudes_is_covered(separate):
    everything, bias = separate["given"]
    assert inside(everything, 12)
    assert inside(bias, 3)


def test_without_the_shared_bias_it_is_not(separate):
    everything, bias = separate["independent"]
    assert not inside(bias, 3)
    assert np.mean(bias) > 1.2 * 3
    assert np.mean(everything) > np.mean(separate["given"][0]) + 0.5


def test_stretches_between_slews_need_the_covariance_between_intervals():
    """A chain: each stretch ends one slew and starts the next, and is an interval itself; blocks alone waste and misstate."""
    rates = (FORWARD, BACKWARD, FORWARD, SIDEWAYS, BACKWARD, STILL, FORWARD)
    slews = ((0, 0, SLEW), (0, 0, -SLEW), (SLEW, 0, 0), (0, SLEW, 0), (0, -SLEW, 0), (-SLEW, 0, 0))
    parts, intervals, spans, clock = [], [], [], 0.0
    for k, rate in enumerate(rates):
        for name, part in ((f"stretch {k}", (rate, 900.0)), (f"slew {k}", (slews[k], 600.0) if k < len(slews) else None)):
            if part is None:
                continue
            parts.append(part)
            intervals.append(Interval(name, "", clock, clock + part[1]))
            clock += part[1]
        spans.append((intervals[2 * k].start_s, intervals[2 * k].stop_s))
    arw = 0.2 * ARW
    motion = timeline(parts, TRUE_G, arw=arw)
    whole, blocks, sigmas = [], [], []
    for case in range(100):
        rng = generator(53, case, "chain")
        gyro = motion.gyro(rng)
        batches = [references(motion, gyro, low, high, (low, high), rng) for low, high in spans]
        recording = Recording("chain", EPOCH, gyro, reference_attitudes(batches), tuple(intervals))
        V = residual_covariance(batches, intervals, arw)
        x, P = solved(recording, V)
        whole.append(nees(TRUE - x, P))
        C = interval_covariance(batches, intervals, arw)
        result = calibrate(recording, interval_covariance=C)
        blocks.append(nees(TRUE - result.parameters.vector, result.covariance))
        sigmas.append(result.sigma / np.sqrt(np.diag(P)))
    apart, P_apart = solved(recording, scipy.linalg.block_diag(*C))
    np.testing.assert_allclose(apart, result.parameters.vector, rtol=0, atol=1e-4 * np.sqrt(np.diag(P_apart)).max())
    assert correlated_intervals(batches, intervals, arw) > 0.5
    assert inside(whole, 12)
    assert not inside(blocks, 12)
    assert np.mean(sigmas) > 1.3
