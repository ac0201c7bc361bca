"""The study's report: checks, tables and figures."""

from typing import Any

import numpy as np
import pandas as pd

from studies.montecarlo.statistics import compute_binomial_interval
from studies.natanson import flight
from studies.natanson.flight_diagnosis.baselines import (
    compute_misfit_rms,
    compute_whitened_misfit,
    diagnose_under_baseline,
    list_trial_baselines,
)
from studies.natanson.flight_diagnosis.diagnosis import FALSE_ALARM, NAMING_PROBABILITY
from studies.natanson.flight_diagnosis.misfit_numbers import compute_misfit_by_step, compute_motion_numbers, locate_misfit
from studies.natanson.flight_diagnosis.simulated_tables import STUDY, FlightConfig
from studies.natanson.flight_diagnosis.table import Baseline, read_flight_residual_table
from studies.printed_table import UNKNOWN_NAME
from studies.report.checks import Check, bound_above, bound_below, bound_near
from studies.report.entry import Entry, Report
from studies.report.panels import DARK, GREY, RED, TEAL, Draw, Line, build_sheet, make_curves
from studies.report.tables import Table, summarise_groups

WORTH_SHOWING = 1e-4  # probability of a set of effects

PREDICTED_GAP_NOTE = (
    "Flown minus predicted; what the explanation leaves must be between the gap and the flight's residuals after calibration."
)
WRONG_BASELINE_NOTE = (
    "A baseline made wrong on purpose must be blamed for that and nothing else, whatever is unknown beside it."
)
ROUNDED_RESIDUALS_NOTE = (
    "Rounded residuals are not the gap's cause if it keeps its sign in the columns at 1 and 2 s, which were rounded anew."
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
    places, columns = locate_misfit(read_flight_residual_table(), first), compute_misfit_by_step()
    places = places[places["p_holm"] < FALSE_ALARM]
    gaps = columns["gap_deg"].to_numpy().reshape(len(flight.FLIGHT_STEPS_S), -1)[:, places.index]
    steady = int((np.sign(gaps) == np.sign(gaps[0])).all(axis=0).sum())
    others = columns[columns["step_s"] > flight.FLIGHT_STEPS_S[0]]
    far = others.iloc[int((others["gap_deg"] / others["sigma_deg"]).abs().to_numpy().argmax())]
    other = f"gap at {far['step_s']:g} s, interval {far['interval']}, {far['axis']}"
    explained = (rms["floor"], rms["before"])
    return [
        Check("verdict under the present baseline", found.verdict),
        Check("its causes", " + ".join(found.causes) or "none", "none"),
        Check("probability that something unknown is at work", found.includes(UNKNOWN_NAME)),
        *(Check(f"size of what is {one.label}", one.size, None, "deg") for one in found.fitted if one.process),
        Check("gap, RMS", rms["before"], None, "deg", PREDICTED_GAP_NOTE),
        Check(f"gap with {found.best}, RMS", rms["after"], explained, "deg"),
        Check("residuals after calibration, RMS", rms["floor"], None, "deg"),
        Check("numbers of 18 in which the gap stands out", len(places)),
        Check("of these with one sign at all steps", steady, (len(places), len(places)), "", ROUNDED_RESIDUALS_NOTE),
        Check(f"{other}, as printed", far["gap_deg"], None, "deg"),
        Check(
            f"{other}, with the other sign of its residual after calibration",
            far["gap_deg"] + 2 * far["after_deg"], bound_near(0.0, 4 * far["sigma_deg"]), "deg",
        ),
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
    first, yaw, *_ = list_trial_baselines()
    timings = [
        {"baseline": trial.name, "of": one.axis, "timing": name, "value": value, "sigma_over_that_of_prior": sigma}
        for trial in list_trial_baselines()
        for one in diagnose_under_baseline(trial).fitted
        for (name, value), sigma in zip(one.parameters.items(), one.sigmas, strict=False)
    ]
    left = [
        {"baseline": trial.name, **compute_whitened_misfit(diagnose_under_baseline(trial))} for trial in list_trial_baselines()
    ]
    sets = [
        {"baseline": trial.name, "effects": " + ".join(sorted(effects)) or "nothing", "probability": p}
        for trial in list_trial_baselines()
        for effects, p in diagnose_under_baseline(trial).sets.items()
        if p > WORTH_SHOWING
    ]
    tables = {
        "baselines": Table(
            "The flight's table under each baseline", pd.DataFrame([_describe_trial(trial) for trial in list_trial_baselines()])
        ),
        "where": Table("Where, under the present baseline", locate_misfit(read_flight_residual_table(), first)),
        "gap_by_step": Table("The gap at each step", compute_misfit_by_step()),
        "whitened_gap": Table("Mean square of the whitened gap", pd.DataFrame(left)),
        "timings": Table("Timings of the likeliest explanation", pd.DataFrame(timings)),
        "sets": Table("Sets of effects under each baseline", pd.DataFrame(sets)),
        "simulated": Table("Simulated tables", count_outcomes_by_kind(rows)),
    }
    figures = {
        "flight_table": _draw_misfit_figure(first),
        "flight_table_wrong_yaw": _draw_misfit_figure(yaw),
    }
    return Report(tables, figures, (*_build_flight_checks(), *_build_simulated_checks(rows)))


ENTRY = Entry(STUDY, "N Table 2 diagnosed: what parts predicted from flown pre-launch residuals", make_report)


def _draw_misfit_figure(trial: Baseline) -> Draw:
    """Flown and predicted residuals above; below flown minus predicted before and after, and the flight's after calibration."""
    found, table = diagnose_under_baseline(trial), read_flight_residual_table()
    before, after = (values.reshape(6, 3) + table.after for values in (found.before, found.after))
    sigma = np.sqrt(np.diag(found.covariance)).reshape(6, 3)
    prediction = compute_motion_numbers(table, trial).prediction
    x = np.arange(1, 7)
    above, below = [], []
    for j, name in enumerate(flight.ROTATIONS):
        residuals = [
            Line(x, prediction[:, j], "predicted", TEAL, "_", size=13.0),
            Line(x, (table.before - after)[:, j], "with the explanation", DARK, "x", size=5.0),
            Line(x, table.before[:, j], "flown", RED, "o"),
        ]
        gaps = [Line(x, table.after[:, j], "flown, after calibration", GREY, "_", size=13.0)]
        for place, values, label, colour in ((-0.15, before, "gap before", TEAL), (0.15, after, "gap after", DARK)):
            y, width = values[:, j], sigma[:, j]
            gaps.append(Line(x + place, y, label, colour, "o", y - width, y + width, bars=True))
        legend = "best" if j == 2 else ""
        above.append(make_curves(residuals, title=name, y="" if j else "residual (deg)", ticks=x.tolist(), legend=legend))
        axes: dict[str, Any] = {"x": "calibration interval", "y": "" if j else "flown − predicted (deg)", "levels": (0.0,)}
        below.append(make_curves(gaps, ticks=x.tolist(), legend=legend, **axes))
    title = f"Baseline: {trial.name}; explanation: {found.best}; bars: 1σ of print"
    return build_sheet(*above, *below, size=(9.0, 5.0), columns=3, title=title)
