"""The study: simulated tables of a known cause, diagnosed, and the flight's table under right and wrong baselines."""

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
    Effects,
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
    simulate_each_interval,
)
from studies.natanson.flight_diagnosis.timings import RAMPS, TIMINGS, replace_slew_timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS
from studies.printed_table import UNKNOWN_NAME
from studies.report.checks import Check, bound_above, bound_below, bound_near
from studies.report.entry import Entry, Report
from studies.report.tables import Table

EFFECTS_BY_KIND: dict[str, Effects] = {
    "nothing": frozenset(),
    "yaw of 2": frozenset({YAW}),
    "yaw of 6": frozenset({YAW}),
    "both yaws": frozenset({YAW}),
    "rate sign": frozenset({RATE}),
    "one timing": frozenset({TIMING}),
    "four timings": frozenset({TIMING}),
    "common timing": frozenset({TIMING}),
    "noise x3": frozenset({NOISE}),
    "noise /3": frozenset({NOISE}),
    "unknown": frozenset({UNKNOWN_NAME}),
    "yaw of 2, four timings": frozenset({YAW, TIMING}),
}
UNKNOWN_SIMULATED_DEG = 0.05


def draw_flown_intervals(kind: str, scenario: Scenario, rng: np.random.Generator) -> tuple[IntervalSection, ...]:
    """Draw the six intervals of a simulated table: random timings and reversed slews as its kind requires."""
    sections = list(scenario.interval)
    *by_interval, common = TIMINGS
    varied = by_interval if "four" in kind else [common] if kind == "common timing" else []
    if kind == "one timing":
        varied = [by_interval[rng.integers(len(by_interval))]]
    for timings in varied:
        for k, section in timings.apply_timings(sections, rng.random(len(timings.names))).items():
            sections[k] = section
    reversals = {"yaw of 2": (1,), "yaw of 6": (5,), "both yaws": (1, 5), "rate sign": (3,), "yaw of 2, four timings": (1,)}
    return reverse_intervals(sections, reversals.get(kind, ()))


def simulate_table(kind: str, baseline: Baseline, rng: np.random.Generator) -> ResidualTable:
    """A table as the paper would print it: noise, least squares for the twelve parameters, and every number rounded."""
    sections = draw_flown_intervals(kind, baseline.scenario, rng)
    factor = {"noise x3": 3.0, "noise /3": 1 / 3}.get(kind, 1.0)
    total, gyro = (factor**2 * v for v in baseline.variances())
    theta, Theta = simulate_each_interval(sections)
    for k, section in enumerate(sections):
        theta[k] += differentiate_by_clock(section) @ rng.uniform(-0.5, 0.5, 2) * CLOCK_S  # Table 1 rounds the times
    H = Theta.reshape(18, 12)
    noise = rng.normal(size=(6, 3)) * np.sqrt(total)[:, None]
    scale = np.linalg.norm(H, axis=0)
    error = np.linalg.lstsq(H / scale, noise.ravel(), rcond=None)[0] / scale
    used = H @ (INITIAL_DIGITS * rng.uniform(-0.5, 0.5, 12))  # what was used has more digits than Table 3
    before = theta + noise + used.reshape(6, 3)
    if kind == "unknown":
        before[rng.integers(6)] += rng.normal(size=3) * UNKNOWN_SIMULATED_DEG
    steps = rng.normal(size=(2, 6, 3)) * np.sqrt(gyro[:, None] * np.array([1.0, 2.0])[:, None, None])
    coarser = before + np.cumsum(steps, axis=0)
    after = noise - (H @ error).reshape(6, 3)
    published = flight.read_published_calibration().vector - error
    before, after, coarser = (round_to_digits(values, CELL_DEG) for values in (before, after, coarser))
    return ResidualTable(before, after, coarser, round_to_digits(published, PUBLISHED_DIGITS))


