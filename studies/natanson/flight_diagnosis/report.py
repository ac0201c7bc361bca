"""The study's report: checks, tables and figures."""

from typing import Any

import numpy as np
import pandas as pd

from studies.montecarlo.statistics import binomial_interval
from studies.natanson import flight
from studies.natanson.flight_diagnosis.baselines import examine, rms_deg, trials, whitened
from studies.natanson.flight_diagnosis.diagnosis import FALSE_ALARM, SURE
from studies.natanson.flight_diagnosis.numbers import by_step, motion, where
from studies.natanson.flight_diagnosis.simulated_tables import STUDY, FlightConfig
from studies.natanson.flight_diagnosis.table import Baseline, flown
from studies.printed_table import UNKNOWN
from studies.report.checks import Check, at_least, at_most, near
from studies.report.entry import Entry, Report
from studies.report.panels import DARK, GREY, RED, TEAL, Draw, Line, curves, sheet
from studies.report.tables import Table, by_group

WORTH_SHOWING = 1e-4  # probability of a set of effects

GAP = "Flown minus predicted; what the explanation leaves must be between the gap and the flight's residuals after calibration."
WRONG = "A baseline made wrong on purpose must be blamed for that and nothing else, whatever is unknown beside it."
STEPS = "Rounded residuals are not the gap's cause if it keeps its sign in the columns at 1 and 2 s, which were rounded anew."
SIMULATED = "Tables as the paper would print them, simulated from the baseline, of a known cause or of none."


