"""The study's report: findings, tables and figures, and ``diagnosis.json``."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from studies.montecarlo import engine
from studies.montecarlo.manifest import write_json
from studies.montecarlo.statistics import binomial_interval
from studies.natanson import flight
from studies.natanson.flight_diagnosis.baselines import Diagnosis, documents, evidence_table, flight_diagnoses
from studies.natanson.flight_diagnosis.families import UNKNOWN
from studies.natanson.flight_diagnosis.figures import evidence_figure, gap_figure
from studies.natanson.flight_diagnosis.gap import by_step
from studies.natanson.flight_diagnosis.simulated_tables import STUDY, FlightConfig
from studies.natanson.flight_diagnosis.verdict import FALSE_ALARM
from studies.report import entry as report
from studies.report.entry import Entry, Report
from studies.report.tables import Table


def power(rows: pd.DataFrame) -> pd.DataFrame:
    """A row per kind of simulated table: detected, rightly named, wrongly named."""
    out = []
    for kind, part in rows.groupby("kind", sort=False):
        seen = part["verdict"] != "none"
        out.append(
            {
                "kind": kind,
                "tables": len(part),
                "gap_found": int(seen.sum()),
                "right": int(part["right"].sum()),
                "in_group": int((part["in_group"] & ~part["right"]).sum()),
                "false_name": int(part["false_name"].sum()),
            }
        )
    return pd.DataFrame(out)


def _findings(rows: pd.DataFrame, found: Sequence[Diagnosis]) -> list[str]:
    own, wrong = found[0], found[1:]
    closed = own.closure
    places = own.where[own.where["p_holm"] < FALSE_ALARM]
    table = power(rows).set_index("kind")
    columns = by_step()
    sides: dict[Any, set[float]] = {}
    for _, row in columns.iterrows():
        sides.setdefault((row["interval"], row["axis"]), set()).add(float(np.sign(row["gap_deg"])))
    steady = [sides[at] == {1.0} or sides[at] == {-1.0} for at in zip(places["interval"], places["axis"], strict=True)]
    others = columns[columns["step_s"] > flight.STEPS[0]]
    outlier = others.iloc[int((others["gap_deg"] / others["sigma_deg"]).abs().to_numpy().argmax())]
    out = [
        f"Under the present baseline the gap is {closed.rms_deg['before']:.4f} deg RMS, {closed.rms_deg['after']:.4f} with the "
        f"likeliest explanation ({own.judgement.best.label}), floor {closed.rms_deg['floor']:.4f}; verdict: "
        f"{own.judgement.verdict}, causes: {' + '.join(own.judgement.causes) or 'none'}, probability that something unknown "
        f"remains {own.judgement.includes[UNKNOWN]:.2f} (about {own.judgement.unknown_deg()[0]:.4f} deg a number).",
        f"The gap stands out in {len(places)} of 18 numbers (intervals "
        f"{', '.join(map(str, sorted(set(places['interval']))))}), χ² {own.gap['motion_chi2']:.0f} of 18; noise: χ² "
        f"{own.gap['noise_chi2']:.1f} of 42, {own.noise[0]:.2f} ± {own.noise[1]:.2f} of the stated one.",
        f"Of {len(wrong)} deliberately wrong baselines {sum(d.trial.done <= set(d.judgement.causes) for d in wrong)} were "
        "named for what was done to them.",
        f"The same comparison at 1 and 2 s: the gap keeps its sign at both in {sum(steady)} of the {len(steady)} numbers "
        f"that stand out at 0.5 s: rounded residuals are not its cause. Farthest off is {outlier['step_s']:g} s, interval "
        f"{outlier['interval']:g}, {outlier['axis']}: {outlier['gap_deg']:+.4f} ± {outlier['sigma_deg']:.4f} deg as printed, "
        f"{outlier['gap_deg'] + 2 * outlier['after_deg']:+.4f} with the other sign of its residual after calibration.",
    ]
    if "nothing" in table.index:
        alarms, count = (int(power(rows).set_index("kind")[name].to_dict()["nothing"]) for name in ("gap_found", "tables"))
        low, high = binomial_interval(alarms, count)
        out.append(
            f"Tables simulated from the baseline: a gap in {alarms} of {count} "
            f"({100 * low:.1f} to {100 * high:.1f} %; stated {100 * FALSE_ALARM:g} %)."
        )
    effects = table.drop(index="nothing", errors="ignore")
    if len(effects):
        out.append(
            f"Tables with an effect: {effects['gap_found'].sum()} of {effects['tables'].sum()} found, {effects['right'].sum()} "
            f"rightly named, {effects['in_group'].sum()} more in a group, {effects['false_name'].sum()} with a wrong name."
        )
    return out


def make_report(config: FlightConfig, rows: pd.DataFrame) -> Report:
    """The flight's table under every baseline, and what simulated tables say of the diagnosis."""
    found = flight_diagnoses()
    sizes = [
        {"baseline": d.trial.baseline.name, "timing": name, "mean": mean, "sigma": sigma}
        for d in found
        for name, (mean, sigma) in d.closure.sizes.items()
    ]
    whitened = [{"baseline": d.trial.baseline.name, **d.closure.whitened} for d in found]
    tables = {
        "baselines": Table("The flight's table under each baseline", pd.DataFrame([d.row() for d in found])),
        "where": Table("Where, under the present baseline", found[0].where),
        "gap_by_step": Table("The gap at each step", by_step()),
        "whitened_gap": Table("Mean square of the whitened gap", pd.DataFrame(whitened)),
        "timings": Table(
            "Timings under the likeliest hypothesis", pd.DataFrame(sizes, columns=["baseline", "timing", "mean", "sigma"])
        ),
        "hypotheses": Table("Hypotheses under the present baseline", evidence_table(found[0])),
        "simulated": Table("Simulated tables", power(rows)),
    }
    figures = {
        "flight_table": partial(gap_figure, found[0]),
        "flight_table_wrong_yaw": partial(gap_figure, found[1]),
        "flight_evidence": partial(evidence_figure, found),
    }
    return Report(tables, figures, findings=tuple(_findings(rows, found)))


ENTRY = Entry(STUDY, "N Table 2 diagnosed: what parts predicted from flown pre-launch residuals", make_report)


def run(folder: Path, config: FlightConfig | None = None, jobs: int = 1, console: Console | None = None) -> dict[str, Any]:
    """Run the study, write its report, and the diagnoses as ``diagnosis.json``.

    Parameters
    ----------
    folder : where everything is written
    config : the simulated tables
    jobs : worker processes; the results do not depend on it
    console : for the findings; None prints nothing

    Returns
    -------
    The result of every baseline, by its name.
    """
    chosen = config or FlightConfig()
    outcome = engine.run(STUDY, chosen, folder, backend="loky" if jobs > 1 else "serial", jobs=jobs)
    rows = outcome.load()
    made = make_report(chosen, rows[rows["error"] == ""].reset_index(drop=True))
    report.write(made, ENTRY.summary, folder)
    results = documents()
    write_json(folder / "diagnosis.json", results)
    for finding in made.findings:
        (console or Console(quiet=True)).print(f"- {finding}", highlight=False, markup=False)
    return results
