"""Is the on-board form the ground batch, are its sigmas honest, and does it need memory?

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
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import field_validator

from gyrocal import GyroParameters, attitude, calibrate
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import OnBoardCalibrator, recorded
from studies.estimation.attitude_cases import RPO, FixedFlightConfig
from studies.estimation.filter_cases import (
    ARW,
    OPENINGS,
    SENSOR,
    SPANS,
    START,
    TRUTH,
    OnBoardCase,
    VectorModel,
    independent_covariance,
    on_board_case,
    solved_with,
    true_parameters,
)
from studies.estimation.judging import judged, nees_distribution, score, word
from studies.montecarlo.statistics import nees
from studies.montecarlo.study import Streams, Study, dispersed
from studies.report.entry import Entry, Report
from studies.report.panels import STYLE, save
from studies.report.tables import Table

Array = NDArray[np.float64]

OPENED, THROUGH, WITHOUT = "opened after slews", "through", "through, Θ of N"
OWN, INDEPENDENT = "C carried along", "taken for independent"
AGREEMENT = 1e-9  # of G, and of b in rad/s, to the ground's calibration

# Opened anew, the filter has no noise left from before the maneuver that could be counted twice.
EXPECTED = {(OPENED, OWN): True, (THROUGH, OWN): True, (THROUGH, INDEPENDENT): False, (WITHOUT, OWN): False}
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
    def _many(cls, value: tuple[int, ...]) -> tuple[int, ...]:
        if any(samples < 200 for samples in value) or len(set(value)) < len(value):
            raise ValueError("must be numbers of 200 samples or more, each once: a maneuver ends within 200")
        return value


def case(config: OnBoardConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """A row for each way and covariance, and one of memory in the first cases."""
    scenario = dispersed(config, number)
    truth, arw = true_parameters(scenario), float(np.deg2rad(scenario.gyro.arw_deg_per_sqrt_s))
    rows: list[dict[str, object]] = []
    for way, openings, through in ((OPENED, OPENINGS, False), (THROUGH, None, True), (WITHOUT, None, False)):
        one = on_board_case(streams.generator("pass"), openings, truth=truth, arw=arw, through_filter=through)
        found, P = one.onboard.solve()
        ground = _apart_from_ground(one, found, P) if way == OPENED else {}
        rows.append(_row(way, OWN, found.vector, P, truth) | ground)
        naive = [independent_covariance(maneuver, arw) for maneuver in one.maneuvers]
        rows.append(_row(way, INDEPENDENT, *solved_with(one.apriori, one.maneuvers, naive), truth))
    if number < len(config.memory_samples):
        rows.append(_memory(config.memory_samples[number]))
    return rows


def _row(way: str, covariance: str, x: Array, P: Array, truth: GyroParameters) -> dict[str, object]:
    error, sigma = x - truth.vector, np.sqrt(np.diag(P))
    return {
        "part": "accuracy",
        "way": way,
        "covariance": covariance,
        "nees": float(nees(error[None], P[None])[0]),
        "G_error_ppm": 1e6 * float(np.sqrt(np.mean(error[:9] ** 2))),
        "G_sigma_ppm": 1e6 * float(np.sqrt(np.mean(sigma[:9] ** 2))),
        "bias_error_deg_h": 3600 * float(np.rad2deg(np.sqrt(np.mean(error[9:] ** 2)))),
        "bias_sigma_deg_h": 3600 * float(np.rad2deg(np.sqrt(np.mean(sigma[9:] ** 2)))),
    }


def _apart_from_ground(one: OnBoardCase, found: GyroParameters, P: Array) -> dict[str, object]:
    """Largest differences from the ground's calibration of the same references."""
    recording, C = recorded(one.maneuvers, SPANS, one.gyro, "on board", "1998-01-01T00:00:00Z")
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
        self.model = VectorModel((np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.6, 0.8]])))

    def run(self, samples: int, keep: bool = False) -> tuple[OnBoardCalibrator, int]:
        """The calibrator after so many samples, and the most memory that it and its passing inputs took; bytes.

        Parameters
        ----------
        samples : how many, with a measurement every twenty and a maneuver every two hundred
        keep : whether to keep the samples, as a batch must
        """
        estimator = KalmanFilter(np.eye(3), TRUTH, np.diag(START**2), ARW)
        onboard = OnBoardCalibrator(estimator, TRUTH)
        kept = []
        A, row, sigma = np.eye(3), np.array([0]), np.full(6, SENSOR)
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
                y = self.model.predict(A[None], row)[0] + SENSOR * self.rng.standard_normal(6)
                onboard.measurement(self.model, 0, y, sigma)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return onboard, peak


def _memory(samples: int) -> dict[str, object]:
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


STUDY = Study("studies.estimation.onboard:STUDY", OnBoardConfig, case)


