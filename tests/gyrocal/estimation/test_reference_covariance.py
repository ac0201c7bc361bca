"""Batch attitudes given to the calibrator: their covariance is that of simulated residuals, and leaving part out shows."""

from functools import cache

import numpy as np
import pytest

from gyrocal import GyroParameters, GyroStream, InputError, Interval, Recording, calibrate
from gyrocal.attitude import matrix_from_quaternion, residual
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.estimation.batch import batch
from gyrocal.estimation.reference_covariance import interval_covariance, reference_attitudes, residual_covariance
from simulator.streams import generator
from tests.builders import TRUE_G, choose_case_numbers, is_mean_of_chi2, squared_error
from tests.gyrocal.estimation.attitude_cases import (
    ATTITUDE_CASE_ARW,
    RPO,
    TRUE_BIAS,
    build_timeline_flight,
    make_direction_sensor,
)

TRUTH = GyroParameters(TRUE_G, TRUE_BIAS)
TRUE = TRUTH.vector
EPOCH = "2000-01-01T00:00:00Z"
COMPONENT_SIGMA = 5e-4  # of each component a sensor sees
STAR_DIRECTIONS = (np.array([1.0, 0.2, 0.1]) / np.sqrt(1.05), np.array([-0.3, 0.8, 0.5]) / np.sqrt(0.98))
SLEW_RATE = float(np.deg2rad(0.3))  # rad/s
FORWARD, BACKWARD, SIDEWAYS, STILL = (0.0, -RPO, 0.0), (0.0, RPO, 0.0), (RPO, 0.0, 0.0), (0.0, 0.0, 0.0)
SLEWS = SLEW_RATE * np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0], [0, -1, 0], [-1, 0, 0]])
CHAIN_ARW = 0.2 * ATTITUDE_CASE_ARW  # small, or the gyro's noise hides what is shared


def references(motion, gyro, low, high, times, rng, weighting="plain", every_s=30.0):
    """A batch of two sensors of fixed directions, always in view, between two times, with attitudes wanted at some."""
    t = np.arange(low, high + 1e-9, every_s)
    sensors = [make_direction_sensor(f"star {k}", np.tile(one, (t.size, 1))) for k, one in enumerate(STAR_DIRECTIONS)]
    series = [sensor.simulate_series(motion, t, COMPONENT_SIGMA, rng) for sensor in sensors]
    return batch(series, gyro, motion.get_attitudes([low])[0], epoch_s=low, times=times, weighting=weighting)


@cache
def build_chain():
    """A flight, spans of batches, and intervals that share batches."""
    parts, intervals, spans, clock = [], [], [], 0.0
    for k, rate in enumerate((FORWARD, BACKWARD, FORWARD, SIDEWAYS, BACKWARD, STILL, FORWARD)):
        spans.append((clock, clock + 900.0, (clock, clock + 900.0)))
        following = [(f"slew {k}", SLEWS[k], 600.0)] if k < len(SLEWS) else []
        for name, turn, length in [(f"arc {k}", rate, 900.0), *following]:
            parts.append((turn, length))
            intervals.append(Interval(name, "", clock, clock + length))
            clock += length
    return build_timeline_flight(parts, TRUTH.G, arw=CHAIN_ARW, bias=TRUTH.bias), spans, tuple(intervals)


def draw_chain(rng):
    """A recording of the chain with noise and the intervals of which batches are its references; and the batches."""
    motion, spans, intervals = build_chain()
    gyro = motion.gyro(rng)
    batches = [references(motion, gyro, *span, rng) for span in spans]
    stream = GyroStream(gyro.t_s, gyro.rates, gyro.sample_s, CHAIN_ARW)
    return Recording("chain", EPOCH, stream, reference_attitudes(batches), intervals), batches


