"""Skipping samples compared with averaging them, for steps of 0.5 to 8 s, over seeds.

Skipping holds one sample over a step of f samples, as N section V did: the integrated gyro noise has f times the variance.
Averaging uses them all: the noise does not change, and holding a mean rate over the step while the rate changes makes an error
of second order in Δt. A row is one case calibrated one method:

- ``error_``: recovered minus injected, with all noise
- ``gyro_``: the same with the gyro's noise alone and exact references
- ``held_``: the same without noise, which is the bias that the step itself makes
- ``sigma_``: the formal sigma; ``nees`` that of the error
- ``step_arw_deg_per_sqrt_s``: the angle random walk from the spread of the 18 pre-launch residuals between this step and the
  next finer one, both by skipping, as `studies.natanson.flight_gap.estimate_noise_from_steps` computes it for the flight

G is dimensionless, b in deg/s.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from gyrocal import NAMES
from gyrocal.arrays import Array
from gyrocal.calibration.problem import Iterates, Problem
from gyrocal.calibration.sampling import Resampling, prepare_measurements
from studies.calibration.shared_truth import NoiseFreeSimulation, Rising, build_once, compute_rms, make_noise_generators
from studies.calibration.summaries import find_level_crossing, fit_log_slope, summarise_with_flight
from studies.montecarlo import statistics
from studies.montecarlo.study import Streams, Study, StudyConfig, observed
from studies.natanson import flight, flight_gap
from studies.report import panels
from studies.report.checks import Check, bound_above, bound_near, check_extremes
from studies.report.entry import Entry, Report
from studies.report.panels import Line
from studies.report.tables import Table
from studies.report.units import ONE_DEG_S, ONE_DEG_S_NAMES

StepMethod = tuple[float, Resampling]  # step, s, and resampling of a calibration

STEPS_S = (0.5, 1.0, 2.0, 4.0, 8.0)
CALIBRATION_ITERATIONS = 3  # leaves less than 1e-6 sigma; see studies.calibration.iterations
LIMIT = 0.1  # formal sigmas of bias that count as none


class TimestepConfig(StudyConfig):
    """What the study runs."""

    cases: int = 100
    steps_s: Rising = STEPS_S  # step sizes, rising

    def list_methods(self, sample_s: float) -> list[StepMethod]:
        """List the methods of calibrating a case; the sample's own step is under "skip" alone."""
        return [(step, "skip") for step in self.steps_s] + [(step, "average") for step in self.steps_s if step > sample_s]


@dataclass(frozen=True)
class _TimestepProblems:
    """Common to the cases of a scenario."""

    flown: NoiseFreeSimulation  # the scenario without noise
    T_s: Array  # (m, 1) time between the references of each residual
    problems: dict[StepMethod, Problem]  # of each method
    held: dict[StepMethod, Array]  # (12,) noise-free error of each method


@build_once
def _prepare_problems(config: TimestepConfig, flown: NoiseFreeSimulation) -> _TimestepProblems:
    methods = config.list_methods(flown.scenario.gyro.sample_s)
    prepared = {method: prepare_measurements(flown.plain, *method) for method in methods}
    problems = {method: Problem.build(flown.plain, measurements) for method, measurements in prepared.items()}
    held = {
        method: problem.iterate(flown.initial, CALIBRATION_ITERATIONS).check_convergence().x[-1] - flown.truth
        for method, problem in problems.items()
    }
    return _TimestepProblems(flown, next(iter(prepared.values())).elapsed_s[:, None], problems, held)


