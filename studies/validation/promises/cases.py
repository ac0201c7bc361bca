"""One case of the study of promises: a plan and a grade of noise, flown once, and what each estimator states of it.

A row is a statement about a truth that is known: a covariance P with the error e it is of, whose NEES eᵀP⁻¹e is χ² with
its degrees of freedom if P is right. All errors of one row are judged together, so that the rows of a promise are independent
from case to case.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal import GyroParameters, InputError, attitude, calibrate, calibrate_gyros
from gyrocal.estimation.batch import batch
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.full_filter import Leg, build_starting_covariance, run_legs
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.predict import predict
from gyrocal.estimation.smoother import smooth
from gyrocal.recording import Recording
from gyrocal.sensors.alignment import AlignmentResult, align_in_two_steps, align_together
from simulator.scenario import Scenario
from simulator.simulate import compute_true_gyros, observe
from studies.calibration.shared_truth import get_true_parameters, require_converged
from studies.estimation.filter_cases import FILTER_CASE_ORBIT
from studies.estimation.flights import DirectionSensor, Flight, compute_nadir
from studies.montecarlo.statistics import compute_nees
from studies.montecarlo.study import Streams
from studies.validation.promises.plans import (
    MOUNTING_SIGMA_DEG,
    References,
    build_graded_scenario,
    build_plan_flight,
    select_plan_and_grade,
    simulate_plan_motion,
)

Array = NDArray[np.float64]
Row = dict[str, object]

PARAMETER_PRIOR_SIGMA = np.repeat([1e-3, np.deg2rad(2e-4)], [9, 3])  # 1-sigma of G, and of b in rad/s
SUN_DIRECTION = np.array([0.36, -0.8, 0.48])
ALIGNED = ("m_x", "m_y", "m_z")
ESTIMATOR_START_SIGMA = np.repeat([np.deg2rad(0.3), np.deg2rad(1e-3)], 3)  # of attitude and bias
OFF_DEG = 0.1  # of a sensor that is to be aligned
MEASURED_EVERY_S = 10.0  # or longer, at the edge of a sample
TOLERANCE_S = 1e-6


def build_covariance_row(promise: str, error: Array, P: Array) -> Row:
    """The row of an error (n,) with its covariance (n, n)."""
    return build_chi2_row(promise, float(compute_nees(error[None], P[None])[0]), len(error))


def build_chi2_row(promise: str, value: float, dof: int) -> Row:
    """The row of a χ²; level and inside would be those of an interval, and no promise is one."""
    return {"promise": promise, "dof": dof, "nees": value, "level": None, "inside": None}


def collect_statements(number: int, streams: Streams) -> list[Row]:
    """Collect the statements of all estimators but the diagnosis in one case."""
    plan, grade = select_plan_and_grade(number)
    made = [
        *check_calibrations(plan, grade, streams),
        *check_several_instruments(plan, grade, streams),
        *check_estimators(
            build_plan_flight(plan, grade), np.deg2rad(build_graded_scenario(plan, grade).reference.sigma_deg[0]), streams
        ),
    ]
    return [{"plan": plan, "grade": grade, **row} for row in made]


def record_plan(own: Scenario, at: tuple[str, str], references: References, streams: Streams, name: str) -> Recording:
    """A recording of a plan and grade with noise of its own."""
    plan, grade = at
    gyro, reference = (streams.generator(f"{name}: {what}") for what in ("gyro", "reference"))
    return observe(own, simulate_plan_motion(plan, grade, references), gyro_rng=gyro, reference_rng=reference)


# ---- calibrator ----------------------------------------------------------------------------------------------------------


def check_calibrations(plan: str, grade: str, streams: Streams) -> Iterator[Row]:
    """Twelve parameters without and with a prior, in both parametrisations, by series and by the ends of intervals alone."""
    for references in ("series", "ends"):
        own = build_graded_scenario(plan, grade, references)
        seen, truth = record_plan(own, (plan, grade), references, streams, f"calibrate {references}"), get_true_parameters(own)
        near = GyroParameters.from_vector(truth.vector + PARAMETER_PRIOR_SIGMA * streams.generator("prior").standard_normal(12))
        found = require_converged(calibrate(seen, initial=near, apriori_covariance=np.diag(PARAMETER_PRIOR_SIGMA**2)))
        yield build_covariance_row(
            f"calibrate, {references}, with prior", found.parameters.vector - truth.vector, found.covariance
        )
        if references == "ends":  # without a prior the coarse grades leave some of it free, and say so
            continue
        found = require_converged(calibrate(seen))
        yield build_covariance_row("calibrate, series", found.parameters.vector - truth.vector, found.covariance)
        own_space = require_converged(calibrate(seen, parametrisation="gyro"))
        yield build_covariance_row("calibrate, gyro by gyro", own_space.parameters.vector - truth.vector, own_space.covariance)
        bare = require_converged(calibrate(seen, covariance_model="references only"))
        yield build_covariance_row("calibrate, N's covariance", bare.parameters.vector - truth.vector, bare.covariance)
        yield from check_prediction(seen, near, truth, (plan, grade))


def check_prediction(seen: Recording, near: GyroParameters, truth: GyroParameters, at_cell: tuple[str, str]) -> Iterator[Row]:
    """The attitude carried on over the last third of an interval, and G and b as the references before leave them."""
    from_s, at = _find_prediction_span(seen)
    known = replace(seen, gyro=replace(seen.gyro, apriori_G=near.G, apriori_bias=near.bias))
    found = predict(known, from_s, np.array([at]), np.diag(PARAMETER_PRIOR_SIGMA**2))
    true = simulate_plan_motion(*at_cell, "series")
    A = attitude.matrix_from_quaternion(true.quaternions[np.searchsorted(true.reference_t_s, [at - TOLERANCE_S])])
    yield build_covariance_row("predict: attitude", _compute_attitude_error(A, found.A), found.covariance[0])
    yield build_covariance_row("predict: G and b", found.parameters.vector - truth.vector, found.parameter_covariance)


def _find_prediction_span(seen: Recording) -> tuple[float, float]:
    """From when to predict, and the last reference time, in the last interval with three references before its last third."""
    t_s = seen.attitudes.t_s
    for one in reversed(seen.intervals):
        from_s = one.stop_s - (one.stop_s - one.start_s) / 3
        before = (t_s >= one.start_s - TOLERANCE_S) & (t_s <= from_s)
        after = t_s[(t_s > from_s) & (t_s <= one.stop_s + TOLERANCE_S)]
        if before.sum() >= 3 and after.size:
            return from_s, float(after[-1])
    raise InputError("no interval has three references before its last third")


def check_several_instruments(plan: str, grade: str, streams: Streams) -> Iterator[Row]:
    """Two star trackers, the second mounted as nobody knows, or knows to a sigma; and four gyros."""
    base = build_graded_scenario(plan, grade, "trackers")
    for prior in (None, (MOUNTING_SIGMA_DEG,) * 3):
        turn = MOUNTING_SIGMA_DEG * streams.generator("mounting").standard_normal(3)
        second = base.reference.tracker[1].model_copy(
            update={"misalignment_deg": tuple(turn.tolist()), "mounting_sigma_deg": prior}
        )
        reference = base.reference.model_copy(update={"tracker": (base.reference.tracker[0], second)})
        own = base.model_copy(update={"reference": reference})
        found = require_converged(calibrate(record_plan(own, (plan, grade), "trackers", streams, "trackers")))
        name = "trackers, mounting estimated" if prior is None else "trackers, mounting with its prior"
        yield build_covariance_row(
            f"{name}: G and b", found.parameters.vector - get_true_parameters(own).vector, found.covariance
        )
        assert found.mountings is not None
        yield build_covariance_row(
            f"{name}: mounting", found.mountings.misalignment - np.deg2rad(turn), found.mountings.covariance
        )
    own = build_graded_scenario(plan, grade, "series", array=True)
    four = calibrate_gyros(record_plan(own, (plan, grade), "series", streams, "gyros"))
    K, c = compute_true_gyros(own)
    yield build_covariance_row("calibrate_gyros, four", four.gyros.vector - np.column_stack([K, c]).ravel(), four.covariance)


# ---- estimators of attitude and alignment --------------------------------------------------------------------------------


def check_estimators(own: Flight, sigma: float, streams: Streams) -> Iterator[Row]:
    """Batches, filter, smoother and full filter on one interval; alignments of a second sensor."""
    rng = streams.generator("estimators")
    t = own.t[:: int(np.ceil(MEASURED_EVERY_S / (own.t[1] - own.t[0])))]
    seen = (np.tile(SUN_DIRECTION, (t.size, 1)), compute_nadir(t, FILTER_CASE_ORBIT))
    series = DirectionSensor(seen).simulate_series(own, t, sigma, rng)
    off = ESTIMATOR_START_SIGMA * rng.standard_normal(6)
    start = GyroParameters(own.truth.G, own.truth.bias + off[3:])
    gyro, A0 = own.gyro(rng, start), attitude.rotation_matrix(-off[:3]) @ own.A[0]
    times = own.t[[0, len(own.t) // 2, -1]]
    truth = own.get_attitudes(times)
    for weighting in ("exact", "plain"):
        found = batch([series], gyro, A0, epoch_s=0.0, times=times, weighting=weighting)
        name = f"batch, {weighting} weights"
        yield build_covariance_row(
            f"{name}: attitudes", _compute_attitude_error(truth, found.attitudes), found.attitude_covariance
        )
        yield build_covariance_row(f"{name}: bias", found.bias - own.truth.bias, found.covariance[3:6, 3:6])
    estimator = KalmanFilter(A0, start, np.diag(ESTIMATOR_START_SIGMA**2), own.arw)
    filtered = run(estimator, gyro, [series], 0.0, times, keep_history=True)
    end = np.concatenate([_compute_attitude_error(truth[-1:], filtered.A[-1:]), estimator.x[9:] - own.truth.bias])
    yield build_covariance_row("filter: attitude and bias", end, estimator.P)
    smoothed = smooth(filtered)
    yield build_covariance_row("smoother: attitudes", _compute_attitude_error(truth, smoothed.A), smoothed.attitude_covariance)
    near = GyroParameters.from_vector(own.truth.vector + PARAMETER_PRIOR_SIGMA * rng.standard_normal(12))
    whole = KalmanFilter(
        A0,
        near,
        build_starting_covariance(float(ESTIMATOR_START_SIGMA[0]), np.diag(PARAMETER_PRIOR_SIGMA**2)),
        own.arw,
        names="all",
    )
    full = run_legs(whole, own.gyro(rng, near), [series], [Leg("all", 0.0, float(own.t[-1]))])
    yield build_covariance_row("full filter: G and b", full.parameters.vector - own.truth.vector, full.covariance)
    yield from check_alignments(own, t, seen, sigma, A0, rng)


def check_alignments(
    own: Flight, t: Array, seen: tuple[Array, ...], sigma: float, A0: Array, rng: np.random.Generator
) -> Iterator[Row]:
    """The misalignment of a second sensor, by both of R's algorithms, from directions seen at times t."""
    M = attitude.rotation_matrix(np.deg2rad(OFF_DEG) * rng.standard_normal(3))
    held = DirectionSensor(seen, "held").simulate_series(own, t, sigma, rng)
    free = DirectionSensor(seen, "free", M, parameters=ALIGNED).simulate_series(own, t, sigma, rng)
    series = [held, replace(free, model=DirectionSensor(seen, "free", parameters=ALIGNED))]
    gyro = own.gyro(rng)
    found: dict[str, AlignmentResult] = {
        "together, exact weights": align_together(series, gyro, A0, "held", weighting="exact"),
        "together, plain weights": align_together(series, gyro, A0, "held"),
        "two steps, repeated": align_in_two_steps(series, gyro, A0, "held", rounds=None),
    }
    for name, one in found.items():
        model = one.models[1]
        assert isinstance(model, DirectionSensor)
        yield build_covariance_row(f"alignment, {name}", attitude.residual(M[None], model.M[None])[0], one.covariance)


def _compute_attitude_error(truth: Array, A: Array) -> Array:
    return np.asarray(attitude.residual(truth, A).ravel())