@pytest.mark.parametrize("cases", choose_case_numbers(40, 300))
@pytest.mark.parametrize("weighting", ["plain", "exact"])
def test_residuals_have_the_stated_covariance_with_all_that_is_shared(weighting, cases):
    """Both ends of one batch, a batch that overlaps the interval, neighbours that share a batch: in one timeline."""
    arw = 4 * ATTITUDE_CASE_ARW
    motion = build_timeline_flight(
        [(FORWARD, 600.0), ((0, 0, SLEW_RATE), 200.0), (BACKWARD, 600.0), (BACKWARD, 400.0)], np.eye(3), arw=arw
    )
    intervals = (Interval("within", "", 0, 400), Interval("slew", "", 400, 1000), Interval("rest", "", 1200, 1800))
    spans = ((0, 600, (0, 400)), (800, 1400, (1000, 1200)), (1500, 1700, (1800,)))
    draws = []
    for case in range(cases):
        rng = generator(52, case, weighting)
        gyro = motion.gyro(rng)
        batches = [references(motion, gyro, *span, rng, weighting, every_s=60.0) for span in spans]
        recording = Recording("shared", EPOCH, gyro, reference_attitudes(batches), intervals)
        prepared, A = prepare_measurements(recording), matrix_from_quaternion(recording.attitudes.quaternions)
        R = propagate(prepared.arcs, np.eye(3), TRUE_BIAS).R
        draws.append(residual(A[prepared.row], R @ A[prepared.start]).ravel())
    draws = np.array(draws)
    V = residual_covariance(batches, intervals, arw)
    white = np.linalg.solve(np.linalg.cholesky(V), draws.T)
    # Elements of a whitened covariance scatter by 1/sqrt(cases), its diagonal by sqrt(2/cases); 5 sigma.
    np.testing.assert_allclose(white @ white.T / cases, np.eye(9), atol=5 * np.sqrt(2 / cases))
    assert is_mean_of_chi2(np.square(white).sum(axis=0), 9)
    np.testing.assert_array_equal(interval_covariance(batches, intervals, arw)[1], V[3:6, 3:6])


@pytest.mark.parametrize("cases", choose_case_numbers(60, 100))
def test_stretches_between_slews_need_the_covariance_between_intervals(cases):
    """A chain: each stretch ends one slew and starts the next, and is an interval itself; blocks alone waste and misstate."""
    values, sigmas, dof = {"whole": [], "blocks": [], "independent": []}, [], set()
    for case in range(cases):
        recording, batches = draw_chain(generator(53, case, "chain"))
        V = residual_covariance(batches, recording.intervals, CHAIN_ARW)
        C = interval_covariance(batches, recording.intervals, CHAIN_ARW)
        found = {
            "whole": calibrate(recording, residual_covariance=V),
            "blocks": calibrate(recording, interval_covariance=C),
            "independent": calibrate(recording),
        }
        for name, result in found.items():
            values[name].append(squared_error(TRUE - result.parameters.vector, result.covariance))
        sigmas.append(found["blocks"].sigma / found["whole"].sigma)
        dof.add(found["whole"].dof)
    assert is_mean_of_chi2(values["whole"], 12)
    assert not is_mean_of_chi2(values["blocks"], 12)
    assert not is_mean_of_chi2(values["independent"], 12)
    assert np.mean(sigmas) > 1.3
    assert dof == {3 * len(recording.intervals) - 12}


def test_references_come_in_the_order_of_time_and_once():
    motion, rng = build_timeline_flight([(FORWARD, 1200.0)], np.eye(3)), generator(52, 0, "two")
    late, early = (references(motion, motion.gyro(), *span, rng) for span in ((600, 1200, (1200, 700)), (0, 500, (0,))))
    found = reference_attitudes([late, early])
    np.testing.assert_array_equal(found.t_s, [0, 700, 1200])
    np.testing.assert_array_equal(found.sigma, [early.attitude_sigma[0], *late.attitude_sigma[::-1]])
    with pytest.raises(InputError, match="of one time, 0 s"):
        reference_attitudes([early, early])


def test_a_covariance_of_all_residuals_is_checked():
    recording, batches = draw_chain(generator(53, 0, "chain"))
    V = residual_covariance(batches, recording.intervals, CHAIN_ARW)
    lopsided, singular = V.copy(), V.copy()
    lopsided[0, 4] += 0.1 * np.sqrt(V[0, 0] * V[4, 4])
    singular[:3], singular[:, :3] = singular[3:6], singular[:, 3:6]
    definite = "13 residuals, must be symmetric and positive definite"
    for match, value in (("39×39, not 36×36", V[:36, :36]), (definite, lopsided), (definite, singular), (definite, -V)):
        with pytest.raises(InputError, match=match):
            calibrate(recording, residual_covariance=value)
