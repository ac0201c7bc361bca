"""The study's report: the flight's table under the present baseline and deliberately wrong ones, and simulated tables."""

from dataclasses import replace
from functools import cache
from typing import Any

import pandas as pd

from simulator.scenario import Scenario
from studies.montecarlo.statistics import compute_binomial_interval
from studies.natanson import flight
from studies.natanson.flight_diagnosis.builder import NOISE, RATE, TIMING, YAW
from studies.natanson.flight_diagnosis.diagnosis import FALSE_ALARM, NAMING_PROBABILITY, TableDiagnosis, diagnose
from studies.natanson.flight_diagnosis.misfit_numbers import locate_misfit
from studies.natanson.flight_diagnosis.simulated_tables import STUDY, FlightConfig
from studies.natanson.flight_diagnosis.table import Baseline, load_present_baseline, read_flight_residual_table, reverse_slews
from studies.natanson.flight_diagnosis.timings import RAMPS, replace_slew_timings
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS
from studies.printed_table import UNKNOWN_NAME
from studies.report.checks import Check, bound_above, bound_below, bound_near
from studies.report.entry import Entry, Report
from studies.report.tables import Table, summarise_groups

CENTRED_RATE_DEG_S, CENTRED_STAY_S = 0.2, 3600.0  # peak rate, and time between the slews of interval 4


@cache
def list_trial_baselines() -> tuple[Baseline, ...]:
    """The present baseline first, then the deliberately wrong ones."""
    right = load_present_baseline()

    def wrong(name: str, effect: str, *flips: int) -> Baseline:
        sections = tuple(reverse_slews(s) if k in flips else s for k, s in enumerate(right.scenario.interval))
        return Baseline(name, right.scenario.model_copy(update={"interval": sections}), done=frozenset({effect}))

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


def count_outcomes_by_kind(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per kind of simulated table: detected, rightly named, wrongly named."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        return {
            "tables": len(part),
            "gap_found": int((part["verdict"] != "none").sum()),
            "right": int(part["right"].sum()),
            "in_group": int((part["in_group"] & ~part["right"]).sum()),
            "false_name": int(part["false_name"].sum()),
        }

    return summarise_groups(rows, ["kind"], line)


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
    table = count_outcomes_by_kind(rows)
    out = []
    for nothing in table[table["kind"] == "nothing"].to_dict("records"):
        alarms, count = nothing["gap_found"], nothing["tables"]
        name = f"stated rate of false alarms, for {alarms} of {count} tables"
        out.append(Check(name, FALSE_ALARM, compute_binomial_interval(alarms, count), "", SIMULATED))
    effects = table[table["kind"] != "nothing"].drop(columns="kind").sum()
    count = int(effects["tables"])
    if count:
        out += [
            Check(f"gaps found of {count} tables with an effect", int(effects["gap_found"]), bound_below(0.9 * count)),
            Check("rightly named", int(effects["right"]), bound_below(0.9 * count)),
            Check("more in a group", int(effects["in_group"])),
            Check("with a wrong name", int(effects["false_name"]), bound_above((1 - NAMING_PROBABILITY) * count)),
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
