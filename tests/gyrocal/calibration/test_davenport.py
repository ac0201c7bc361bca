"""The calibrator recovers what is known, in every form it is offered in."""

from dataclasses import replace

import numpy as np
import pytest

from gyrocal import (
    NAMES,
    GyroParameters,
    InputError,
    RecursiveCalibrator,
    UnobservableError,
    attitude,
    calibrate,
)
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from gyrocal.calibration.problem import Problem
from gyrocal.calibration.sampling import prepare_measurements
from tests.builders import PLAN, PRELAUNCH, RPO, TRUTH, piecewise_recording


@pytest.fixture(scope="module")
def ends():
    return piecewise_recording()


@pytest.fixture(scope="module")
def series():
    return piecewise_recording(series_s=150.0)


@pytest.mark.parametrize("kind", ["ends", "series"])
@pytest.mark.parametrize("psi", ["full", "linear"])
def test_noise_free_piecewise_constant_rates_are_recovered(kind, psi, request):
    result = calibrate(request.getfixturevalue(kind), psi=psi)
    assert result.converged
    np.testing.assert_allclose(result.G, TRUTH.G, rtol=0, atol=1e-10)
    np.testing.assert_allclose(result.bias, TRUTH.bias, rtol=0, atol=1e-13)
    assert np.abs(result.residuals.filter(like="after").to_numpy()).max() < 1e-9


@pytest.mark.parametrize(("space", "solve_for"), [("gain", "all"), ("gyro", "all,-c_y")])
def test_recursive_calibrator_equals_the_compiled_batch(space, solve_for):
    recording = piecewise_recording(arw=np.deg2rad(2e-4), rng=np.random.default_rng(3), sample_s=10.0)
    references = recording.attitudes
    # One sigma about all axes would hide in which direction the noise at the start is turned to the end.
    recording = replace(recording, attitudes=replace(references, sigma=references.sigma * [1.0, 2.0, 5.0]))
    batch = calibrate(recording, iterations=1, parametrisation=space, solve_for=solve_for)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    recursive = RecursiveCalibrator(batch.initial, recording.gyro.arw, solve_for, parametrisation=space)
    prepared = prepare_measurements(recording)
    theta = []
    for j, arc in enumerate(prepared.arcs.arc):
        recursive.start(A[prepared.start[j]], recording.attitudes.sigma[prepared.start[j]])
        interval = recording.intervals[arc]
        inside = (recording.gyro.t_s >= interval.start_s) & (recording.gyro.t_s < interval.stop_s)
        for raw in recording.gyro.rates[inside]:
            recursive.sample(raw, 10.0)
        theta.append(recursive.finish(A[prepared.row[j]], recording.attitudes.sigma[prepared.row[j]]))
    parameters, P = recursive.solve()
    np.testing.assert_allclose(parameters.vector[:9], batch.parameters.vector[:9], rtol=0, atol=1e-12)
    np.testing.assert_allclose(parameters.bias, batch.bias, rtol=0, atol=1e-15)
    kept = np.flatnonzero(np.diag(batch.own_covariance))
    np.testing.assert_allclose(P, batch.own_covariance[np.ix_(kept, kept)], rtol=1e-7)
    before = batch.residuals[["before_roll_deg", "before_pitch_deg", "before_yaw_deg"]].to_numpy()
    np.testing.assert_allclose(np.rad2deg(theta), before, atol=1e-10)


@pytest.mark.parametrize("solve_for", ["all,-misalignment", "G_zz,b_x"])
def test_subset_is_found_when_the_rest_is_right(ends, solve_for):
    initial = TRUTH.vector.copy()
    solved = calibrate(ends, solve_for=solve_for, initial=TRUTH).solved_for
    columns = [NAMES.index(name) for name in solved]
    initial[columns] += np.where(np.array(columns) < 9, 1e-3, 1e-6)
    result = calibrate(ends, solve_for=solve_for, initial=GyroParameters.from_vector(initial))
    np.testing.assert_allclose(result.parameters.vector, TRUTH.vector, rtol=0, atol=1e-10)
    assert np.flatnonzero(result.sigma).tolist() == columns


def test_too_few_intervals_report_what_is_free_with_the_plausible_ranges_as_prior():
    result = calibrate(piecewise_recording(PLAN[:3]))
    free = result.observability.unobservable
    # Nine residuals, twelve parameters: at least three combinations are free.
    assert 3 <= len(free) < 12
    assert result.has_plausible_prior
    assert result.options["prior_sigma"]["G_xx"] == PLAUSIBLE_G
    assert result.undetermined
    # A free combination keeps the sigma of its plausible range, whose length along it is between the parameters' own.
    assert all(sigma > 0.5 * PLAUSIBLE_G for text, sigma in zip(free, result.unobservable_sigma, strict=True) if "G_" in text)


def test_a_recording_that_determines_nothing_ends_in_one_line_that_names_what_to_do():
    recording = piecewise_recording(PLAN[1:2], sigma_deg=20.0)
    with pytest.raises(UnobservableError) as caught:
        calibrate(recording)
    assert len(caught.value.combinations) == 12
    assert all(name in str(caught.value) for name in ("solve_for", "apriori_covariance", "--solve-for", "--prior-sigma-g"))


