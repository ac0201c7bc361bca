"""Does the alignment calibration find what was injected, by both of R's algorithms, and how sure may one be of it?

A case is one orbit +x forward with the Sun 25° off the orbit plane (`studies.estimation.attitude_cases.AlignmentOrbit`): whole
counts of two sun sensors and the angles of an Earth sensor whose horizon is simulated apart from the one calibrated with.
DSS-2 is misaligned by R (3), the Earth sensor has the penetration biases of `gyrocal.sensors.earth.TRMM_BIASES`; DSS-1 is the
reference.

- all together, with R's plain weights and with exact ones (angle random walk as it correlates the residuals),
- in two steps, once, as R writes algorithm 2: attitude first, then alignment,
- in two steps, repeated until nothing changes.

One round of two steps is biased: the attitude has already been moved to please misaligned sensors. How much of the truth it
keeps depends on the weights, and so on the Earth sensor's sigma; the study varies it, the noise with it. The covariance P it
states is about its own mean T m; about the truth m its NEES should be a consistent one and mᵀ(I − T)ᵀ P⁻¹ (I − T) m.

The control has the head angles of R instead of a misalignment, which no rotation of the sensor can stand for.

Each calibration says what no measurement tells if no sensor is held: a rotation of all sensors together.

Of the scenario only the gyro's angle random walk is used.
"""

from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from gyrocal.sensors.alignment import AlignmentResult, align_in_two_steps, align_together
from gyrocal.sensors.earth import TRMM_BIASES, EarthSensor
from simulator.sensors import sun as true_sun
from studies.estimation.attitude_cases import (
    M_TRUE,
    TRUE_MISALIGNMENT_ANGLES,
    AlignmentOrbit,
    build_alignment_orbit,
    compute_alignment_error,
)
from studies.estimation.flights import FixedFlightConfig
from studies.montecarlo.settings import Different
from studies.montecarlo.statistics import SIGMA_LEVELS, build_nees_row, compute_nees, tabulate_accuracy
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report import panels
from studies.report.checks import Check, bound_above, bound_near, check_case_count, check_nees_rows, format_expectation
from studies.report.entry import Entry, Report
from studies.report.panels import Line
from studies.report.tables import Table, summarise_groups

Array = NDArray[np.float64]

PARAMETERS = ("DSS-2 m_x", "DSS-2 m_y", "DSS-2 m_z", "ESA bias_1", "ESA bias_2", "ESA bias_3", "ESA bias_4")
ALIGNMENT_UNITS = ("mdeg",) * 7
INJECTED = np.concatenate([TRUE_MISALIGNMENT_ANGLES, TRMM_BIASES])
MDEG = 1e3 * np.rad2deg(1.0)
ERRORS, SIGMAS, MEANS = ([f"{what}_{k}_mdeg" for k in range(1, 8)] for what in ("error", "sigma", "expected"))
RETAINED = [f"retained_{k}" for k in range(1, 8)]

TOGETHER, EXACT, REPEATED, ONCE = "together", "together, exact weights", "two steps, repeated", "two steps, once"
HEAD_ANGLES_METHOD = "together, exact weights: R's head angles"
EXPECTED_ALIGNMENT_CONSISTENCY = {
    TOGETHER: True,
    EXACT: True,
    REPEATED: True,
    HEAD_ANGLES_METHOD: False,
}  # consistent about the truth; of ONCE see `_expect_verdict`
COMMON_ROTATIONS = tuple(f"a rotation of all sensors together about body {axis}" for axis in "xyz")


class AlignmentConfig(FixedFlightConfig):
    """What the study runs; its orbit and sensors are fixed.

    Attributes
    ----------
    esa_factors : by how much the Earth sensor is better than TRMM's, for one round of two steps
    tolerance : largest last change of repeated steps, sigma
    """

    used: ClassVar[tuple[str, ...]] = ("gyro.arw_deg_per_sqrt_s",)
    cases: int = 200
    esa_factors: Different = (1.0, 10.0, 50.0)
    tolerance: float = Field(default=1e-3, gt=0, lt=1)