def run_case(config: TimestepConfig, number: int, streams: Streams) -> list[dict[str, object]]:
    """Calibrate a case by each method, a row each."""
    prepared = _prepare_problems(config, number)
    flown, sample_s = prepared.flown, prepared.flown.scenario.gyro.sample_s
    (rates, A), (_, A_true) = flown.realise(make_noise_generators(streams)), flown.realise()
    rows: list[dict[str, object]] = []
    previous: tuple[float, Array] | None = None
    for method, problem in prepared.problems.items():
        step, resampling = method
        result = problem.replace_case(rates, A).iterate(flown.initial, CALIBRATION_ITERATIONS).check_convergence()
        gyro_result = problem.replace_case(rates, A_true).iterate(flown.initial, CALIBRATION_ITERATIONS).check_convergence()
        arw = np.nan
        if resampling == "skip":
            if previous is not None:
                arw = compute_step_arw(result.theta[0] - previous[1], prepared.T_s, (step - previous[0]) / sample_s)
            previous = step, result.theta[0]
        row: dict[str, object] = {
            "step_s": step,
            "resampling": resampling,
            **_compute_errors(flown.truth, result, gyro_result, prepared.held[method]),
        }
        rows.append(row | {"step_arw_deg_per_sqrt_s": arw})
    return rows


def _compute_errors(truth: Array, result: Iterates, gyro_result: Iterates, held: Array) -> dict[str, float]:
    """Compute errors, sigmas and NEES of one method."""
    sigma, error = np.sqrt(np.diag(result.P)), result.x[-1] - truth
    columns = {"error": error, "gyro": gyro_result.x[-1] - truth, "held": held, "sigma": sigma}
    out = {
        f"{label}_{name}": float(value)
        for label, vector in columns.items()
        for name, value in zip(NAMES, vector * ONE_DEG_S, strict=True)
    }
    return out | {"nees": float(statistics.compute_nees(error[None], result.P[None])[0])}


def compute_step_arw(difference: Array, T_s: Array, samples: float) -> float:
    """Compute the ARW, deg/√s, from differences (m, 3) rad of residuals of two skipped steps, over T_s (m, 1).

    A step of f samples held by skipping has f times the noise variance ARW² T of the full stream. Its noise is correlated with
    that of a finer step so that their difference has the variance (f₂ − f₁) ARW² T.
    """
    return float(np.rad2deg(np.sqrt(np.mean(difference**2 / (samples * T_s)))))


STUDY = Study("studies.calibration.timestep:STUDY", TimestepConfig, run_case, observed)


def select_step(rows: pd.DataFrame, step_s: float, resampling: str) -> pd.DataFrame:
    """Select the rows of one method; those of the full stream under either name."""
    of_step = rows[rows["step_s"] == step_s]
    return of_step[of_step["resampling"] == resampling] if resampling in set(of_step["resampling"]) else of_step


def _select_columns(rows: pd.DataFrame, label: str) -> Array:
    return rows[[f"{label}_{name}" for name in NAMES]].to_numpy()


def tabulate_parameter_biases(rows: pd.DataFrame) -> pd.DataFrame:
    """Build a row per method and parameter: bias with its standard error, the bias without noise, spread, formal sigma."""
    out = []
    for (resampling, step), part in rows.groupby(["resampling", "step_s"]):
        error, gyro, held, sigma = (_select_columns(part, label) for label in ("error", "gyro", "held", "sigma"))
        spread = error.std(axis=0, ddof=1) if len(part) > 1 else np.full(len(NAMES), np.nan)
        columns = {
            "bias": error.mean(axis=0),
            "standard_error": spread / np.sqrt(len(part)),
            "held": held.mean(axis=0),
            "spread": spread,
            "gyro_spread": np.sqrt(np.mean((gyro - held) ** 2, axis=0)),
            "formal_sigma": np.sqrt(np.mean(sigma**2, axis=0)),
        }
        keys = {"resampling": resampling, "step_s": step, "parameter": NAMES, "unit": ONE_DEG_S_NAMES}
        out.append(pd.DataFrame(keys | columns))
    return pd.concat(out, ignore_index=True)


