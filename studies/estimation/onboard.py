"""Is the on-board form the ground batch, are its sigmas consistent, and does it need memory?

A case is one pass over a timeline of seven slews about all axes (`studies.estimation.filter_cases`), from errors of 1e-3 in G,
with a sensor of the Sun and of nadir. Three ways of running filter and calibrator side by side:

- "opened": the filter is made to forget at the end of each slew, and Θ is the calibrator's alone, as in N section VI,
- "through": the filter runs through, and its own sensitivity to G is carried along,
- "through, Θ of N": it runs through, and that is left out; the control.

Each is solved with the covariance C carried along and with ends and gyro noise taken for independent: the second control, for
a filter that runs through. The references of the
"opened" pass are given to the ground's calibration, one iteration from the same a-priori parameters: the same answer to
rounding. The first cases measure memory, too, each over another number of samples, beside a program that keeps them.

Columns that begin with "cost_" are measurements of the process, not the same in another run; in threads they count what others
allocate meanwhile. Of the scenario only the gyro's true parameters and angle random walk are used.
"""

import gc
import pickle
import threading
import tracemalloc

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import field_validator

from gyrocal import GyroParameters, attitude, calibrate
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import OnBoardCalibrator, build_ground_recording
from studies.calibration.shared_truth import get_true_parameters
from studies.estimation.attitude_cases import RPO
from studies.estimation.filter_cases import (
    DIRECTION_SENSOR_SIGMA,
    FILTER_CASE_ARW,
    FILTER_START_SIGMA,
    OPENINGS,
    SPANS,
    TRUTH,
    OnBoardCase,
    compute_column_rms,
    compute_independent_covariance,
    compute_rms_sizes,
    judge_parameters,
    run_onboard_case,
    solve_with_covariances,
)
from studies.estimation.flights import DirectionSensor, FixedFlightConfig
from studies.montecarlo.statistics import build_nees_row
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report import panels
from studies.report.checks import Check, bound_above, check_case_count, check_nees_rows, format_expectation
from studies.report.entry import Entry, Report
from studies.report.panels import Line
from studies.report.tables import Table, summarise_groups

Array = NDArray[np.float64]

OPENED, THROUGH, WITHOUT = "opened after slews", "through", "through, Θ of N"
OWN, INDEPENDENT = "C carried along", "taken for independent"
GROUND_AGREEMENT_TOLERANCE = 1e-9  # of G, and of b in rad/s, to the ground's calibration

# Opened anew, the filter has no noise left from before the maneuver that could be counted twice.
EXPECTED_ONBOARD_CONSISTENCY = {(OPENED, OWN): True, (THROUGH, OWN): True, (THROUGH, INDEPENDENT): False, (WITHOUT, OWN): False}
_tracing = threading.Lock()