def power(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per kind of simulated table: detected, rightly named, wrongly named."""

    def line(part: pd.DataFrame) -> dict[str, object]:
        return {
            "tables": len(part),
            "gap_found": int((part["verdict"] != "none").sum()),
            "right": int(part["right"].sum()),
            "in_group": int((part["in_group"] & ~part["right"]).sum()),
            "false_name": int(part["false_name"].sum()),
        }

    return by_group(rows, ["kind"], line)


def _flight_checks() -> list[Check]:
    first, *wrong = trials()
    found, rms = examine(first), rms_deg(examine(first))
    places, columns = where(flown(), first), by_step()
    places = places[places["p_holm"] < FALSE_ALARM]
    gaps = columns["gap_deg"].to_numpy().reshape(len(flight.STEPS), -1)[:, places.index]
    steady = int((np.sign(gaps) == np.sign(gaps[0])).all(axis=0).sum())
    others = columns[columns["step_s"] > flight.STEPS[0]]
    far = others.iloc[int((others["gap_deg"] / others["sigma_deg"]).abs().to_numpy().argmax())]
    other = f"gap at {far['step_s']:g} s, interval {far['interval']}, {far['axis']}"
    explained = (rms["floor"], rms["before"])
    return [
        Check("verdict under the present baseline", found.verdict),
        Check("its causes", " + ".join(found.causes) or "none", "none"),
        Check("probability that something unknown is at work", found.includes(UNKNOWN)),
        *(Check(f"size of what is {one.label}", one.size, None, "deg") for one in found.fitted if one.process),
        Check("gap, RMS", rms["before"], None, "deg", GAP),
        Check(f"gap with {found.best}, RMS", rms["after"], explained, "deg"),
        Check("residuals after calibration, RMS", rms["floor"], None, "deg"),
        Check("numbers of 18 in which the gap stands out", len(places)),
        Check("of these with one sign at all steps", steady, (len(places), len(places)), "", STEPS),
        Check(f"{other}, as printed", far["gap_deg"], None, "deg"),
        Check(
            f"{other}, with the other sign of its residual after calibration",
            far["gap_deg"] + 2 * far["after_deg"], near(0.0, 4 * far["sigma_deg"]), "deg",
        ),
        Check("noise over the stated one", found.noise[0], near(1.0, 4 * found.noise[1])),
        *(
            Check(f"causes with {trial.name}", " + ".join(examine(trial).causes), " + ".join(trial.done), "", WRONG)
            for trial in wrong
        ),
    ]  # fmt: skip


def _simulated_checks(rows: pd.DataFrame) -> list[Check]:
    table = power(rows)
    out = []
    for nothing in table[table["kind"] == "nothing"].to_dict("records"):
        alarms, count = nothing["gap_found"], nothing["tables"]
        name = f"stated rate of false alarms, for {alarms} of {count} tables"
        out.append(Check(name, FALSE_ALARM, binomial_interval(alarms, count), "", SIMULATED))
    effects = table[table["kind"] != "nothing"].drop(columns="kind").sum()
    count = int(effects["tables"])
    if count:
        out += [
            Check(f"gaps found of {count} tables with an effect", int(effects["gap_found"]), at_least(0.9 * count)),
            Check("rightly named", int(effects["right"]), at_least(0.9 * count)),
            Check("more in a group", int(effects["in_group"])),
            Check("with a wrong name", int(effects["false_name"]), at_most((1 - SURE) * count)),
        ]
    return out


def _row(trial: Baseline) -> dict[str, Any]:
    found, rms = examine(trial), rms_deg(examine(trial))
    return {
        "baseline": trial.name,
        "done": " + ".join(trial.done) or "nothing",
        "verdict": found.verdict,
        "causes": " + ".join(found.causes) or "none",
        "likeliest": found.best,
        "unknown_probability": found.includes(UNKNOWN),
        **{f"{name}_deg": value for name, value in rms.items()},
        "noise_factor": found.noise[0],
    }


def make_report(config: FlightConfig, rows: pd.DataFrame) -> Report:
    """The flight's table under every baseline, and what simulated tables say of the diagnosis."""
    first, yaw, *_ = trials()
    timings = [
        {"baseline": trial.name, "of": one.axis, "timing": name, "value": value, "sigma_over_that_of_prior": sigma}
        for trial in trials()
        for one in examine(trial).fitted
        for (name, value), sigma in zip(one.parameters.items(), one.sigmas, strict=False)
    ]
    left = [{"baseline": trial.name, **whitened(examine(trial))} for trial in trials()]
    sets = [
        {"baseline": trial.name, "effects": " + ".join(sorted(effects)) or "nothing", "probability": p}
        for trial in trials()
        for effects, p in examine(trial).sets.items()
        if p > WORTH_SHOWING
    ]
    tables = {
        "baselines": Table("The flight's table under each baseline", pd.DataFrame([_row(trial) for trial in trials()])),
        "where": Table("Where, under the present baseline", where(flown(), first)),
        "gap_by_step": Table("The gap at each step", by_step()),
        "whitened_gap": Table("Mean square of the whitened gap", pd.DataFrame(left)),
        "timings": Table("Timings of the likeliest explanation", pd.DataFrame(timings)),
        "sets": Table("Sets of effects under each baseline", pd.DataFrame(sets)),
        "simulated": Table("Simulated tables", power(rows)),
    }
    figures = {
        "flight_table": _gap_figure(first),
        "flight_table_wrong_yaw": _gap_figure(yaw),
    }
    return Report(tables, figures, (*_flight_checks(), *_simulated_checks(rows)))


ENTRY = Entry(STUDY, "N Table 2 diagnosed: what parts predicted from flown pre-launch residuals", make_report)


def _gap_figure(trial: Baseline) -> Draw:
    """Flown and predicted residuals above; below flown minus predicted before and after, and the flight's after calibration."""
    found, table = examine(trial), flown()
    before, after = (values.reshape(6, 3) + table.after for values in (found.before, found.after))
    sigma = np.sqrt(np.diag(found.covariance)).reshape(6, 3)
    prediction = motion(table, trial).prediction
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
        above.append(curves(residuals, title=name, y="" if j else "residual (deg)", ticks=x.tolist(), legend=legend))
        axes: dict[str, Any] = {"x": "calibration interval", "y": "" if j else "flown − predicted (deg)", "levels": (0.0,)}
        below.append(curves(gaps, ticks=x.tolist(), legend=legend, **axes))
    title = f"Baseline: {trial.name}; explanation: {found.best}; bars: 1σ of print"
    return sheet(*above, *below, size=(9.0, 5.0), columns=3, title=title)