def summarise_steps(rows: pd.DataFrame) -> pd.DataFrame:
    """Build a row per method and step: held_sigma is the largest noise-free error, in formal sigmas.

    bias_z is the largest difference of the mean and the noise-free error in standard errors. The ratios are the spread and the
    gyro noise's part of it, over those of the full stream; they and spread_over_formal are RMS over the parameters.
    """
    table = tabulate_parameter_biases(rows)
    finest = rows["step_s"].min()
    full_stream = table[table["step_s"] == finest].groupby("parameter", sort=False).first()
    out = []
    for resampling in ("skip", "average"):
        for step in sorted(set(rows["step_s"])):
            part = select_step(rows, step, resampling)
            is_row = (table["step_s"] == step) & (table["resampling"] == part["resampling"].iloc[0])
            values = table[is_row].set_index("parameter")
            check = statistics.check_mean_nees(part["nees"].to_numpy(), len(NAMES))
            out.append(
                {
                    "resampling": resampling,
                    "step_s": step,
                    "held_sigma": (values["held"].abs() / values["formal_sigma"]).max(),
                    "bias_z": ((values["bias"] - values["held"]).abs() / values["standard_error"]).max(),
                    "spread_over_formal": compute_rms(values["spread"] / values["formal_sigma"]),
                    "spread_ratio": compute_rms(values["spread"] / full_stream["spread"]),
                    "gyro_ratio": compute_rms(values["gyro_spread"] / full_stream["gyro_spread"]),
                    "nees": check.value,
                    "nees_lower": check.lower,
                    "nees_upper": check.upper,
                }
            )
    return pd.DataFrame(out)


def estimate_gyro_order(rows: pd.DataFrame, resampling: str) -> tuple[float, float]:
    """Estimate the order in Δt of the gyro noise's part of the spread, and its standard error by the jackknife."""
    steps = sorted(set(rows["step_s"]))
    parts = [select_step(rows, step, resampling).sort_values("case") for step in steps]
    squares = np.stack([(_select_columns(part, "gyro") - _select_columns(part, "held")) ** 2 for part in parts])
    sums = squares.sum(axis=1)
    n = squares.shape[1]
    if n < 2 or len(steps) < 2:
        return float("nan"), float("nan")

    def fit_orders(sums_of_squares: Array) -> Array:
        ratio = np.sqrt(np.mean(sums_of_squares / sums_of_squares[:1], axis=-1))
        return np.asarray(np.polyfit(np.log(steps), np.log(ratio), 1)[0])

    leave_one_out = fit_orders(sums[:, None] - squares)  # (cases,) orders without each case, for the jackknife
    return float(fit_orders(sums[:, None])[0]), float(np.sqrt((n - 1) * np.var(leave_one_out)))


def estimate_step_noise(rows: pd.DataFrame) -> pd.DataFrame:
    """Estimate the angle random walk from the spread to the next finer step, simulated and, if known, in flight."""
    out = []
    skipped = rows[rows["resampling"] == "skip"]
    for finer, step in pairwise(sorted(set(skipped["step_s"]))):
        values = skipped[skipped["step_s"] == step]["step_arw_deg_per_sqrt_s"]
        flown = np.nan
        if finer in flight.FLIGHT_STEPS_S and step in flight.FLIGHT_STEPS_S:
            coarse, fine = (flight.read_published_residuals("prelaunch", step_size) for step_size in (step, finer))
            T_s, samples = flight.compute_interval_durations()[:, None], (step - finer) / flight.FLIGHT_STEPS_S[0]
            flown = compute_step_arw(np.deg2rad(coarse - fine), T_s, samples)
        out.append({"from_s": finer, "to_s": step, **summarise_with_flight(values, flown)})
    return pd.DataFrame(out, columns=["from_s", "to_s", "median", "p05", "p95", "flight", "flight_percentile"])


NOISE_GROWTH_NOTE = (
    "Skipping f samples leaves the noise of one, which grows with the square root of f; averaging does not change it."
)
BIAS = "Holding the mean rate over a step is wrong to second order in the step."
FLOWN_ARW_NOTE = "The bounds of the flight's angle random walk are the 5 % and 95 % quantiles of the simulated ones."