def verdicts(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each way and covariance: NEES of the twelve parameters with bounds, accuracy, and distance from the ground."""
    out = []
    for (way, covariance), part in rows[rows["part"] == "accuracy"].groupby(["way", "covariance"], sort=False):
        row: dict[str, object] = {"way": way, "covariance": covariance}
        row |= judged(part["nees"], 12)
        row["expected"] = word(EXPECTED.get((str(way), str(covariance))))
        for name in ("G_error_ppm", "G_sigma_ppm", "bias_error_deg_h", "bias_sigma_deg_h"):
            row[name] = float(np.sqrt(np.mean(part[name] ** 2)))
        out.append(row)
    return pd.DataFrame(out)


def from_ground(rows: pd.DataFrame) -> pd.DataFrame:
    """Largest difference from the ground's calibration over all cases: of the parameters (G, and b in rad/s), and of P."""
    part = rows[(rows.get("way") == OPENED) & (rows["covariance"] == OWN)]
    table = part[["apart", "apart_sigma", "covariance_apart"]].agg(["median", "max"]).rename_axis("over the cases")
    return table.reset_index()


def memory(rows: pd.DataFrame) -> pd.DataFrame:
    """Memory over the number of samples; empty if it was not measured."""
    if "samples" not in rows:
        return pd.DataFrame(columns=["samples", "object_bytes", "cost_peak_kib", "cost_kept_kib"])
    part = rows[rows["part"] == "memory"].sort_values("samples")
    whole = part[["samples", "object_bytes"]].astype(int)
    return whole.assign(**{name: part[name] for name in ("cost_peak_kib", "cost_kept_kib")}).reset_index(drop=True)


def _findings(rows: pd.DataFrame) -> list[str]:
    apart, table = from_ground(rows).iloc[-1], verdicts(rows)
    largest = max(apart["apart"], apart["apart_sigma"])
    out = [
        f"From the same references the on-board form and the ground's calibration differ by {apart['apart']:.1e} at most (G, "
        f"and b in rad/s), {apart['apart_sigma']:.1e} sigma, in any parameter of any case: "
        f"{'within' if largest <= AGREEMENT else 'NOT within'} {AGREEMENT:.0e}."
    ]
    for way, part in table.groupby("way", sort=False):
        each = "; ".join(
            f"{row['covariance']} {row['nees_per_dof']:.3f} ({row['verdict']}, G wrong by {row['G_error_ppm']:.0f} ppm where "
            f"{row['G_sigma_ppm']:.0f} are stated)"
            for _, row in part.iterrows()
        )
        low, high = part[["low", "high"]].iloc[0]
        out.append(f"Filter {way}: NEES per degree of freedom (bounds {low:.3f} to {high:.3f}) {each}.")
    used = memory(rows)
    if len(used):
        first, last = used.iloc[0], used.iloc[-1]
        out.append(
            f"Memory: {last['object_bytes']:.0f} bytes hang on the calibrator after {last['samples']:.0f} samples, "
            f"{first['object_bytes']:.0f} after {first['samples']:.0f}; the most in use was {last['cost_peak_kib']:.0f} KiB "
            f"and {first['cost_peak_kib']:.0f} KiB. A program that keeps the samples takes {last['cost_kept_kib']:.0f} KiB."
        )
    return [*out, score(table)]


def report(config: OnBoardConfig, rows: pd.DataFrame) -> Report:
    """The on-board form beside the ground batch, its consistency and its memory."""
    ways = (
        "Ways and covariances (NEES of twelve parameters per degree of freedom, 99.9 % bounds; errors are the RMS over cases)"
    )
    tables = {
        "ways": Table(ways, verdicts(rows)),
        "from_ground": Table("Difference from the ground's calibration of the same references", from_ground(rows)),
    }
    if len(memory(rows)):
        tables["memory"] = Table("Memory", memory(rows))
    return Report(tables, {"onboard": partial(figure, rows)}, findings=tuple(_findings(rows)))


ENTRY = Entry(STUDY, "is the on-board form the ground batch, honest, and of constant memory", report)


def figure(rows: pd.DataFrame, path: Path) -> Path:
    """NEES of both covariances beside χ², and memory over the number of samples."""
    with mpl.rc_context(STYLE):
        table = memory(rows)
        drawing = Figure(figsize=(8.6 if len(table) else 4.3, 3.2), layout="constrained")
        left, *rest = drawing.subplots(1, 2 if len(table) else 1, squeeze=False)[0]
        through = rows[rows["way"] == THROUGH]
        for covariance, colour in ((OWN, "#00798c"), (INDEPENDENT, "#d1495b")):
            nees_distribution(left, through.loc[through["covariance"] == covariance, "nees"], 12, colour, covariance)
        left.set_xlabel("NEES of the twelve parameters, filter runs through")
        left.legend(fontsize=7, loc="lower right")
        for right in rest:
            for name, colour, label in (
                ("cost_kept_kib", "#d1495b", "samples kept, most in use"),
                ("cost_peak_kib", "#00798c", "on board, most in use"),
            ):
                right.loglog(table["samples"], table[name], "o-", color=colour, markersize=4, label=label)
            right.loglog(
                table["samples"], table["object_bytes"] / 1024, "s--", color="#30343f", markersize=4, label="on board, kept"
            )
            right.set_xlabel("samples")
            right.set_ylabel("memory (KiB)")
            right.legend(fontsize=7)
        return save(drawing, path)
