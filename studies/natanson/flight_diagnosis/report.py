"""The study: diagnoses of simulated tables with a known cause, and of the flight's table under right and wrong baselines."""

from dataclasses import replace
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np
import pandas as pd
from pydantic import model_validator

from simulator.scenario import IntervalSection, Scenario
from studies.montecarlo.statistics import compute_binomial_interval
from studies.montecarlo.study import GridConfig, Streams, Study
from studies.natanson import flight
from studies.natanson.flight_diagnosis.diagnosis import (
    FALSE_ALARM,
    NAMING_PROBABILITY,
    NOISE,
    RATE,
    TIMING,
    YAW,
    TableDiagnosis,
    diagnose,
)
from studies.natanson.flight_diagnosis.table import (
    CELL_DEG,
    CLOCK_S,
    INITIAL_DIGITS,
    PUBLISHED_DIGITS,
    Baseline,
    ResidualTable,
    differentiate_by_clock,
    load_present_baseline,
    locate_misfit,
    read_flight_residual_table,
    reverse_intervals,
    round_to_digits,
    simulate_residuals,
)
from studies.natanson.flight_diagnosis.timings import SLEWING, TIMING_NAMES, compute_timings, replace_slew_timings
from studies.natanson.flight_gap import MINUS_Y
from studies.report.checks import Check, bound_above, bound_below, bound_near
from studies.report.entry import Entry, Report
from studies.report.tables import Table

UNKNOWN = "unknown"
CAUSE_BY_KIND = {"nothing": "", "yaw of 2": YAW, "rate sign": RATE, "timings": TIMING, "noise x3": NOISE, UNKNOWN: ""}
REVERSED_INTERVALS = {"yaw of 2": (1,), "rate sign": (MINUS_Y,)}
UNKNOWN_SIMULATED_DEG = 0.05
LATE_SLEWS = (0.9, 0.1, 0.9, 0.1)  # timings of the wrong baseline, as numbers between zero and one


def simulate_table(kind: str, baseline: Baseline, rng: np.random.Generator) -> ResidualTable:
    """Simulate a table as the paper prints it: noise, a least-squares calibration, and rounded numbers."""
    sections = reverse_intervals(baseline.scenario.interval, REVERSED_INTERVALS.get(kind, ()))
    if kind == "timings":
        sections = replace_timings(sections, {k: rng.random(len(TIMING_NAMES[k])) for k in SLEWING})
    total, gyro = (replace(baseline, noise_factor=3.0) if kind == "noise x3" else baseline).compute_variances()
    theta, Theta = simulate_residuals(sections)
    for k, section in enumerate(sections):
        theta[k] += differentiate_by_clock(section) @ rng.uniform(-0.5, 0.5, 2) * CLOCK_S  # Table 1 rounds the times
    H = Theta.reshape(18, 12)
    noise = rng.normal(size=(6, 3)) * np.sqrt(total)[:, None]
    scale = np.linalg.norm(H, axis=0)
    error = np.linalg.lstsq(H / scale, noise.ravel(), rcond=None)[0] / scale
    rounding = H @ (INITIAL_DIGITS * rng.uniform(-0.5, 0.5, 12))  # the parameters used have more digits than Table 3
    before = theta + noise + rounding.reshape(6, 3)
    if kind == UNKNOWN:
        before[rng.integers(6)] += rng.normal(size=3) * UNKNOWN_SIMULATED_DEG
    steps = rng.normal(size=(2, 6, 3)) * np.sqrt(gyro[:, None] * np.array([1.0, 2.0])[:, None, None])
    coarser = before + np.cumsum(steps, axis=0)
    after = noise - (H @ error).reshape(6, 3)
    published = flight.read_published_calibration().vector - error
    before, after, coarser = (round_to_digits(values, CELL_DEG) for values in (before, after, coarser))
    return ResidualTable(before, after, coarser, round_to_digits(published, PUBLISHED_DIGITS))


def replace_timings(sections: tuple[IntervalSection, ...], timings: dict[int, Any]) -> tuple[IntervalSection, ...]:
    """Replace the slew timings of intervals, given as numbers between zero and one."""
    out = list(sections)
    for k, u in timings.items():
        out[k] = replace_slew_timings(out[k], *compute_timings(out[k], u))
    return tuple(out)


class FlightConfig(GridConfig):
    """The simulated tables."""

    axes: ClassVar = ("nothing", "each")
    nothing: int = 200  # tables of the baseline itself
    each: int = 10  # tables of every other kind

    @model_validator(mode="after")
    def _require_flight_scenario(self) -> Self:
        if self.scenario != "trmm" and not isinstance(self.scenario, Scenario):
            raise ValueError('the flight\'s table belongs to the scenario "trmm"')
        if self.overrides:
            raise ValueError("the flight's table is diagnosed under the scenario as it is, without overrides")
        return self

    def points(self) -> list[str]:
        """List the kind of each case."""
        return [kind for kind in CAUSE_BY_KIND for _ in range(self.nothing if kind == "nothing" else self.each)]


