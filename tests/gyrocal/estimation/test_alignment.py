"""Both algorithms of R's alignment find what was injected, agree once repeated, and show what they cannot represent."""

import numpy as np
import pytest

from gyrocal import InputError, UnobservableError
from gyrocal.estimation.alignment import align_in_two_steps, align_together
from gyrocal.sensors.earth import TRMM_BIASES
from gyrocal.sensors.series import SensorSeries
from simulator.streams import generator
from tests.builders import choose_case_numbers, is_mean_of_chi2, squared_error
from tests.gyrocal.estimation.attitude_cases import (
    ATTITUDE_CASE_ORBIT,
    M_DSS2,
    TRUE_MISALIGNMENT_ANGLES,
    build_alignment_orbit,
    compute_alignment_error,
    make_direction_sensor,
)
from tests.gyrocal.estimation.flights import compute_nadir

INJECTED = np.concatenate([TRUE_MISALIGNMENT_ANGLES, TRMM_BIASES])


@pytest.fixture(scope="module")
def world():
    return build_alignment_orbit()


def test_R_3_is_found_without_noise_by_both_algorithms(world):
    series, gyro = world.exact(), world.motion.gyro()
    one = align_together(series, gyro, world.A[0], "DSS-1")
    np.testing.assert_allclose(compute_alignment_error(one), 0, atol=1e-11)
    np.testing.assert_allclose(one.misalignment["DSS-2"], M_DSS2, atol=2e-6)
    np.testing.assert_allclose(one.attitude, world.A[0], atol=1e-11)
    two = align_in_two_steps(series, gyro, world.A[0], "DSS-1", rounds=None)
    np.testing.assert_allclose(compute_alignment_error(two) / one.sigma, 0, atol=1e-4)
    assert two.rounds > 20
    np.testing.assert_allclose(
        two.covariance / np.outer(one.sigma, one.sigma), one.covariance / np.outer(one.sigma, one.sigma), atol=1e-6
    )


def test_two_steps_made_once_keep_a_part_of_the_misalignment(world):
    """The attitude step has absorbed most of the yaw between the sun sensors already; T tells how much, and of what."""
    series, gyro = world.exact(), world.motion.gyro()
    for rounds in (1, 2, 5):
        found = align_in_two_steps(series, gyro, world.A[0], "DSS-1", rounds=rounds)
        expected = INJECTED - found.retained @ INJECTED
        assert np.abs(expected).max() > 10 * found.sigma[0]
        # First order in angles of 3e-3; the second is 1e-2 of the bias at most.
        np.testing.assert_allclose(compute_alignment_error(found), expected, rtol=0, atol=1e-2 * np.abs(expected).max())
    once = align_in_two_steps(series, gyro, world.A[0], "DSS-1")
    assert 0.1 < once.retained[0, 0] < 0.2  # DSS-2's x is along −Z: yaw
    assert once.loss_after > 100
    trusted = [*series[:2], SensorSeries(series[2].model, world.t, series[2].y, series[2].sigma / 20)]
    heavy = align_in_two_steps(trusted, gyro, world.A[0], "DSS-1")
    assert heavy.retained[0, 0] > 0.9  # with the Earth sensor weighted more, the steps hardly disturb each other


@pytest.mark.parametrize("cases", choose_case_numbers(5, 60))
def test_injected_misalignments_are_covered(world, cases):
    """From whole counts and an independently simulated horizon; two steps about their own mean, and not about the truth."""
    out = {"together": [], "exact": [], "mean": [], "truth": [], "loss": []}
    for case in range(cases):
        rng = generator(54, case, "alignment")
        series, gyro = world.series(rng), world.motion.gyro(rng)
        one = align_together(series, gyro, world.A[0], "DSS-1")
        best = align_together(series, gyro, world.A[0], "DSS-1", weighting="exact")
        two = align_in_two_steps(series, gyro, world.A[0], "DSS-1")
        error = compute_alignment_error(two)
        out["together"].append(squared_error(compute_alignment_error(one), one.covariance))
        out["exact"].append(squared_error(compute_alignment_error(best), best.covariance))
        out["truth"].append(squared_error(error, two.covariance))
        out["mean"].append(squared_error(error - (INJECTED - two.retained @ INJECTED), two.covariance))
        out["loss"].append(best.loss_after)
    assert [way for way in ("together", "exact", "mean") if not is_mean_of_chi2(out[way], 7)] == []
    assert np.mean(out["truth"]) > 100 * 7
    assert is_mean_of_chi2(out["loss"], best.dof)


def test_a_sensor_that_always_sees_one_direction_in_the_body_is_named(world):
    """Nadir stays in the body's z: its sensor may be turned about it. A wrong bias to start from hides that at first."""
    motion, t = world.motion, world.t
    sun = make_direction_sensor("sun", np.tile(world.sun[0], (t.size, 1)))
    earth = make_direction_sensor("earth", compute_nadir(t, ATTITUDE_CASE_ORBIT))
    series = [model.simulate_series(motion, t, 1e-4, generator(54, 0, "nadir")) for model in (sun, earth)]
    with pytest.raises(UnobservableError) as caught:
        align_together(series, motion.gyro(), world.A[0], "sun")
    assert caught.value.combinations == ("earth m_z",)


def test_what_cannot_be_aligned_is_refused(world):
    series, gyro = world.exact(), world.motion.gyro()
    for match, used, reference in (("'DSS-3'", series, "DSS-3"), ("no alignment is left", series[:1], "DSS-1")):
        for algorithm in (align_together, align_in_two_steps):
            with pytest.raises(InputError, match=match):
                algorithm(used, gyro, world.A[0], reference)
    with pytest.raises(InputError, match="did not converge in 3 rounds"):
        align_in_two_steps(series, gyro, world.A[0], "DSS-1", rounds=None, max_rounds=3)
    with pytest.raises(UnobservableError, match="inertial direction"):  # one Sun, and the rotation about it
        align_together(series[:2], gyro, world.A[0], "DSS-1")