class FlightConfig(GridConfig):
    """The simulated tables."""

    axes: ClassVar = ("nothing", "each")
    nothing: int = 200  # tables made of the baseline itself
    each: int = 5  # tables of every other kind

    @model_validator(mode="after")
    def _require_flight_scenario(self) -> Self:
        if self.scenario != "trmm" and not isinstance(self.scenario, Scenario):
            raise ValueError('the flight\'s table belongs to the scenario "trmm"')
        if self.overrides:
            raise ValueError("the flight's table is diagnosed under the scenario as it is, without overrides")
        return self

    def points(self) -> list[str]:
        """Kind of each case."""
        return [kind for kind in EFFECTS_BY_KIND for _ in range(self.each if EFFECTS_BY_KIND[kind] else self.nothing)]


def run_case(config: FlightConfig, number: int, streams: Streams) -> dict[str, Any]:
    """Diagnose one simulated table."""
    kind = config.points()[number]
    truth = EFFECTS_BY_KIND[kind]
    found = diagnose(simulate_table(kind, load_present_baseline(), streams.generator("table")), load_present_baseline())
    likeliest = next(iter(found.sets))
    named = frozenset(found.causes)
    unnamed = {frozenset[str](): "none", frozenset({UNKNOWN_NAME}): "unknown"}  # verdicts on truths without a listed effect
    return {
        "kind": kind,
        "verdict": found.verdict,
        "causes": ", ".join(found.causes),
        "p_value": found.gap["p_value"],
        "right": found.verdict == unnamed[truth] if truth in unnamed else named == truth,
        "in_group": truth in found.group,
        "false_name": bool(named - truth),
        "likeliest": " + ".join(sorted(likeliest)) or "nothing",
        "truth_probability": found.sets.get(truth, 0.0),
    }


STUDY = Study("studies.natanson.flight_diagnosis:STUDY", FlightConfig, run_case)


CENTRED_RATE_DEG_S, CENTRED_STAY_S = 0.2, 3600.0  # peak rate, and time between the slews of interval 4


@cache
def list_trial_baselines() -> tuple[Baseline, ...]:
    """The present baseline first, then the deliberately wrong ones."""
    right = load_present_baseline()

    def wrong(name: str, effect: str, *flips: int) -> Baseline:
        scenario = right.scenario.model_copy(update={"interval": reverse_intervals(right.scenario.interval, flips)})
        return Baseline(name, scenario, done=frozenset({effect}))

    return (
        right,
        wrong("yaw of 2 reversed", YAW, 1),
        wrong("yaw of 6 reversed", YAW, 5),
        wrong("both yaws reversed", YAW, 1, 5),
        wrong("rate of 4 at +1 RPO", RATE, MINUS_Y),
        Baseline("slews centred and smooth", centre_slews(right.scenario), done=frozenset({TIMING})),
        replace(right, name="noise three times", noise_factor=3.0, done=frozenset({NOISE})),
        replace(right, name="noise a third", noise_factor=1 / 3, done=frozenset({NOISE})),
    )


def centre_slews(scenario: Scenario) -> Scenario:
    """Slews in the middle of their intervals and nothing but ramps, as slow as the rate of the assumed ones peaks."""
    sections = list(scenario.interval)
    for k in (*YAW_INTERVALS, MINUS_Y):
        section, stay = sections[k], CENTRED_STAY_S if k == MINUS_Y else 0.0
        length = section.stop_s - section.start_s
        duration = min(abs(section.slew[0].angle_deg) / CENTRED_RATE_DEG_S, 0.95 * length)
        sections[k] = replace_slew_timings(section, 0.5 * (length - duration - stay), duration, RAMPS[1], stay)
    return scenario.model_copy(update={"interval": tuple(sections)})


@cache
def diagnose_under_baseline(trial: Baseline) -> TableDiagnosis:
    """Diagnose the flight's table under one baseline."""
    return diagnose(read_flight_residual_table(), trial)


def compute_misfit_rms(found: TableDiagnosis) -> dict[str, float]:
    """RMS of flown minus predicted, before and after the explanation, and of the flight's residuals after calibration."""
    left = read_flight_residual_table().after.ravel()
    values = {"before": found.before + left, "after": found.after + left, "floor": left}
    return {name: float(flight.compute_rms(value)) for name, value in values.items()}


