"""What the study of references runs: attitudes, calibrations and full filter. `studies.estimation.references` says why."""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from gyrocal import GyroParameters, attitude, calibrate
from gyrocal.estimation.batch import batch
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.full_filter import FullFilterResult
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.reference_covariance import interval_covariance, residual_covariance
from gyrocal.estimation.smoother import smooth
from studies.calibration.prepared import converged
from studies.estimation.filter_cases import (
    Z,
    fly,
    full_and_separate,
    independent_covariance,
    judge_parameters,
    on_board_case,
    solved_with,
    vectors,
)
from studies.estimation.flights import Flight
from studies.estimation.reference_cases import ReferenceCase, apart, chain
from studies.montecarlo.statistics import nees
from studies.montecarlo.study import Streams

Array = NDArray[np.float64]
Rows = list[dict[str, object]]

TIMES = (100.0, 900.0, 1500.0)  # s
TOGETHER = "all times"
WIDE = np.repeat([0.01, 1e-5], 3)  # rad, rad/s: what filter and batch start from; the data leave a hundredth of it
CHAIN_QUIET = 0.2  # of the scenario's angle random walk; at all of it, gyro noise hides what the intervals share

EXACT, PLAIN, FORMAL, FILTER, SMOOTHER = "batch, exact", "batch, plain", "batch, plain, formal", "filter", "smoother"
WHOLE, BLOCKS, CARRIED, INDEPENDENT = "one V", "C of each interval", "C carried along", "independent"
FULL, STATED, UNSTATED = "full filter", "separate, error stated", "separate"
RIGHT, WRONG = "as modelled", "misaligned by"


@lru_cache(maxsize=1)
def _short_flight() -> Flight:
    return fly([(Z, 90.0, 400.0, 500.0)], 1500.0)


def attitudes(streams: Streams, truth: GyroParameters, arw: float) -> Rows:
    """A row for each estimator and time, and one for all times together where the estimator says what they share."""
    flight = replace(_short_flight(), truth=truth, arw=arw)
    rng = streams.generator("attitudes")
    off = rng.standard_normal(6) * np.repeat([1e-3, 1e-6], 3)
    start = GyroParameters(truth.G, truth.bias + off[3:])
    gyro, series = flight.gyro(rng, start), vectors(flight, rng)
    A0 = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    through = partial(batch, [series], gyro, A0, epoch_s=0.0, times=TIMES)
    exact, plain = through(), through(weighting="plain")
    formal = through(weighting="plain", covariance_model="measurements only")
    filtered = run(KalmanFilter(A0, start, np.diag(WIDE**2), arw), gyro, [series], 0.0, np.array(TIMES), keep_history=True)
    smoothed = smooth(filtered)
    found: dict[str, tuple[Array, Array]] = {
        EXACT: (exact.attitudes, exact.attitude_covariance),
        PLAIN: (plain.attitudes, plain.attitude_covariance),
        FORMAL: (formal.attitudes, formal.attitude_covariance),
        FILTER: (filtered.A, block_diag(*filtered.covariance[:, :3, :3])),
        SMOOTHER: (smoothed.A, smoothed.attitude_covariance),
    }
    ways = {SMOOTHER: smoothed.A, PLAIN: plain.attitudes, FILTER: filtered.A}
    apart_sigma = {way: np.abs(attitude.residual(exact.attitudes, A) / exact.attitude_sigma) for way, A in ways.items()}
    rows: Rows = []
    for estimator, (A, P) in found.items():
        error = attitude.residual(flight.at(TIMES), A)
        for k, time in enumerate(TIMES):
            own = P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            sigma = np.sqrt(np.diag(own))
            rows.append(
                {
                    "part": "attitudes",
                    "estimator": estimator,
                    "setup": f"{time:g} s",
                    "dof": 3,
                    "nees": float(nees(error[[k]], own[None])[0]),
                    "within_1": int(np.sum(np.abs(error[k]) <= sigma)),
                    "within_2": int(np.sum(np.abs(error[k]) <= 2 * sigma)),
                    "apart_sigma": float(apart_sigma[estimator][k].max()) if estimator in apart_sigma else None,
                    "error_mdeg": 1e3 * float(np.rad2deg(np.sqrt(np.mean(error[k] ** 2)))),
                    "sigma_mdeg": 1e3 * float(np.rad2deg(np.sqrt(np.mean(sigma**2)))),
                }
            )
        if estimator in (EXACT, PLAIN, SMOOTHER):  # a filter does not say what its estimates share; the formal P is singular
            together = {"part": "attitudes", "estimator": estimator, "setup": TOGETHER, "dof": 9}
            rows.append(together | {"nees": float(nees(error.reshape(1, -1), P[None])[0])})
    return rows