@lru_cache(maxsize=2)
def _build_orbit(arw: float) -> AlignmentOrbit:
    return build_alignment_orbit(arw)


def run_case(config: AlignmentConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """A row for each algorithm, and for each Earth sensor with one round of two steps; errors are true minus estimate."""
    arw = float(np.deg2rad(dispersed(config, number).gyro.arw_deg_per_sqrt_s))
    orbit = _build_orbit(arw)
    start = orbit.A[0]
    gyro = orbit.motion.gyro(streams.generator("gyro_noise"))
    series = orbit.series(streams.generator("sensor_noise"))
    one = align_together(series, gyro, start, "DSS-1")
    repeated = align_in_two_steps(series, gyro, start, "DSS-1", rounds=None, tolerance=config.tolerance)
    rows = [
        _build_row(TOGETHER, one),
        _build_row(EXACT, align_together(series, gyro, start, "DSS-1", weighting="exact")),
        _build_row(REPEATED, repeated)
        | {"apart_sigma": float(np.abs((_compute_error(repeated) - _compute_error(one)) / one.sigma).max())},
    ]
    for factor in config.esa_factors:
        better = orbit.series(streams.generator("sensor_noise"), esa_factor=factor)
        rows.append(_build_row(ONCE, align_in_two_steps(better, gyro, start, "DSS-1"), esa_factor=factor))
    heads = (true_sun.HEAD_DSS1, true_sun.HEAD_DSS2)
    spoilt = orbit.series(streams.generator("sensor_noise"), M=np.eye(3), heads=heads)
    rows.append(_build_row(HEAD_ANGLES_METHOD, align_together(spoilt, gyro, start, "DSS-1", weighting="exact"), M=np.eye(3)))
    return rows


def _compute_error(found: AlignmentResult, M: Array = M_TRUE) -> Array:
    return compute_alignment_error(found.misalignment["DSS-2"], found.penetration_biases["ESA"], M)


def _build_row(algorithm: str, found: AlignmentResult, M: Array = M_TRUE, esa_factor: float = 1.0) -> dict[str, object]:
    error = _compute_error(found, M)
    # In first order: what one round leaves of the parameters, none for all others.
    expected = INJECTED - found.retained @ INJECTED
    row: dict[str, object] = {
        "algorithm": algorithm,
        "esa_factor": esa_factor,
        "nees": float(compute_nees(error[None], found.covariance[None])[0]),
        "nees_own_mean": float(compute_nees((error - expected)[None], found.covariance[None])[0]),
        "nees_predicted": 7 + float(compute_nees(expected[None], found.covariance[None])[0]),
        "loss_before": found.loss_before,
        "loss_after": found.loss_after,
        "loss_dof": found.dof,
        "rounds": found.rounds,
        "unobservable": "; ".join(found.unobservable),
    }
    columns = (
        (ERRORS, error * MDEG),
        (SIGMAS, found.sigma * MDEG),
        (MEANS, expected * MDEG),
        (RETAINED, np.diag(found.retained)),
    )
    for names, values in columns:
        row |= dict(zip(names, values.tolist(), strict=True))
    return row


STUDY = Study("studies.estimation.alignment:STUDY", AlignmentConfig, run_case)


def build_verdict_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row an algorithm: NEES of the seven parameters about the truth with bounds, and the loss where it should be χ²."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        errors, algorithm = part[ERRORS].to_numpy(), str(part["algorithm"].iloc[0])
        standard_errors = errors.std(axis=0, ddof=1) / np.sqrt(len(part)) if len(part) > 1 else np.full(7, np.nan)
        row = build_nees_row(part["nees"], 7)
        dof = int(part["loss_dof"].iloc[0])
        return row | {
            "expected": _expect_verdict(algorithm, row, part["nees_predicted"].mean() / 7),
            "largest_mean_in_standard_errors": float(np.abs(errors.mean(axis=0) / standard_errors).max()),
            "loss_per_dof": part["loss_after"].mean() / dof,
            "loss_verdict": build_nees_row(part["loss_after"], dof)["verdict"] if "exact" in algorithm else "not χ²",
            "rounds": float(part["rounds"].median()),
        }

    return summarise_groups(rows, ["algorithm", "esa_factor"], line)


def _expect_verdict(algorithm: str, row: dict[str, Any], predicted: float) -> str:
    """The verdict there should be; of one round of two steps that of its predicted NEES, if that is clear of the bound."""
    if algorithm != ONCE:
        return format_expectation(EXPECTED_ALIGNMENT_CONSISTENCY[algorithm])
    low, high = row["low"], row["high"]
    small = predicted - 1 < 0.05 * (high - 1)
    return format_expectation(False if predicted > high + (high - low) else True if small else None)


def summarise_one_round(rows: pd.DataFrame) -> pd.DataFrame:
    """A row an Earth sensor: what one round of two steps keeps of the truth, and its error in DSS-2's x, that is in yaw."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        about, yaw = build_nees_row(part["nees_own_mean"], 7), part[ERRORS[0]]
        return {
            "esa_sigma_mdeg": EarthSensor(np.zeros(4)).sigma / part["esa_factor"].iloc[0] * MDEG,
            "kept_yaw": part[RETAINED[0]].mean(),
            "kept_least_of_the_others": part[RETAINED[1:]].mean().min(),
            "yaw_error_predicted_mdeg": part[MEANS[0]].mean(),
            "yaw_error_mdeg": yaw.mean(),
            "standard_error_mdeg": yaw.std(ddof=1) / np.sqrt(len(part)),  # NaN of one case
            "sigma_mdeg": part[SIGMAS[0]].mean(),
            "nees_per_dof_about_the_truth": part["nees"].mean() / 7,
            "nees_per_dof_predicted": part["nees_predicted"].mean() / 7,
            "nees_per_dof_about_own_mean": about["nees_per_dof"],
            "verdict_about_own_mean": about["verdict"],
        }

    return summarise_groups(rows[rows["algorithm"] == ONCE].sort_values("esa_factor", kind="stable"), ["esa_factor"], line)


ONE = "Two steps repeated until nothing changes, and all together, are one answer."
TWO_STEP_NOTE = (
    "One round of two steps keeps a part of the truth; its error and its NEES about the truth are predicted from that part."
)
COMMON_ROTATION = (
    "If no sensor is held, a rotation of all sensors together is not observable, about all axes with TRMM's Earth sensor."
)
MISALIGNMENT_NOTE = (
    "A misalignment stands for no head angle: it is found where there is none, and the loss shows that the model is wrong."
)


def _build_checks(config: AlignmentConfig, rows: pd.DataFrame) -> list[Check]:
    table = build_verdict_table(rows)
    out = check_nees_rows(table, ["algorithm", "esa_factor"])
    repeated = rows[rows["algorithm"] == REPEATED]
    limit = bound_above(5 * config.tolerance)
    out.append(Check("two steps repeated from all together, largest", repeated["apart_sigma"].max(), limit, "sigma", ONE))
    out.append(Check("rounds of two steps repeated, median", repeated["rounds"].median()))
    for row in summarise_one_round(rows).to_dict("records"):
        sensor, cases = f"one round, ESA {row['esa_factor']:g} times better", rows["case"].nunique()
        yaw = bound_near(row["yaw_error_predicted_mdeg"], 4 * row["sigma_mdeg"] / np.sqrt(cases))
        predicted = row["nees_per_dof_predicted"]
        spread = np.sqrt((2 * 7 + 4 * 7 * (predicted - 1)) / cases) / 7
        out.append(Check(f"kept of DSS-2's yaw misalignment, {sensor}", row["kept_yaw"], meaning=TWO_STEP_NOTE))
        out.append(Check(f"mean yaw error, {sensor}", row["yaw_error_mdeg"], yaw, "mdeg"))
        nees_bounds = bound_near(predicted, 4 * spread)
        out.append(Check(f"mean NEES about the truth, {sensor}", row["nees_per_dof_about_the_truth"], nees_bounds, "NEES/dof"))
    whole = rows.loc[rows["esa_factor"] == 1, "unobservable"] == "; ".join(COMMON_ROTATIONS)
    reported = f"calibrations that report the common rotation about x, y and z, of {len(whole)}"
    out.append(Check(reported, int(whole.sum()), (len(whole), len(whole)), "", COMMON_ROTATION))
    for factor, part in rows[rows["esa_factor"] != 1].groupby("esa_factor"):
        about = part["unobservable"].str.count("a rotation of all sensors together about").median()
        out.append(Check(f"axes of that rotation, ESA {factor:g} times better, median", about))
    heads = rows[rows["algorithm"] == HEAD_ANGLES_METHOD]
    apparent = float(np.linalg.norm(heads[ERRORS[:3]].mean()))
    loss = build_nees_row(heads["loss_after"], int(heads["loss_dof"].iloc[0]))
    out.append(Check("misalignment found for R's head angles", apparent, None, "mdeg", MISALIGNMENT_NOTE))
    bounds = (loss["low"], loss["high"])
    out.append(
        Check(
            "loss per degree of freedom with them", heads["loss_after"].mean() / heads["loss_dof"].iloc[0], bounds, outside=True
        )
    )
    return [*out, check_case_count(table)]


def report(config: AlignmentConfig, rows: pd.DataFrame) -> Report:
    """Verdicts on the algorithms, each parameter, and one round of two steps over the Earth sensor's sigma."""
    algorithms, rounds = build_verdict_table(rows), summarise_one_round(rows)
    short = algorithms.drop(columns=["cases", "dof", "largest_mean_in_standard_errors"])
    about = "NEES of seven parameters per degree of freedom about the truth, with 99.9 % bounds."
    tables = {
        "algorithms": Table("Algorithms", algorithms, about, shown=short),
        "one_round": Table(
            "One round of two steps over the Earth sensor's sigma",
            rounds,
            shown=rounds.drop(columns=["esa_factor", "kept_least_of_the_others"]),
        ),
    }
    one = rows[rows["algorithm"] == TOGETHER]
    if len(one) > 1:  # a spread of one case is none
        accuracy = tabulate_accuracy(one[ERRORS].to_numpy(), one[SIGMAS].to_numpy(), PARAMETERS, ALIGNMENT_UNITS)
        kept = [
            "parameter",
            "unit",
            "bias",
            "standard_error",
            "spread",
            "formal_sigma",
            *(f"coverage_{k}" for k in SIGMA_LEVELS),
        ]
        tables["parameters"] = Table("All together, by parameter (true minus estimate)", accuracy, shown=kept)
    return Report(tables, {"alignment": _draw_figure(rows)}, tuple(_build_checks(config, rows)))


ENTRY = Entry(STUDY, "is the sensors' alignment found, by both algorithms, and what do two steps lose", report)


def _draw_figure(rows: pd.DataFrame) -> panels.Draw:
    """NEES of the consistent algorithms beside χ², and the yaw that one round of two steps leaves."""
    nees_of = {name: rows.loc[rows["algorithm"] == name, "nees"] for name in (EXACT, TOGETHER, REPEATED)}
    table = summarise_one_round(rows)
    sigma, error, predicted = (table[name] for name in ("esa_sigma_mdeg", "yaw_error_mdeg", "yaw_error_predicted_mdeg"))
    low, high = error - table["sigma_mdeg"], error + table["sigma_mdeg"]
    found = Line(sigma, error, "found: mean, stated sigma", panels.RED, "o", low, high, bars=True)
    lines = [found, Line(sigma, predicted, "(1 − T) × injected", panels.TEAL, "_")]
    axes: dict[str, Any] = {
        "log": "x",
        "ticks": sigma,
        "levels": [0],
        "legend": "best",
        "x": "sigma of the Earth sensor (mdeg)",
    }
    return panels.build_sheet(
        panels.make_nees_distribution(nees_of, 7, {REPEATED: ":"}, x="NEES about the truth, seven parameters"),
        panels.make_curves(lines, y="yaw error of DSS-2 after one round (mdeg)", **axes),
        size=(8.6, 3.2),
    )