PREDICTED_GAP_NOTE = (
    "Flown minus predicted; what the explanation leaves must be between the gap and the flight's residuals after calibration."
)
WRONG_BASELINE_NOTE = (
    "A baseline made wrong on purpose must be blamed for that and nothing else, whatever is unknown beside it."
)
SIMULATED = "Tables as the paper would print them, simulated from the baseline, of a known cause or of none."


def _build_flight_checks() -> list[Check]:
    first, *wrong = list_trial_baselines()
    found, rms = diagnose_under_baseline(first), compute_misfit_rms(diagnose_under_baseline(first))
    places = locate_misfit(read_flight_residual_table(), first)
    explained = (rms["floor"], rms["before"])
    return [
        Check("verdict under the present baseline", found.verdict),
        Check("its causes", " + ".join(found.causes) or "none", "none"),
        Check("probability that something unknown is at work", found.includes(UNKNOWN_NAME)),
        *(Check(f"size of what is {one.label}", one.size, None, "deg") for one in found.fitted if one.process),
        Check("gap, RMS", rms["before"], None, "deg", PREDICTED_GAP_NOTE),
        Check(f"gap with {found.best}, RMS", rms["after"], explained, "deg"),
        Check("residuals after calibration, RMS", rms["floor"], None, "deg"),
        Check("numbers of 18 in which the gap stands out", int((places["p_holm"] < FALSE_ALARM).sum())),
        Check("noise over the stated one", found.noise[0], bound_near(1.0, 4 * found.noise[1])),
        *(
            Check(
                f"causes with {trial.name}", " + ".join(diagnose_under_baseline(trial).causes), " + ".join(trial.done), "",
                WRONG_BASELINE_NOTE,
            )
            for trial in wrong
        ),
    ]  # fmt: skip


def _build_simulated_checks(rows: pd.DataFrame) -> list[Check]:
    """How many simulated tables are detected, rightly named and wrongly named."""
    is_nothing, is_gap = rows["kind"] == "nothing", rows["verdict"] != "none"
    out: list[Check] = []
    alarms, tables = int((is_gap & is_nothing).sum()), int(is_nothing.sum())
    if tables:
        name = f"stated rate of false alarms, for {alarms} of {tables} tables"
        out.append(Check(name, FALSE_ALARM, compute_binomial_interval(alarms, tables), "", SIMULATED))
    effects, gaps, count = rows[~is_nothing], int((is_gap & ~is_nothing).sum()), int((~is_nothing).sum())
    if count:
        in_group = effects["in_group"] & ~effects["right"]
        out += [
            Check(f"gaps found of {count} tables with an effect", gaps, bound_below(0.9 * count)),
            Check("rightly named", int(effects["right"].sum()), bound_below(0.9 * count)),
            Check("more in a group", int(in_group.sum())),
            Check("with a wrong name", int(effects["false_name"].sum()), bound_above((1 - NAMING_PROBABILITY) * count)),
        ]
    return out


def _describe_trial(trial: Baseline) -> dict[str, Any]:
    found, rms = diagnose_under_baseline(trial), compute_misfit_rms(diagnose_under_baseline(trial))
    return {
        "baseline": trial.name,
        "done": " + ".join(trial.done) or "nothing",
        "verdict": found.verdict,
        "causes": " + ".join(found.causes) or "none",
        "likeliest": found.best,
        "unknown_probability": found.includes(UNKNOWN_NAME),
        **{f"{name}_deg": value for name, value in rms.items()},
        "noise_factor": found.noise[0],
    }


def make_report(config: FlightConfig, rows: pd.DataFrame) -> Report:
    """The flight's table under every baseline, and what simulated tables say of the diagnosis."""
    first, *_ = list_trial_baselines()
    trials = pd.DataFrame([_describe_trial(trial) for trial in list_trial_baselines()])
    tables = {
        "baselines": Table("The flight's table under each baseline", trials),
        "where": Table("Where, under the present baseline", locate_misfit(read_flight_residual_table(), first)),
    }
    return Report(tables, checks=(*_build_flight_checks(), *_build_simulated_checks(rows)))


ENTRY = Entry(STUDY, "N Table 2 diagnosed: what parts predicted from flown pre-launch residuals", make_report)
