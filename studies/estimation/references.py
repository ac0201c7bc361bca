"""Reference attitudes from a batch, a filter and a smoother: are they and the calibration fed with them consistent?

Three parts, the third, which takes three quarters of the time, in every so many cases only.

**Attitudes.** 25 minutes with a slew of 90°, the Sun and nadir measured every 10 s. The same data through a batch (exact and
plain weights), a Kalman filter and its smoother; the attitude at three times, each by itself and together. Exact batch and
smoother must be one answer, and at the last time the filter too. The control is the plain batch's formal covariance, which
knows no gyro noise.

**Calibration.** Two flights of `studies.estimation.reference_cases`, "apart" and "chain", with batch references of plain and
of exact weights, and the timeline of `studies.estimation.filter_cases` with a filter's. Each is calibrated with what the
references share taken into account, as one covariance V of all residuals or as a C for each interval, and with references
taken for independent, the control. A smoother's references are those of the exact batch.

**Full filter.** The filter of all twelve parameters beside the separate scheme (filter for attitude and bias, calibrator beside
it), on one pass of that timeline: with sensors that are as modelled, and with a Sun sensor misaligned by a part of a
measurement's noise (0.05° a component) that nobody knows of. The separate scheme is then solved with and without such an error
stated for each reference; the full filter has nowhere to state it.

Of the scenario only the gyro's true parameters and angle random walk are used.
"""

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pandas as pd
import scipy.special
from numpy.typing import NDArray
from pydantic import Field, field_validator
from scipy.linalg import block_diag

from gyrocal import GyroParameters, attitude, calibrate
from gyrocal.estimation.batch import batch
from gyrocal.estimation.filter_run import run
from gyrocal.estimation.full_filter import FullFilterResult
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.reference_covariance import interval_covariance, residual_covariance
from gyrocal.estimation.smoother import smooth
from studies.calibration.shared_truth import compute_rms, get_true_parameters, require_converged
from studies.estimation.filter_cases import (
    DIRECTION_SENSOR_SIGMA,
    Z,
    compute_column_rms,
    compute_independent_covariance,
    fly,
    judge_parameters,
    run_full_and_separate,
    run_onboard_case,
    simulate_direction_series,
    solve_with_covariances,
)
from studies.estimation.flights import FixedFlightConfig, Flight
from studies.estimation.reference_cases import ReferenceCase, build_chain_case, build_separate_case
from studies.montecarlo.statistics import build_nees_row, compute_nees
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report import panels
from studies.report.checks import Check, bound_above, check_case_count, check_nees_rows, format_expectation
from studies.report.entry import Entry, Report
from studies.report.tables import Table, summarise_groups

Array = NDArray[np.float64]
Rows = list[dict[str, object]]

COMPARED_TIMES_S = (100.0, 900.0, 1500.0)  # s
TOGETHER = "all times"
WIDE = np.repeat([0.01, 1e-5], 3)  # rad, rad/s: what filter and batch start from; the data leave a hundredth of it
CHAIN_QUIET = 0.2  # of the scenario's angle random walk; at all of it, gyro noise hides what the intervals share

EXACT, PLAIN, FORMAL, FILTER, SMOOTHER = "batch, exact", "batch, plain", "batch, plain, formal", "filter", "smoother"
WHOLE, BLOCKS, CARRIED, INDEPENDENT = "one V", "C of each interval", "C carried along", "independent"
FULL, STATED, UNSTATED = "full filter", "separate, error stated", "separate"
RIGHT, WRONG = "as modelled", "misaligned by"
TELLING = 0.2  # of a measurement's noise: a misalignment that must show
# Filter and smoother start from a covariance a hundred times as wide as the data leave it, which counts 1e-4; at five of its
# 1e-3 rad the start is 50 sigma off.
ONE_ANSWER = 5e-3  # sigma


