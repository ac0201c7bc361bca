"""Dithers: attitudes and rates against the simulator, sigmas against Monte Carlo and the closed form of a sinusoid in noise."""

import numpy as np
import pytest

from diagnosis.plan.dither import add_dither, build_dither, compute_dither_amplitude
from diagnosis.plan.slew_design import SlewLimits
from gyrocal import InputError, calibrate
from gyrocal.attitude import matrix_from_quaternion
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from simulator.scenario import build_profiles, format_scenario, load, override
from simulator.simulate import compute_noise_free_rates, motion, realise, simulate
from simulator.streams import generator
from studies.report.optimised_plan import build_dither_table, format_headline

LIMITS = SlewLimits(*np.deg2rad([0.25, 0.0094]), 0.0)
BUDGET = np.deg2rad(3.0)


@pytest.fixture(scope="module")
def still():
    """The intervals of trmm_series without a slew: with orbit rates alone, six elements of G are unobservable."""
    whole = override(load("trmm_series"), {"gyro.sample_s": 5.0})
    return whole.model_copy(update={"interval": tuple(one for one in whole.interval if not one.slew)})


@pytest.fixture(scope="module")
def dithered(still):
    return add_dither(still, BUDGET, LIMITS)


def test_the_amplitude_turns_by_the_budget_at_most():
    """Against matrices of all 8 corners and of random angles inside."""
    A = compute_dither_amplitude(BUDGET)
    angles = np.concatenate(
        [A * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8).T, A * np.random.default_rng(0).uniform(-1, 1, (200, 3))]
    )
    half = 0.5 * angles
    c, s = np.cos(half), np.sin(half)
    turned = 2 * np.arccos(np.minimum(c.prod(axis=1) - s.prod(axis=1), c.prod(axis=1) + s.prod(axis=1)))
    assert turned.max() == pytest.approx(BUDGET)
    assert pytest.approx(BUDGET / np.sqrt(3), rel=0.02) == A


@pytest.mark.parametrize(
    "limits", [LIMITS, SlewLimits(*np.deg2rad([0.05, 1.0]), 0.0), SlewLimits(*np.deg2rad([1.0, 0.002]), 0.0)]
)
def test_attitude_and_rate_stay_within_budget_and_limits(still, limits):
    """The simulated attitude to that without a dither; rate and acceleration by differences of this rotation over 0.5 s."""
    ends = override(still, {"reference.at": "ends", "gyro.sample_s": 0.5})
    section = ends.interval[0].model_copy(update={"stop_s": ends.interval[0].start_s + 6000.0})
    moved = section.model_copy(update={"control_motion": build_dither(section, ends, BUDGET, limits)})
    plain, path = (build_profiles(ends.model_copy(update={"interval": (one,)}))[0] for one in (section, moved))
    tau = np.arange(0.0, 6000.0, 0.5)
    R = path.attitude(tau) @ plain.attitude(tau).transpose(0, 2, 1)
    angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert 0.9 * BUDGET < angle.max() <= BUDGET * (1 + 1e-9)
    assert np.allclose(R[0], np.eye(3), atol=1e-9)
    steps = R[1:] @ R[:-1].transpose(0, 2, 1)
    rates = np.stack(
        [steps[:, 1, 2] - steps[:, 2, 1], steps[:, 2, 0] - steps[:, 0, 2], steps[:, 0, 1] - steps[:, 1, 0]], axis=1
    )
    rates /= 2 * 0.5
    rate, slope = (np.linalg.norm(one, axis=1).max() for one in (rates, np.diff(rates, axis=0) / 0.5))
    assert rate <= limits.rate
    assert slope <= limits.acceleration
    assert max(rate / limits.rate, slope / limits.acceleration) > 0.8  # the two slower sinusoids have smaller peaks