class OnBoardConfig(FixedFlightConfig):
    """What the study runs; its timeline and sensors are fixed.

    Attributes
    ----------
    memory_samples : numbers of samples that memory is measured over, one in each of the first cases; none to leave it out
    """

    cases: int = 200
    memory_samples: tuple[int, ...] = (1000, 3000, 10000, 30000)

    @field_validator("memory_samples")
    @classmethod
    def _check_memory_samples(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        if any(samples < 200 for samples in value) or len(set(value)) < len(value):
            raise ValueError("must be numbers of 200 samples or more, each once: a maneuver ends within 200")
        return value


def run_case(config: OnBoardConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """A row for each way and covariance, and one of memory in the first cases."""
    scenario = dispersed(config, number)
    truth, arw = get_true_parameters(scenario), float(np.deg2rad(scenario.gyro.arw_deg_per_sqrt_s))
    rows: list[dict[str, object]] = []
    for way, openings, through in ((OPENED, OPENINGS, False), (THROUGH, None, True), (WITHOUT, None, False)):
        one = run_onboard_case(streams.generator("pass"), openings, truth=truth, arw=arw, through_filter=through)
        found, P = one.onboard.solve()
        ground = _compare_with_ground(one, found, P) if way == OPENED else {}
        rows.append(_build_row(way, OWN, found.vector, P, truth) | ground)
        naive = [compute_independent_covariance(maneuver, arw) for maneuver in one.maneuvers]
        rows.append(_build_row(way, INDEPENDENT, *solve_with_covariances(one.apriori, one.maneuvers, naive), truth))
    if number < len(config.memory_samples):
        rows.append(_measure_memory(config.memory_samples[number]))
    return rows


def _build_row(way: str, covariance: str, x: Array, P: Array, truth: GyroParameters) -> dict[str, object]:
    error = x - truth.vector
    sizes = {f"bias_{what}_deg_h": 3600 * float(np.rad2deg(value)) for what, value in compute_rms_sizes(error, P, slice(9, 12))}
    return {"part": "accuracy", "way": way, "covariance": covariance, **judge_parameters(error, P), **sizes}


def _compare_with_ground(one: OnBoardCase, found: GyroParameters, P: Array) -> dict[str, object]:
    """Largest differences from the ground's calibration of the same references."""
    recording, C = build_ground_recording(one.maneuvers, SPANS, one.gyro, "on board", "1998-01-01T00:00:00Z")
    ground = calibrate(recording, iterations=1, interval_covariance=C)
    apart = np.abs(found.vector - ground.parameters.vector)
    return {
        "apart": float(apart.max()),
        "apart_sigma": float((apart / ground.sigma).max()),
        "covariance_apart": float(np.abs(P / ground.covariance - 1).max()),
    }


class SteadyFlight:
    """Samples and measurements made one by one: a constant rate past two fixed directions."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(0)
        self.rate = np.array([0.0, -RPO, 0.0])
        self.raw = np.linalg.solve(TRUTH.G, self.rate - TRUTH.bias)
        self.step = attitude.rotation_matrix(-self.rate * 0.5)
        self.model = DirectionSensor((np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.6, 0.8]])))

    def run(self, samples: int, keep: bool = False) -> tuple[OnBoardCalibrator, int]:
        """The calibrator after so many samples, and the most memory that it and its passing inputs took; bytes.

        Parameters
        ----------
        samples : how many, with a measurement every twenty and a maneuver every two hundred
        keep : whether to keep the samples, as a batch must
        """
        estimator = KalmanFilter(np.eye(3), TRUTH, np.diag(FILTER_START_SIGMA**2), FILTER_CASE_ARW)
        onboard = OnBoardCalibrator(estimator, TRUTH)
        kept = []
        A, row, sigma = np.eye(3), np.array([0]), np.full(6, DIRECTION_SENSOR_SIGMA)
        gc.collect()
        tracemalloc.start()
        for k in range(samples):
            if k % 200 == 50:
                onboard.start()
            if k % 200 == 150:
                onboard.finish()
            raw = self.raw + 1e-7 * self.rng.standard_normal(3)
            onboard.sample(raw, 0.5)
            if keep:
                kept.append(raw)
            A = self.step @ A
            if k % 20 == 0:
                y = self.model.predict(A[None], row)[0] + DIRECTION_SENSOR_SIGMA * self.rng.standard_normal(6)
                onboard.measurement(self.model, 0, y, sigma)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return onboard, peak


def _measure_memory(samples: int) -> dict[str, object]:
    flight = SteadyFlight()
    with _tracing:  # the tracing is one for all threads
        flight.run(400)  # what is made once: compiled code, caches of the interpreter
        (onboard, peak), (_, kept) = flight.run(samples), flight.run(samples, keep=True)
    return {
        "part": "memory",
        "samples": samples,
        "object_bytes": len(pickle.dumps(onboard)),
        "cost_peak_kib": peak / 1024,
        "cost_kept_kib": kept / 1024,
    }


STUDY = Study("studies.estimation.onboard:STUDY", OnBoardConfig, run_case)


def build_verdict_table(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each way and covariance: NEES of the twelve parameters with bounds, accuracy, and distance from the ground."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        way, covariance = part[["way", "covariance"]].iloc[0]
        rms = compute_column_rms(part, "G_error_ppm", "G_sigma_ppm", "bias_error_deg_h", "bias_sigma_deg_h")
        return {
            **build_nees_row(part["nees"], 12),
            "expected": format_expectation(EXPECTED_ONBOARD_CONSISTENCY.get((way, covariance))),
            **rms,
        }

    return summarise_groups(rows[rows["part"] == "accuracy"], ["way", "covariance"], line)


def summarise_ground_difference(rows: pd.DataFrame) -> pd.DataFrame:
    """Largest difference from the ground's calibration over all cases: of the parameters (G, and b in rad/s), and of P."""
    part = rows[(rows.get("way") == OPENED) & (rows["covariance"] == OWN)]
    table = part[["apart", "apart_sigma", "covariance_apart"]].agg(["median", "max"]).rename_axis("over the cases")
    return table.reset_index()


def tabulate_memory(rows: pd.DataFrame) -> pd.DataFrame:
    """Memory over the number of samples; empty if it was not measured."""
    names = ["samples", "object_bytes", "cost_peak_kib", "cost_kept_kib"]
    part = rows[rows["part"] == "memory"].reindex(columns=names).sort_values("samples", ignore_index=True)
    return part.astype({"samples": int, "object_bytes": int})


ONBOARD_ANSWER_NOTE = "From the same references the on-board form and the ground's calibration are one answer, to rounding."
CONSTANT_MEMORY_NOTE = (
    "What hangs on the calibrator is as large after any number of samples; a program that keeps the samples grows."
)


def _build_checks(rows: pd.DataFrame) -> list[Check]:
    apart, table, used = summarise_ground_difference(rows).iloc[-1], build_verdict_table(rows), tabulate_memory(rows)
    out = [
        Check(
            "from the ground's calibration (G, and b in rad/s), largest",
            apart["apart"],
            bound_above(GROUND_AGREEMENT_TOLERANCE),
            "",
            ONBOARD_ANSWER_NOTE,
        ),
        Check("from the ground's calibration, largest", apart["apart_sigma"], bound_above(GROUND_AGREEMENT_TOLERANCE), "sigma"),
        *check_nees_rows(table, ["way", "covariance"]),
    ]
    if len(used):
        first, last = used.iloc[0], used.iloc[-1]
        kept = (float(first["object_bytes"]),) * 2
        out.append(
            Check(
                f"memory kept after {last['samples']:.0f} samples",
                float(last["object_bytes"]),
                kept,
                "bytes",
                CONSTANT_MEMORY_NOTE,
            )
        )
    return [*out, check_case_count(table)]


def report(config: OnBoardConfig, rows: pd.DataFrame) -> Report:
    """The on-board form beside the ground batch, its consistency and its memory."""
    about = "NEES of twelve parameters per degree of freedom, with 99.9 % bounds; errors are the RMS over the cases."
    tables = {
        "ways": Table("Ways and covariances", build_verdict_table(rows), about),
        "from_ground": Table(
            "Difference from the ground's calibration of the same references", summarise_ground_difference(rows)
        ),
    }
    if len(tabulate_memory(rows)):
        tables["memory"] = Table("Memory", tabulate_memory(rows))
    return Report(tables, {"onboard": _draw_figure(rows)}, tuple(_build_checks(rows)))


ENTRY = Entry(STUDY, "is the on-board form the ground batch, consistent, and of constant memory", report)


def _draw_figure(rows: pd.DataFrame) -> panels.Draw:
    """NEES of both covariances beside χ², and memory over the number of samples."""
    through, table = rows[rows["way"] == THROUGH], tabulate_memory(rows)
    nees_of = {name: through.loc[through["covariance"] == name, "nees"] for name in (OWN, INDEPENDENT)}
    drawn = [panels.make_nees_distribution(nees_of, 12, x="NEES of the twelve parameters, filter runs through")]
    if len(table):
        lines = [
            Line(table["samples"], table["cost_kept_kib"], "samples kept, most in use", panels.RED),
            Line(table["samples"], table["cost_peak_kib"], "on board, most in use", panels.TEAL),
            Line(table["samples"], table["object_bytes"] / 1024, "on board, kept", panels.DARK, "s--"),
        ]
        drawn.append(panels.make_curves(lines, log="xy", x="samples", y="memory (KiB)", legend="best"))
    return panels.build_sheet(*drawn, size=(4.3 * len(drawn), 3.2))