@lru_cache(maxsize=2)
def _setups(truth: tuple[float, ...], arw: float) -> tuple[ReferenceCase, ...]:
    parameters = GyroParameters.from_vector(np.array(truth))
    return apart(parameters, arw), chain(parameters, CHAIN_QUIET * arw)


def calibrations(streams: Streams, truth: GyroParameters, arw: float) -> Rows:
    """A row for each flight, source of its references and treatment of what they share."""
    rows: Rows = []
    for setup in _setups(tuple(truth.vector.tolist()), arw):
        for source, weighting in ((EXACT, "exact"), (PLAIN, "plain")):
            recording, batches = setup.draw(streams.generator(setup.name), "exact" if weighting == "exact" else "plain")
            results = {
                WHOLE: calibrate(recording, residual_covariance=residual_covariance(batches, setup.intervals, setup.arw)),
                BLOCKS: calibrate(recording, interval_covariance=interval_covariance(batches, setup.intervals, setup.arw)),
                INDEPENDENT: calibrate(recording),
            }
            for name, result in results.items():
                rows.append(_row(setup.name, source, name, converged(result).parameters.vector, result.covariance, truth))
    one = on_board_case(streams.generator("timeline"), truth=truth, arw=arw)
    found, P = one.onboard.solve()
    rows.append(_row("timeline", FILTER, CARRIED, found.vector, P, truth))
    naive = [independent_covariance(maneuver, arw) for maneuver in one.maneuvers]
    rows.append(_row("timeline", FILTER, INDEPENDENT, *solved_with(one.apriori, one.maneuvers, naive), truth))
    return rows


def _row(setup: str, source: str, treatment: str, x: Array, P: Array, truth: GyroParameters) -> dict[str, object]:
    error = x - truth.vector
    keys = {"part": "calibration", "setup": setup, "estimator": source, "treatment": treatment, "dof": 12}
    return keys | judge_parameters(error, P) | {"nees_bias": float(nees(error[None, 9:], P[None, 9:, 9:])[0])}


def full_filter(streams: Streams, truth: GyroParameters, arw: float, misalignments_deg: tuple[float, ...]) -> Rows:
    """A row for each misalignment of the Sun sensor, none first, and scheme."""
    rows: Rows = []
    for size_deg in (0.0, *misalignments_deg):
        size = float(np.deg2rad(size_deg))
        full, separate = full_and_separate(streams.generator("full filter"), size, (0.0, size), truth, arw)
        solutions = {FULL: (full.parameters, full.covariance), UNSTATED: separate[0]}
        if size_deg:
            solutions[STATED] = separate[1]
        for scheme, (parameters, P) in solutions.items():
            row: dict[str, object] = {"part": "full filter", "setup": f"{WRONG} {size_deg:g} deg" if size_deg else RIGHT}
            row |= {"misaligned_deg": size_deg, "estimator": scheme, "dof": 12}
            row |= judge_parameters(parameters.vector - truth.vector, P)
            rows.append(row | (_own_checks(full) if scheme == FULL else {}))
    return rows


def _own_checks(full: FullFilterResult) -> dict[str, object]:
    """What the full filter can see for itself."""
    chi2, dof = (sum(getattr(one, name) for one in full.changes) for name in ("chi2", "dof"))
    return {"innovations_per_dof": full.mean_nis, "changes_per_dof": chi2 / dof}