def test_the_simulated_attitude_is_that_of_the_file(dithered, tmp_path):
    """The integrated truth, with the inertial hold, stays within the budget and ends in the attitude without a dither."""
    (tmp_path / "dither.toml").write_text(format_scenario(dithered.scenario))
    assert load(tmp_path / "dither.toml") == dithered.scenario
    plain, moved = (matrix_from_quaternion(motion(one).quaternions) for one in (dithered.baseline, dithered.scenario))
    cosine = (np.einsum("nij,nij->n", plain, moved) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    assert 0.8 * BUDGET < angle.max() <= BUDGET * (1 + 1e-6)
    assert angle[[0, -1]].max() < 1e-7


def test_sigmas_are_those_of_a_sinusoid_in_noise_and_of_simulated_calibrations(dithered):
    """σ of G_ij from N references is S/(A √(N/2)), S² = σ_ref² + q/4; a random walk of q per step has q/4 at the Nyquist
    number.

    Off the orbit rate's axis y, which the rate itself shows. Errors of 30 cases with these sigmas: the mean square of whitened
    ones has a relative standard error of √(2/(12 × 30)).
    """
    scenario = dithered.scenario
    recording = simulate(scenario, noise=False)
    assert dithered.sigma == pytest.approx(calibrate(recording).sigma)
    A = compute_dither_amplitude(BUDGET)
    every, count = scenario.reference.every_s, sum(one.stop_s - one.start_s for one in scenario.interval) / 60.0
    walk = np.deg2rad(scenario.gyro.arw_deg_per_sqrt_s) ** 2 * every
    expected = np.sqrt(np.deg2rad(scenario.reference.sigma_deg[0]) ** 2 + walk / 4) / (A * np.sqrt(count / 2))
    assert dithered.sigma.take([0, 2, 3, 5, 6, 8]) == pytest.approx(expected, rel=0.05)
    assert dithered.baseline_sigma.take([0, 2, 3, 5, 6, 8]) == pytest.approx(0.01, rel=0.01)  # the plausible range alone

    path = motion(scenario)
    rates = compute_noise_free_rates(scenario, path)
    problem = Problem.build(recording, prepare_measurements(recording))
    truth = np.append(np.ravel(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))
    errors = []
    for case in range(30):
        drawn, quaternions = realise(scenario, path, rates, *(generator(7, case, n) for n in ("gyro_noise", "reference_noise")))
        errors.append(
            problem.replace_case(drawn, matrix_from_quaternion(quaternions)).iterate(truth, 1, look_back=False).x[-1] - truth
        )
    stated = calibrate(recording)
    root = np.linalg.cholesky(stated.covariance / np.outer(stated.sigma, stated.sigma))
    white = np.linalg.solve(root, (np.array(errors) / stated.sigma).T)
    assert np.mean(white**2) == pytest.approx(1.0, abs=3.5 * np.sqrt(2 / white.size))


def test_a_dither_without_references_inside_gains_nothing_and_this_is_said(still):
    found = add_dither(override(still, {"reference.at": "ends"}), np.deg2rad(0.1), LIMITS)
    assert found.sigma == pytest.approx(found.baseline_sigma, rel=1e-3)
    assert "gains nothing" in format_headline(found)
    assert len(build_dither_table(found)) == len(still.interval)


def test_the_slews_stay_and_what_cannot_be_dithered_is_refused(still, dithered):
    whole = add_dither(override(load("trmm_series"), {"gyro.sample_s": 5.0}), BUDGET, LIMITS)
    assert [bool(one.control_motion) for one in whole.scenario.interval] == [not one.slew for one in whole.baseline.interval]
    assert [one.slew for one in whole.scenario.interval] == [one.slew for one in whole.baseline.interval]
    assert "gains nothing" not in format_headline(whole)
    with pytest.raises(InputError, match="has a control motion already"):
        add_dither(dithered.scenario, BUDGET, LIMITS)
    with pytest.raises(InputError, match="no interval has room for a dither"):
        add_dither(still, BUDGET, SlewLimits(1e-6, 1e-6, 0.0))
    with pytest.raises(InputError, match="no reference attitudes"):
        add_dither(override(still, {"reference.at": "none"}), BUDGET, LIMITS)
    first = still.interval[0]
    later = first.model_copy(update={"name": "next", "start_s": first.stop_s, "stop_s": first.stop_s + 600.0})
    with pytest.raises(InputError, match="no interval has room"):
        add_dither(override(still, {"interval": [one.model_dump(exclude_none=True) for one in (first, later)]}), BUDGET, LIMITS)
    moving = later.model_copy(update={"control_motion": build_dither(later, still, BUDGET, LIMITS)})
    with pytest.raises(InputError, match="has another control_motion"):
        override(still, {"interval": [one.model_dump(exclude_none=True) for one in (first, moving)]})