def run_case(config: FlightConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Diagnose one simulated table."""
    kind = config.points()[number]
    diagnosis = diagnose(simulate_table(kind, load_present_baseline(), streams.generator("table")), load_present_baseline())
    causes, truth = set(diagnosis.causes), {CAUSE_BY_KIND[kind]} - {""}
    right_verdict = {"nothing": "none", UNKNOWN: "unknown"}.get(kind, "named")
    return {
        "kind": kind,
        "verdict": diagnosis.verdict,
        "causes": ", ".join(diagnosis.causes),
        "likeliest": diagnosis.best,
        "p_value": diagnosis.gap["p_value"],
        "right": diagnosis.verdict == right_verdict and causes == truth,
        "false_name": bool(causes - truth),
    }


STUDY = Study("studies.natanson.flight_diagnosis:STUDY", FlightConfig, run_case)


@cache
def list_trial_baselines() -> tuple[Baseline, ...]:
    """List the present baseline first, then the deliberately wrong ones."""
    present = load_present_baseline()
    sections = present.scenario.interval

    def build_baseline(name: str, effect: str, intervals: tuple[IntervalSection, ...]) -> Baseline:
        return Baseline(name, present.scenario.model_copy(update={"interval": intervals}), wrong=effect)

    return (
        present,
        build_baseline("yaw of 2 reversed", YAW, reverse_intervals(sections, (1,))),
        build_baseline("rate of 4 at +1 RPO", RATE, reverse_intervals(sections, (MINUS_Y,))),
        build_baseline("late, smooth slews in 4", TIMING, replace_timings(sections, {MINUS_Y: LATE_SLEWS})),
        replace(present, name="noise three times", noise_factor=3.0, wrong=NOISE),
    )


@cache
def diagnose_under_baseline(trial: Baseline) -> TableDiagnosis:
    """Diagnose the flight's table under one baseline."""
    return diagnose(read_flight_residual_table(), trial)


def compute_misfit_rms(diagnosis: TableDiagnosis) -> dict[str, float]:
    """Compute the RMS of flown minus predicted, before and after the explanation, and of the calibrated residuals."""
    calibrated = read_flight_residual_table().after.ravel()
    values = {"before": diagnosis.before + calibrated, "after": diagnosis.after + calibrated, "floor": calibrated}
    return {name: float(flight.compute_rms(value)) for name, value in values.items()}


PREDICTED_GAP_NOTE = (
    "The gap is flown minus predicted; with the motion right it would be the flight's residuals after calibration, its floor."
)
WRONG_BASELINE_NOTE = "A baseline made wrong on purpose must be blamed for that and nothing else."
SIMULATED_NOTE = "The tables are simulated as the paper would print them, of a known cause or of none."


def _build_flight_checks() -> list[Check]:
    """Build the checks of the flight's table, under the present baseline and the wrong ones."""
    present, *wrong_baselines = list_trial_baselines()
    diagnosis, rms = diagnose_under_baseline(present), compute_misfit_rms(diagnose_under_baseline(present))
    places = locate_misfit(read_flight_residual_table(), present)
    return [
        Check("verdict under the present baseline", diagnosis.verdict),
        Check("its causes", " + ".join(diagnosis.causes) or "none", "none"),
        *(Check(f"size of what is {effect.label}", effect.size, None, "deg") for effect in diagnosis.fitted if effect.process),
        Check("gap, RMS", rms["before"], None, "deg", PREDICTED_GAP_NOTE),
        Check("its floor, RMS", rms["floor"], None, "deg"),
        Check("numbers of 18 in which the gap stands out", int((places["p_holm"] < FALSE_ALARM).sum())),
        Check("noise over the stated one", diagnosis.noise[0], bound_near(1.0, 4 * diagnosis.noise[1])),
        *(
            Check(
                f"causes with {trial.name}",
                " + ".join(diagnose_under_baseline(trial).causes),
                trial.wrong,
                meaning=WRONG_BASELINE_NOTE,
            )
            for trial in wrong_baselines
        ),
    ]


def _build_simulated_checks(rows: pd.DataFrame) -> list[Check]:
    """Count the simulated tables that are detected, rightly named and wrongly named."""
    is_nothing, is_gap = rows["kind"] == "nothing", rows["verdict"] != "none"
    checks: list[Check] = []
    alarms, tables = int((is_gap & is_nothing).sum()), int(is_nothing.sum())
    if tables:
        name = f"stated rate of false alarms, for {alarms} of {tables} tables"
        checks.append(Check(name, FALSE_ALARM, compute_binomial_interval(alarms, tables), "", SIMULATED_NOTE))
    effects = rows[~is_nothing]
    if count := len(effects):
        checks += [
            Check(f"gaps found of {count} tables with an effect", int(is_gap[~is_nothing].sum()), bound_below(0.9 * count)),
            Check("rightly named", int(effects["right"].sum()), bound_below(0.9 * count)),
            Check("with a wrong name", int(effects["false_name"].sum()), bound_above((1 - NAMING_PROBABILITY) * count)),
        ]
    return checks


def _describe_trial(trial: Baseline) -> dict[str, Any]:
    """Build the row of the flight's diagnosis under a baseline."""
    diagnosis, rms = diagnose_under_baseline(trial), compute_misfit_rms(diagnose_under_baseline(trial))
    return {
        "baseline": trial.name,
        "verdict": diagnosis.verdict,
        "likeliest": diagnosis.best,
        "unknown_probability": diagnosis.unknown,
        "before_deg": rms["before"],
        "after_deg": rms["after"],
        "noise_factor": diagnosis.noise[0],
    }


def make_report(config: FlightConfig, rows: pd.DataFrame) -> Report:
    """Report the flight's table under every baseline, and the diagnoses of simulated tables."""
    present, *_ = list_trial_baselines()
    trials = pd.DataFrame([_describe_trial(trial) for trial in list_trial_baselines()])
    tables = {
        "baselines": Table("The flight's table under each baseline", trials),
        "where": Table("Where, under the present baseline", locate_misfit(read_flight_residual_table(), present)),
    }
    return Report(tables, checks=(*_build_flight_checks(), *_build_simulated_checks(rows)))


ENTRY = Entry(STUDY, "N Table 2 diagnosed: causes of the difference between predicted and flown residuals", make_report)
