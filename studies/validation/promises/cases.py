"""One case of the study of promises: a plan and a grade of noise, flown once, and what each estimator states of it.

A row is a statement about a truth that is known: a covariance P with the error e it is of, whose NEES eᵀP⁻¹e is χ² with
its degrees of freedom if P is right. All errors of one row are judged together, so that the rows of a promise are independent
from case to case.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.linearise import linearised
from diagnosis.model.unit import joined
from diagnosis.next_recording import compared
from gyrocal import GyroParameters, InputError, attitude, calibrate, calibrate_gyros
from gyrocal.estimation.batch import batch
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.full_filter import Leg, run_legs, starting_covariance
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.predict import predict
from gyrocal.estimation.smoother import smooth
from gyrocal.recording import Recording
from gyrocal.sensors.alignment import AlignmentResult, in_two_steps, together
from simulator.scenario import Scenario
from simulator.simulate import observe, true_gyros
from studies.calibration.prepared import converged, true_parameters
from studies.estimation.filter_cases import ORBIT
from studies.estimation.flights import DirectionSensor, Flight, nadir
from studies.montecarlo.statistics import nees
from studies.montecarlo.study import Streams
from studies.validation.promises.plans import MOUNTING_SIGMA_DEG, References, cell, flight, path, scenario

Array = NDArray[np.float64]
Row = dict[str, object]

PRIOR = np.repeat([1e-3, np.deg2rad(2e-4)], [9, 3])  # 1-sigma of G, and of b in rad/s
SUN = np.array([0.36, -0.8, 0.48])
ALIGNED = ("m_x", "m_y", "m_z")
START = np.repeat([np.deg2rad(0.3), np.deg2rad(1e-3)], 3)  # of attitude and bias
OFF_DEG = 0.1  # of a sensor that is to be aligned
MEASURED_EVERY_S = 10.0  # or longer, at the edge of a sample
TOLERANCE_S = 1e-6


def covariance(promise: str, error: Array, P: Array) -> Row:
    """The row of an error (n,) with its covariance (n, n)."""
    return of_chi2(promise, float(nees(error[None], P[None])[0]), len(error))


def of_chi2(promise: str, value: float, dof: int) -> Row:
    """The row of a χ²; level and inside would be those of an interval, and no promise is one."""
    return {"promise": promise, "dof": dof, "nees": value, "level": None, "inside": None}


def rows(number: int, streams: Streams) -> list[Row]:
    """What all estimators but the diagnosis state in one case."""
    plan, grade = cell(number)
    made = [
        *calibrations(plan, grade, streams),
        *several(plan, grade, streams),
        *estimators(flight(plan, grade), np.deg2rad(scenario(plan, grade).reference.sigma_deg[0]), streams),
        *following(plan, grade, streams),
    ]
    return [{"plan": plan, "grade": grade, **row} for row in made]


def recorded(own: Scenario, at: tuple[str, str], references: References, streams: Streams, name: str) -> Recording:
    """A recording of a plan and grade with noise of its own."""
    plan, grade = at
    gyro, reference = (streams.generator(f"{name}: {what}") for what in ("gyro", "reference"))
    return observe(own, path(plan, grade, references), gyro_rng=gyro, reference_rng=reference)


# ---- calibrator ----------------------------------------------------------------------------------------------------------


def calibrations(plan: str, grade: str, streams: Streams) -> Iterator[Row]:
    """Twelve parameters without and with a prior, in both parametrisations, by series and by the ends of intervals alone."""
    for references in ("series", "ends"):
        own = scenario(plan, grade, references)
        seen, truth = recorded(own, (plan, grade), references, streams, f"calibrate {references}"), true_parameters(own)
        near = GyroParameters.from_vector(truth.vector + PRIOR * streams.generator("prior").standard_normal(12))
        found = converged(calibrate(seen, initial=near, apriori_covariance=np.diag(PRIOR**2)))
        yield covariance(f"calibrate, {references}, with prior", found.parameters.vector - truth.vector, found.covariance)
        if references == "ends":  # without a prior the coarse grades leave some of it free, and say so
            continue
        found = converged(calibrate(seen))
        yield covariance("calibrate, series", found.parameters.vector - truth.vector, found.covariance)
        own_space = converged(calibrate(seen, parametrisation="gyro"))
        yield covariance("calibrate, gyro by gyro", own_space.parameters.vector - truth.vector, own_space.covariance)
        bare = converged(calibrate(seen, covariance_model="references only"))
        yield covariance("calibrate, N's covariance", bare.parameters.vector - truth.vector, bare.covariance)
        yield from predicted(seen, near, truth, (plan, grade))


def predicted(seen: Recording, near: GyroParameters, truth: GyroParameters, at_cell: tuple[str, str]) -> Iterator[Row]:
    """The attitude carried on over the last third of an interval, and G and b as the references before leave them."""
    from_s, at = _stretch(seen)
    known = replace(seen, gyro=replace(seen.gyro, apriori_G=near.G, apriori_bias=near.bias))
    found = predict(known, from_s, np.array([at]), np.diag(PRIOR**2))
    true = path(*at_cell, "series")
    A = attitude.matrix_from_quaternion(true.quaternions[np.searchsorted(true.reference_t_s, [at - TOLERANCE_S])])
    yield covariance("predict: attitude", _apart(A, found.A), found.covariance[0])
    yield covariance("predict: G and b", found.parameters.vector - truth.vector, found.parameter_covariance)


def _stretch(seen: Recording) -> tuple[float, float]:
    """From when to predict, and the last reference time, in the last interval with three references before its last third."""
    t_s = seen.attitudes.t_s
    for one in reversed(seen.intervals):
        from_s = one.stop_s - (one.stop_s - one.start_s) / 3
        before = (t_s >= one.start_s - TOLERANCE_S) & (t_s <= from_s)
        after = t_s[(t_s > from_s) & (t_s <= one.stop_s + TOLERANCE_S)]
        if before.sum() >= 3 and after.size:
            return from_s, float(after[-1])
    raise InputError("no interval has three references before its last third")


def several(plan: str, grade: str, streams: Streams) -> Iterator[Row]:
    """Two star trackers, the second mounted as nobody knows, or knows to a sigma; and four gyros."""
    base = scenario(plan, grade, "trackers")
    for prior in (None, (MOUNTING_SIGMA_DEG,) * 3):
        turn = MOUNTING_SIGMA_DEG * streams.generator("mounting").standard_normal(3)
        second = base.reference.tracker[1].model_copy(
            update={"misalignment_deg": tuple(turn.tolist()), "mounting_sigma_deg": prior}
        )
        reference = base.reference.model_copy(update={"tracker": (base.reference.tracker[0], second)})
        own = base.model_copy(update={"reference": reference})
        found = converged(calibrate(recorded(own, (plan, grade), "trackers", streams, "trackers")))
        name = "trackers, mounting estimated" if prior is None else "trackers, mounting with its prior"
        yield covariance(f"{name}: G and b", found.parameters.vector - true_parameters(own).vector, found.covariance)
        assert found.mountings is not None
        yield covariance(f"{name}: mounting", found.mountings.misalignment - np.deg2rad(turn), found.mountings.covariance)
    own = scenario(plan, grade, "series", array=True)
    four = calibrate_gyros(recorded(own, (plan, grade), "series", streams, "gyros"))
    K, c = true_gyros(own)
    yield covariance("calibrate_gyros, four", four.gyros.vector - np.column_stack([K, c]).ravel(), four.covariance)


# ---- estimators of attitude and alignment --------------------------------------------------------------------------------


def estimators(own: Flight, sigma: float, streams: Streams) -> Iterator[Row]:
    """Batches, filter, smoother and full filter on one interval; alignments of a second sensor."""
    rng = streams.generator("estimators")
    t = own.t[:: int(np.ceil(MEASURED_EVERY_S / (own.t[1] - own.t[0])))]
    seen = (np.tile(SUN, (t.size, 1)), nadir(t, ORBIT))
    series = DirectionSensor(seen).seen(own, t, sigma, rng)
    off = START * rng.standard_normal(6)
    start = GyroParameters(own.truth.G, own.truth.bias + off[3:])
    gyro, A0 = own.gyro(rng, start), attitude.rotation_matrix(-off[:3]) @ own.A[0]
    times = own.t[[0, len(own.t) // 2, -1]]
    truth = own.at(times)
    for weighting in ("exact", "plain"):
        found = batch([series], gyro, A0, epoch_s=0.0, times=times, weighting=weighting)
        name = f"batch, {weighting} weights"
        yield covariance(f"{name}: attitudes", _apart(truth, found.attitudes), found.attitude_covariance)
        yield covariance(f"{name}: bias", found.bias - own.truth.bias, found.covariance[3:6, 3:6])
    estimator = KalmanFilter(A0, start, np.diag(START**2), own.arw)
    filtered = run(estimator, gyro, [series], 0.0, times, keep_history=True)
    end = np.concatenate([_apart(truth[-1:], filtered.A[-1:]), estimator.x[9:] - own.truth.bias])
    yield covariance("filter: attitude and bias", end, estimator.P)
    smoothed = smooth(filtered)
    yield covariance("smoother: attitudes", _apart(truth, smoothed.A), smoothed.attitude_covariance)
    near = GyroParameters.from_vector(own.truth.vector + PRIOR * rng.standard_normal(12))
    whole = KalmanFilter(A0, near, starting_covariance(float(START[0]), np.diag(PRIOR**2)), own.arw, names="all")
    full = run_legs(whole, own.gyro(rng, near), [series], [Leg("all", 0.0, float(own.t[-1]))])
    yield covariance("full filter: G and b", full.parameters.vector - own.truth.vector, full.covariance)
    yield from alignments(own, t, seen, sigma, A0, rng)


def alignments(
    own: Flight, t: Array, seen: tuple[Array, ...], sigma: float, A0: Array, rng: np.random.Generator
) -> Iterator[Row]:
    """The misalignment of a second sensor, by both of R's algorithms, from directions seen at times t."""
    M = attitude.rotation_matrix(np.deg2rad(OFF_DEG) * rng.standard_normal(3))
    held = DirectionSensor(seen, "held").seen(own, t, sigma, rng)
    free = DirectionSensor(seen, "free", M, parameters=ALIGNED).seen(own, t, sigma, rng)
    series = [held, replace(free, model=DirectionSensor(seen, "free", parameters=ALIGNED))]
    gyro = own.gyro(rng)
    found: dict[str, AlignmentResult] = {
        "together, exact weights": together(series, gyro, A0, "held", weighting="exact"),
        "together, plain weights": together(series, gyro, A0, "held"),
        "two steps, repeated": in_two_steps(series, gyro, A0, "held", rounds=None),
    }
    for name, one in found.items():
        model = one.models[1]
        assert isinstance(model, DirectionSensor)
        yield covariance(f"alignment, {name}", attitude.residual(M[None], model.M[None])[0], one.covariance)


def _apart(truth: Array, A: Array) -> Array:
    return np.asarray(attitude.residual(truth, A).ravel())


# ---- the next recording --------------------------------------------------------------------------------------------------


def following(plan: str, grade: str, streams: Streams) -> Iterator[Row]:
    """The residuals of a second recording as the first predicts them."""
    own = scenario(plan, grade)
    pair = {name: recorded(own, (plan, grade), "series", streams, f"next {name}") for name in ("first", "second")}
    unit = joined(pair)
    before = calibrate(pair["first"])
    found = compared(linearised(unit.recording, before.G, before.bias), unit.owner, "second", [])
    yield of_chi2("next: residuals of the next recording", found.chi2, found.dof)