def _build_checks(rows: pd.DataFrame) -> list[Check]:
    """Check the orders in Δt of noise and bias, the mean errors, NEES, and the flight's angle random walk."""
    table, steps = summarise_steps(rows), estimate_step_noise(rows)
    checks = []
    for method, expected, slack in (("skip", 0.5, 0.0), ("average", 0.0, 1e-3)):
        power, uncertain = estimate_gyro_order(rows, method)
        name = f"order in Δt of the gyro noise's part of the spread, {method}"
        checks.append(Check(name, power, bound_near(expected, 4 * uncertain + slack), meaning=NOISE_GROWTH_NOTE))
    average = table[table["resampling"] == "average"]
    biases = average["step_s"], average["held_sigma"]
    checks.append(Check("order in Δt of the bias without noise, average", fit_log_slope(*biases), (1.9, 2.1), meaning=BIAS))
    name = f"step from which that bias exceeds {LIMIT:g} formal sigma"
    checks.append(Check(name, find_level_crossing(*biases, LIMIT), None, "s"))
    largest = table["bias_z"].max()
    checks.append(Check("mean error less the bias without noise, largest", largest, bound_above(4), "standard errors"))
    checks += check_extremes("mean NEES of a way", table["nees"], (table["nees_lower"].iloc[0], table["nees_upper"].iloc[0]))
    for row in steps[steps["flight"].notna()].to_dict("records"):
        name = f"angle random walk of the flight by its spread from {row['from_s']:g} to {row['to_s']:g} s"
        checks.append(Check(name, row["flight"], (row["p05"], row["p95"]), "deg/√s", FLOWN_ARW_NOTE))
    noise = flight_gap.estimate_noise_from_steps()
    checks.append(Check("angle random walk of the flight by all its spreads", noise["arw_deg_per_sqrt_s"], None, "deg/√s"))
    return [*checks, Check("relative standard error of that", noise["relative_sigma"])]


def report(config: TimestepConfig, rows: pd.DataFrame) -> Report:
    """Report the noise and the bias that skipping and averaging add."""
    steps = summarise_steps(rows)
    title = "Skipping and averaging (largest or RMS over the parameters; ratios to the full stream)"
    return Report({"steps": Table(title, steps)}, {"timestep": _draw_figure(steps)}, tuple(_build_checks(rows)))


ENTRY = Entry(STUDY, "skipping against averaging samples, steps of 0.5 to 8 s", report)

RESAMPLING_STYLES = {"skip": (panels.RED, "o-"), "average": (panels.TEAL, "s-")}


def _draw_figure(table: pd.DataFrame) -> panels.Draw:
    """Draw noise, bias and NEES of skipping and averaging over the step."""

    def build_lines(name: str, dotted: bool = False) -> list[Line]:
        parts = {method: table[table["resampling"] == method] for method in RESAMPLING_STYLES}
        styles = {method: (colour, ":" if dotted else style) for method, (colour, style) in RESAMPLING_STYLES.items()}
        return [Line(part["step_s"], part[name], "" if dotted else method, *styles[method]) for method, part in parts.items()]

    steps = sorted(set(table["step_s"]))
    noise, bias = [*build_lines("gyro_ratio"), *build_lines("spread_ratio", dotted=True)], build_lines("held_sigma")
    noise.append(panels.make_power_law(steps, 0.5, label="sqrt Δt"))
    axes: dict[str, Any] = {"x": "step Δt (s)", "ticks": steps}
    legend: dict[str, Any] = {"legend": "upper left", "legend_title": "solid: gyro's part; dotted: all"}
    inside = (table["nees_lower"].iloc[0], table["nees_upper"].iloc[0])
    return panels.build_sheet(
        panels.make_curves(noise, log="xy", title="noise / that of the full stream", **legend, **axes),
        panels.make_curves(bias, log="xy", levels=[LIMIT], title="bias without noise (formal sigma)", **axes),
        panels.make_curves(build_lines("nees"), inside, log="x", title="mean NEES; grey: 99 % bounds", **axes),
        size=(9.6, 3.2),
    )