class ReferencesConfig(FixedFlightConfig):
    """What the study runs; flights and sensors are fixed.

    Attributes
    ----------
    full_filter_every : the full filter runs in each case that this divides
    misalignments_deg : 1-sigma about each axis of what nobody knows of the Sun sensor, one after the other
    """

    cases: int = 200
    full_filter_every: int = Field(default=4, ge=1)
    misalignments_deg: tuple[float, ...] = (0.01, 0.04)

    @field_validator("misalignments_deg")
    @classmethod
    def _check_misalignments(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        if not value or not 0 < min(value) <= max(value) < 1 or list(value) != sorted(set(value)):
            raise ValueError("must be one or more numbers between 0 and 1, ascending")
        return value


@lru_cache(maxsize=1)
def _simulate_short_flight() -> Flight:
    return fly([(Z, 90.0, 400.0, 500.0)], 1500.0)


def estimate_attitudes(streams: Streams, truth: GyroParameters, arw: float) -> Rows:
    """A row for each estimator and time, and one for all times together where the estimator says what they share."""
    flight = replace(_simulate_short_flight(), truth=truth, arw=arw)
    rng = streams.generator("attitudes")
    off = rng.standard_normal(6) * np.repeat([1e-3, 1e-6], 3)
    start = GyroParameters(truth.G, truth.bias + off[3:])
    gyro, series = flight.gyro(rng, start), simulate_direction_series(flight, rng)
    A0 = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    through = partial(batch, [series], gyro, A0, epoch_s=0.0, times=COMPARED_TIMES_S)
    exact, plain = through(), through(weighting="plain")
    formal = through(weighting="plain", covariance_model="measurements only")
    filtered = run(
        KalmanFilter(A0, start, np.diag(WIDE**2), arw), gyro, [series], 0.0, np.array(COMPARED_TIMES_S), keep_history=True
    )
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
        error = attitude.residual(flight.get_attitudes(COMPARED_TIMES_S), A)
        for k, time in enumerate(COMPARED_TIMES_S):
            own = P[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
            sigma = np.sqrt(np.diag(own))
            rows.append(
                {
                    "part": "attitudes",
                    "estimator": estimator,
                    "setup": f"{time:g} s",
                    "dof": 3,
                    "nees": float(compute_nees(error[[k]], own[None])[0]),
                    "within_1": int(np.sum(np.abs(error[k]) <= sigma)),
                    "within_2": int(np.sum(np.abs(error[k]) <= 2 * sigma)),
                    "apart_sigma": float(apart_sigma[estimator][k].max()) if estimator in apart_sigma else None,
                    "error_mdeg": 1e3 * float(np.rad2deg(compute_rms(error[k]))),
                    "sigma_mdeg": 1e3 * float(np.rad2deg(compute_rms(sigma))),
                }
            )
        if estimator in (EXACT, PLAIN, SMOOTHER):  # a filter does not say what its estimates share; the formal P is singular
            together = {"part": "attitudes", "estimator": estimator, "setup": TOGETHER, "dof": 9}
            rows.append(together | {"nees": float(compute_nees(error.reshape(1, -1), P[None])[0])})
    return rows


@lru_cache(maxsize=2)
def _build_setups(truth: tuple[float, ...], arw: float) -> tuple[ReferenceCase, ...]:
    parameters = GyroParameters.from_vector(np.array(truth))
    return build_separate_case(parameters, arw), build_chain_case(parameters, CHAIN_QUIET * arw)


def run_calibrations(streams: Streams, truth: GyroParameters, arw: float) -> Rows:
    """A row for each flight, source of its references and treatment of what they share."""
    rows: Rows = []
    for setup in _build_setups(tuple(truth.vector.tolist()), arw):
        for source, weighting in ((EXACT, "exact"), (PLAIN, "plain")):
            recording, batches = setup.draw(streams.generator(setup.name), "exact" if weighting == "exact" else "plain")
            results = {
                WHOLE: calibrate(recording, residual_covariance=residual_covariance(batches, setup.intervals, setup.arw)),
                BLOCKS: calibrate(recording, interval_covariance=interval_covariance(batches, setup.intervals, setup.arw)),
                INDEPENDENT: calibrate(recording),
            }
            for name, result in results.items():
                rows.append(
                    _build_row(setup.name, source, name, require_converged(result).parameters.vector, result.covariance, truth)
                )
    one = run_onboard_case(streams.generator("timeline"), truth=truth, arw=arw)
    found, P = one.onboard.solve()
    rows.append(_build_row("timeline", FILTER, CARRIED, found.vector, P, truth))
    naive = [compute_independent_covariance(maneuver, arw) for maneuver in one.maneuvers]
    rows.append(_build_row("timeline", FILTER, INDEPENDENT, *solve_with_covariances(one.apriori, one.maneuvers, naive), truth))
    return rows


def _build_row(setup: str, source: str, treatment: str, x: Array, P: Array, truth: GyroParameters) -> dict[str, object]:
    error = x - truth.vector
    keys = {"part": "calibration", "setup": setup, "estimator": source, "treatment": treatment, "dof": 12}
    judged, of_bias = judge_parameters(error, P), float(compute_nees(error[None, 9:], P[None, 9:, 9:])[0])
    return {**keys, "nees": judged.pop("nees"), "nees_bias": of_bias, **judged}


def compare_full_filter(streams: Streams, truth: GyroParameters, arw: float, misalignments_deg: tuple[float, ...]) -> Rows:
    """A row for each misalignment of the Sun sensor, none first, and scheme."""
    rows: Rows = []
    for size_deg in (0.0, *misalignments_deg):
        size = float(np.deg2rad(size_deg))
        full, separate = run_full_and_separate(streams.generator("full filter"), size, (0.0, size), truth, arw)
        solutions = {FULL: (full.parameters, full.covariance), UNSTATED: separate[0]}
        if size_deg:
            solutions[STATED] = separate[1]
        for scheme, (parameters, P) in solutions.items():
            row: dict[str, object] = {"part": "full filter", "setup": f"{WRONG} {size_deg:g} deg" if size_deg else RIGHT}
            row |= {"misaligned_deg": size_deg, "estimator": scheme, "dof": 12}
            row |= judge_parameters(parameters.vector - truth.vector, P)
            rows.append(row | (_summarise_own_checks(full) if scheme == FULL else {}))
    return rows


def _summarise_own_checks(full: FullFilterResult) -> dict[str, object]:
    """Summarise the checks that the full filter makes of itself."""
    chi2, dof = (sum(getattr(one, name) for one in full.changes) for name in ("chi2", "dof"))
    return {"innovations_per_dof": full.mean_nis, "changes_per_dof": chi2 / dof}


def run_case(config: ReferencesConfig, number: int, streams: Streams) -> Rows:
    """Rows of all parts."""
    scenario = dispersed(config, number)
    truth, arw = get_true_parameters(scenario), float(np.deg2rad(scenario.gyro.arw_deg_per_sqrt_s))
    rows = [*estimate_attitudes(streams, truth, arw), *run_calibrations(streams, truth, arw)]
    if number % config.full_filter_every:
        return rows
    return [*rows, *compare_full_filter(streams, truth, arw, config.misalignments_deg)]


STUDY = Study("studies.estimation.references:STUDY", ReferencesConfig, run_case)

# Which lines must be consistent and which must not be; those about which nothing is claimed are absent.
EXPECTED_REFERENCE_CONSISTENCY: dict[tuple[str, ...], bool] = {
    **{("attitudes", name): True for name in (EXACT, PLAIN, FILTER, SMOOTHER)},
    ("attitudes", FORMAL): False,
    ("apart", WHOLE): True,
    ("apart", BLOCKS): True,
    ("apart", INDEPENDENT): False,
    ("chain", WHOLE): True,
    ("chain", BLOCKS): False,
    ("chain", INDEPENDENT): False,
    ("timeline", CARRIED): True,
    ("timeline", INDEPENDENT): False,
    (RIGHT, FULL): True,
    (RIGHT, UNSTATED): True,
}
EXPECTED_BIAS: dict[tuple[str, ...], bool] = {  # of the bias alone, in the calibration
    **dict.fromkeys((("apart", WHOLE), ("apart", BLOCKS), ("chain", WHOLE), ("timeline", CARRIED)), True),
    ("apart", INDEPENDENT): False,  # long arcs say most of the bias, and both their ends share one error of it
}


def build_attitude_verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each estimator and time: NEES with bounds, coverage, error and stated sigma."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        estimator, at = part[["estimator", "at"]].iloc[0]
        row = build_nees_row(part["nees"], int(part["dof"].iloc[0]))
        for level in (1, 2):
            row[f"within_{level}_sigma"] = np.nan if at == TOGETHER else part[f"within_{level}"].sum() / (3 * len(part))
        return {
            **row,
            **compute_column_rms(part, "error_mdeg", "sigma_mdeg"),
            "expected": format_expectation(EXPECTED_REFERENCE_CONSISTENCY.get(("attitudes", estimator))),
        }

    own = rows[rows["part"] == "attitudes"].rename(columns={"setup": "at"})
    return summarise_groups(own, ["estimator", "at"], line)


def build_calibration_verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each flight, source of references and treatment: NEES of twelve parameters and of the bias alone.

    Coverage is the share of cases in which the truth is within the ellipsoid that should hold 95 %.
    """

    def line(part: pd.DataFrame) -> dict[str, object]:
        key = tuple(part[["flight", "treatment"]].iloc[0])
        bias = build_nees_row(part["nees_bias"], 3)
        row = build_nees_row(part["nees"], 12)
        row |= {f"bias_{name}": bias[name] for name in ("nees_per_dof", "low", "high", "verdict")}
        for name, values, dof in (("coverage_95", part["nees"], 12), ("bias_coverage_95", part["nees_bias"], 3)):
            row[name] = float((values <= scipy.special.chdtri(dof, 0.05)).mean())
        expected = {
            "expected": format_expectation(EXPECTED_REFERENCE_CONSISTENCY.get(key)),
            "bias_expected": format_expectation(EXPECTED_BIAS.get(key)),
        }
        return {**row, **compute_column_rms(part, "G_error_ppm", "G_sigma_ppm"), **expected}

    own = rows[rows["part"] == "calibration"].rename(columns={"setup": "flight", "estimator": "references"})
    return summarise_groups(own, ["flight", "references", "treatment"], line)


def build_full_filter_verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each sensor model and scheme: NEES, error and sigma of G, and the full filter's own checks."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        key = tuple(part[["sensors", "scheme"]].iloc[0])
        row = {**build_nees_row(part["nees"], 12), **compute_column_rms(part, "G_error_ppm", "G_sigma_ppm")}
        row |= {name: part[name].mean() for name in ("innovations_per_dof", "changes_per_dof")}
        large = np.deg2rad(part["misaligned_deg"].iloc[0]) >= TELLING * DIRECTION_SENSOR_SIGMA * (1 - 1e-9)
        return row | {
            "expected": format_expectation(False if large and key[1] != STATED else EXPECTED_REFERENCE_CONSISTENCY.get(key))
        }

    own = rows[rows["part"] == "full filter"].rename(columns={"setup": "sensors", "estimator": "scheme"})
    return summarise_groups(own, ["sensors", "scheme"], line)


SMOOTHER_ANSWER_NOTE = (
    "The exact batch and the smoother are one answer, and so is the filter at the last time, when it knows the same."
)
OVERCONFIDENCE_NOTE = "What a sensor's unknown misalignment shows is a filter too sure of itself, more than one less accurate."


def _build_checks(rows: pd.DataFrame) -> list[Check]:
    attitudes, calibrations, full = (
        build_attitude_verdicts(rows),
        build_calibration_verdicts(rows),
        build_full_filter_verdicts(rows),
    )
    apart = rows.groupby(["estimator", "setup"])["apart_sigma"].max()
    last, limit = f"{COMPARED_TIMES_S[-1]:g} s", bound_above(ONE_ANSWER)
    out = [
        Check("smoother from the exact batch, largest", apart[SMOOTHER].max(), limit, "sigma", SMOOTHER_ANSWER_NOTE),
        Check(f"filter from the exact batch at {last}, largest", apart[FILTER, last], limit, "sigma"),
    ]
    out += check_nees_rows(attitudes, ["estimator", "at"])
    out += check_nees_rows(calibrations, ["flight", "references", "treatment"])
    out += check_nees_rows(calibrations, ["flight", "references", "treatment"], "bias_", "of the bias alone")
    out += check_nees_rows(full, ["sensors", "scheme"])
    error = full.pivot_table(index="sensors", columns="scheme", values="G_error_ppm", sort=False)
    for row in full[full["scheme"] == FULL].to_dict("records"):
        sensors, ratio = row["sensors"], row["G_error_ppm"] / row["G_sigma_ppm"]
        separate = row["G_error_ppm"] / error.loc[sensors, UNSTATED]
        out.append(
            Check(
                f"full filter's error of G by the separate scheme's, sensors {sensors}", separate, meaning=OVERCONFIDENCE_NOTE
            )
        )
        out.append(Check(f"full filter's error of G by what it states, sensors {sensors}", ratio))
    return [*out, check_case_count(attitudes, calibrations, full)]


def report(config: ReferencesConfig, rows: pd.DataFrame) -> Report:
    """Verdicts on references, on the calibrations fed with them, and on the full filter."""
    calibrations = build_calibration_verdicts(rows)
    short = calibrations.drop(columns=["dof", "bias_low", "bias_high", "bias_expected"])
    lines = "NEES per degree of freedom, with 99.9 % bounds; errors and sigmas are the RMS over cases and components."
    tables = {
        "attitudes": Table("Attitudes", build_attitude_verdicts(rows), lines),
        "calibrations": Table("Calibration from these references, and of the bias alone", calibrations, lines, shown=short),
        "full_filter": Table("Full filter beside the separate scheme", build_full_filter_verdicts(rows), lines),
    }
    return Report(tables, {"references": _draw_figure(rows)}, tuple(_build_checks(rows)))


ENTRY = Entry(STUDY, "batch, filter, smoother: consistent references, and the calibration fed with them", report)


def _draw_figure(rows: pd.DataFrame) -> panels.Draw:
    """Mean NEES per degree of freedom of the calibrations and of the full filter, with bounds of consistent ones."""
    groups = {
        f"{flight}, references by {source}": part.drop(columns=["flight", "references"])
        for (flight, source), part in build_calibration_verdicts(rows).groupby(["flight", "references"], sort=False)
    }
    for sensors, part in build_full_filter_verdicts(rows).groupby("sensors", sort=False):
        groups[f"sensors {sensors}"] = part.drop(columns="sensors")
    lines = sum(1 + len(part) for part in groups.values())
    return panels.build_sheet(panels.make_nees_means(groups), size=(7.6, 0.7 + 0.21 * lines))