def test_unchanging_rate_names_scale_against_bias():
    plan = tuple((((0.0, -RPO, 0.0), 600.0 + 60 * k),) for k in range(6))
    recording = piecewise_recording(plan, arw=np.deg2rad(2e-4), rng=np.random.default_rng(8))
    result = calibrate(recording, solve_for="G_yy,b_y")
    (name,) = result.observability.unobservable
    assert name.startswith("1 G_yy + ")
    # δG_yy ω_raw + δb_y = 0 with ω_raw ≈ −0.0656 deg/s leaves δb_y = +0.0656 deg/s per unit of δG_yy.
    assert float(name.split("+ ")[1].split()[0]) == pytest.approx(0.0656, rel=0.01)
    # Along it the prior alone counts: δG_yy/0.01 and δb_y/(10 deg/h) have one variance of one together.
    slope = RPO / PLAUSIBLE_BIAS * PLAUSIBLE_G
    assert result.unobservable_sigma[0] == pytest.approx(PLAUSIBLE_G / np.hypot(1, slope), rel=0.01)


def test_both_tolerances_must_be_met(ends):
    """G converges in two iterations, as do the biases; a tolerance that any correction meets does not stop the other."""
    for tolerance in ({"tolerance_G": 1.0}, {"tolerance_bias": 1.0}):
        assert len(calibrate(ends, initial=PRELAUNCH, **tolerance).corrections) > 1
    assert len(calibrate(ends, initial=PRELAUNCH, tolerance_G=1.0, tolerance_bias=1.0).corrections) == 1


def test_the_prior_is_counted_once_over_iterations():
    # A Gaussian prior far tighter than the data keeps the parameters at their initial values however often one iterates.
    recording = piecewise_recording()
    prior = np.diag([1e-9**2] * 9 + [1e-13**2] * 3)
    result = calibrate(recording, initial=PRELAUNCH, apriori_covariance=prior, iterations=5)
    np.testing.assert_allclose(result.parameters.vector, PRELAUNCH.vector, rtol=0, atol=1e-8)
    # And for a comparable one the answer is the minimum of the penalised sum: its gradient vanishes.
    prior = np.diag([1e-4**2] * 9 + [1e-7**2] * 3)
    few = calibrate(recording, initial=PRELAUNCH, apriori_covariance=prior, iterations=3)
    many = calibrate(recording, initial=PRELAUNCH, apriori_covariance=prior, iterations=8)
    np.testing.assert_allclose(few.parameters.vector, many.parameters.vector, rtol=0, atol=1e-10)
    assert np.abs(few.G - PRELAUNCH.G).max() > 1e-4


@pytest.mark.parametrize(
    ("kwargs", "text"),
    [
        ({"iterations": 0}, "at least one iteration"),
        ({"step_s": 0.7}, "multiple"),
        ({"apriori_covariance": -np.eye(12)}, "positive definite"),
        ({"interval_covariance": np.zeros((2, 3, 3))}, "6×3×3"),
        ({"solve_for": "G_ab"}, "unknown parameter"),
    ],
)
def test_bad_arguments_are_refused(ends, kwargs, text):
    with pytest.raises(InputError, match=text):
        calibrate(ends, **kwargs)


def test_a_prepared_problem_takes_another_cases_data():
    first, second = (
        piecewise_recording(arw=np.deg2rad(2e-4), rng=np.random.default_rng(seed), sample_s=2.0) for seed in (1, 2)
    )
    prepared = Problem.build(first, prepare_measurements(first, 4.0, "average"))
    A = attitude.matrix_from_quaternion(second.attitudes.quaternions)
    moved = prepared.replace_case(second.gyro.rates, A).iterate(PRELAUNCH.vector, 2)
    expected = calibrate(second, initial=PRELAUNCH, iterations=2, step_s=4.0, resampling="average")
    np.testing.assert_allclose(moved.x[-1], expected.parameters.vector, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(prepared.measurements.arcs.raw, prepare_measurements(first, 4.0, "average").arcs.raw)


def test_chi2_with_a_prior_has_the_degrees_of_freedom_it_claims():
    """30 good recordings: the mean of χ² is its degrees of freedom, with a prior as without; 5 standard errors."""
    prior = np.diag([1e-3**2] * 9 + [np.deg2rad(1e-4) ** 2] * 3)
    rng = np.random.default_rng(9)
    drawn = {None: [], "prior": []}
    dofs = {}
    for seed in range(30):
        recording = piecewise_recording(arw=np.deg2rad(2e-4), rng=np.random.default_rng(seed), sample_s=10.0, series_s=300.0)
        initial = GyroParameters.from_vector(TRUTH.vector + rng.normal(size=12) * np.sqrt(np.diag(prior)))
        for key, covariance in ((None, None), ("prior", prior)):
            result = calibrate(recording, initial=initial, apriori_covariance=covariance)
            drawn[key].append(result.chi2)
            dofs[key] = result.dof
    assert dofs["prior"] == dofs[None] + 12
    for key, values in drawn.items():
        assert np.mean(values) == pytest.approx(dofs[key], abs=5 * np.sqrt(2 * dofs[key] / 30))


def test_residual_sigma_is_that_of_the_covariance():
    recording = piecewise_recording(arw=np.deg2rad(2e-4), sigma_deg=0.01)
    result = calibrate(recording, initial=TRUTH)
    T = np.array([interval.stop_s - interval.start_s for interval in recording.intervals])
    expected = np.sqrt(2 * 0.01**2 + 2e-4**2 * T)  # both ends and the gyro; isotropic, so rotations do not matter
    np.testing.assert_allclose(result.residuals["sigma_pitch_deg"], expected, rtol=1e-9)
