"""Batch attitudes given to the calibrator: their covariance is that of simulated residuals, and leaving part out shows."""

import numpy as np
import pytest

from gyrocal import GyroParameters, InputError, Interval, Recording, calibrate
from gyrocal.attitude import matrix_from_quaternion, residual
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.estimation.reference_covariance import interval_covariance, reference_attitudes, residual_covariance
from simulator.streams import generator
from tests.builders import TRUE_G, choose_case_numbers, is_mean_of_chi2, squared_error
from tests.gyrocal.estimation.attitude_cases import ATTITUDE_CASE_ARW, TRUE_BIAS, build_timeline_flight, run_star_batch
from tests.gyrocal.estimation.reference_cases import (
    BACKWARD,
    COMPONENT_SIGMA,
    FORWARD,
    REFERENCE_CASE_EPOCH,
    SLEW_RATE,
    build_chain_case,
)

TRUTH = GyroParameters(TRUE_G, TRUE_BIAS)
TRUE = TRUTH.vector


def references(motion, gyro, low, high, times, rng, weighting="plain", every_s=30.0):
    """A batch between two times, with attitudes wanted at some."""
    return run_star_batch(motion, gyro, low, high, times, rng, COMPONENT_SIGMA, weighting, every_s)


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
        recording = Recording("shared", REFERENCE_CASE_EPOCH, gyro, reference_attitudes(batches), intervals)
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


def test_references_come_in_the_order_of_time_and_once():
    motion = build_timeline_flight([(FORWARD, 1200.0)], np.eye(3))
    rng = generator(52, 0, "two")
    late = references(motion, motion.gyro(), 600, 1200, (1200, 700), rng)
    early = references(motion, motion.gyro(), 0, 500, (0,), rng)
    found = reference_attitudes([late, early])
    np.testing.assert_array_equal(found.t_s, [0, 700, 1200])
    np.testing.assert_array_equal(found.sigma, [early.attitude_sigma[0], late.attitude_sigma[1], late.attitude_sigma[0]])
    whole, half = Interval("whole", "", 0, 1200), Interval("half", "", 0, 600)
    assert residual_covariance([late, early], [whole], ATTITUDE_CASE_ARW).shape == (6, 6)
    for match, call in (
        ("of one time, 0 s", lambda: reference_attitudes([early, early])),
        ("no batch", lambda: reference_attitudes([])),
        ("whole has 3 references", lambda: interval_covariance([late, early], [whole], ATTITUDE_CASE_ARW)),
        ("half: 1 reference", lambda: residual_covariance([late, early], [half], ATTITUDE_CASE_ARW)),
    ):
        with pytest.raises(InputError, match=match):
            call()


@pytest.mark.parametrize("cases", choose_case_numbers(60, 100))
def test_stretches_between_slews_need_the_covariance_between_intervals(cases):
    """A chain: each stretch ends one slew and starts the next, and is an interval itself; blocks alone waste and misstate."""
    setup = build_chain_case(TRUTH)
    values, sigmas, dof = {"whole": [], "blocks": [], "independent": []}, [], set()
    for case in range(cases):
        recording, batches = setup.draw(generator(53, case, "chain"))
        V = residual_covariance(batches, setup.intervals, setup.arw)
        C = interval_covariance(batches, setup.intervals, setup.arw)
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
    assert dof == {3 * len(setup.intervals) - 12}


def test_a_covariance_of_all_residuals_is_checked():
    setup = build_chain_case(TRUTH)
    recording, batches = setup.draw(generator(53, 0, "chain"))
    V = residual_covariance(batches, setup.intervals, setup.arw)
    lopsided, singular = V.copy(), V.copy()
    lopsided[0, 4] += 0.1 * np.sqrt(V[0, 0] * V[4, 4])
    singular[:3], singular[:, :3] = singular[3:6], singular[:, 3:6]
    definite = "13 residuals, must be symmetric and positive definite"
    for match, value in (("39×39, not 36×36", V[:36, :36]), (definite, lopsided), (definite, singular), (definite, -V)):
        with pytest.raises(InputError, match=match):
            calibrate(recording, residual_covariance=value)
