"""The reproduction of R: everything flown, tables beside the flight's values, figures, one page, manifest."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import MissionRun, flight_schedule
from studies.montecarlo import engine
from studies.montecarlo.files import write_csv, write_json, write_text
from studies.report import checks
from studies.report import tables as render
from studies.report.committed import DIGITS, settled
from studies.report.console import progress
from studies.robertson import biases, figures, mountings, performance, slews, words
from studies.robertson.against_flight import NOTES as MORE_NOTES
from studies.robertson.against_flight import TITLES as MORE_TITLES
from studies.robertson.against_flight import AgainstFlight, section
from studies.robertson.runs import PERIODS, SLEW_TABLES, SPIKE_FILTERS, STUDY, MissionStudy, Runs, further_rows, window_rows
from studies.robertson.runs import runs as flown_runs

DEFAULT_FOLDER = Path("build") / "mission"
TITLES = {
    "table2": "R Table 2: attitude error of the yaw maneuver (deg, propagated minus true)",
    "table3": "R Table 3: Mission Mode performance",
    "requirements": "R Table 1: requirements",
    "biases": "R (8): gyro bias by orientation (deg/h)",
    "bias_scatter": "Scatter of the bias by orientation alone (deg/h)",
    "orientation": "Yaw by orientation",
    "mountings": "Yaw updates by how the sun sensors are mounted (deg)",
    "yaw_maneuvers": "Yaw maneuvers",
}
NOTES = {
    "table2": "calibration1 has the gyro's parameters of before launch. std: over seeds. noise_free: by the two G and b alone, "
    "the yaw bias as solved for before the maneuver; published_bias: with that of before launch. flight_by_N: N Table 2, "
    "intervals 2 and 6, each processed with the published biases.",
    "table3": "lowest, highest: over seeds. Orbits with a yaw maneuver count until the yaw update after it as not in normal "
    "pointing.",
    "requirements": "simulated: three times the RMS over the period (largest for stability); worst_orbit: of the worst one, "
    "which in the second period comes after a yaw maneuver with a wrong gyro. Stability is not judged: the nominal spacecraft "
    "has no source of jitter, and TRMM's are not published; the table of stability says how large some would have to be.",
    "mountings": "A run of a day each; the first four updates are left out.",
    "bias_scatter": "Of the second period, with the simulated share of the two orientations.",
}


def run(
    folder: Path = DEFAULT_FOLDER, study: MissionStudy | None = None, jobs: int = 1, console: Console | None = None
) -> dict[str, Any]:
    """Fly everything, write everything, and return the summary.

    Parameters
    ----------
    folder : where everything is written
    study : what is flown
    jobs : worker processes; the results do not depend on it
    console : for tables; None prints nothing
    """
    started = time.monotonic()
    out, what = console or Console(quiet=True), study or MissionStudy()
    work = engine.work_folder(folder, STUDY, what)
    shown = partial(progress, quiet=out.quiet)
    outcome = engine.run(STUDY, what, work, backend="loky" if jobs > 1 else "serial", jobs=jobs, progress=shown)
    outcome.check()
    runs = flown_runs(what, outcome.table)
    months = [runs["months", str(k)] for k in range(what.seeds)]
    tables = make_tables(runs, months, what)
    summary = summarise(tables, runs)
    beside = None
    if what.windows:
        beside = section(window_rows(outcome.table), further_rows(outcome.table), months, tables["table2"], what.entropy)
    summary = settled(summary | (beside.summary if beside else {}))
    _write(folder, what, runs, months, tables, summary, beside)
    wall_s = round(time.monotonic() - started, 2)
    seeds = {"entropy": what.entropy, "stream": "generator(entropy + k, 0, 'mission_mode') of seed k"}
    flown = asdict(MissionConfig())
    command = "gyrocal reproduce --paper robertson"
    engine.publish(outcome, folder, command=command, scenario=flown, seeds=seeds, wall_s=wall_s)
    for name in ("table3", "table2", "requirements"):
        render.terminal(out, TITLES[name], _rounded(tables[name]))
    render.terminal(out, "Mission Mode beside the flight", summary_table(summary))
    out.print(f"Written to {folder} in {wall_s:.0f} s.", highlight=False)
    return summary


def make_tables(runs: Runs, months: Sequence[MissionRun], study: MissionStudy) -> dict[str, pd.DataFrame]:
    """All tables by name, see `TITLES`."""
    return {
        "table2": slews.table2(slews.targeting(runs)),
        "table3": performance.table3(months),
        "requirements": performance.requirements(months),
        "biases": biases.table8(months),
        "bias_scatter": biases.scatter(months),
        "orientation": performance.by_orientation(months),
        "mountings": mountings.mounting_table(runs),
        "yaw_maneuvers": performance.maneuver_dates(study.days),
    }


def summarise(tables: dict[str, pd.DataFrame], runs: Runs) -> dict[str, Any]:
    """The numbers that answer the study's questions, as plain values; None for what was not flown."""
    table3, table2, requirements = tables["table3"], tables["table2"], tables["requirements"]

    def periods(parameter: str) -> dict[str, dict[str, float | None]]:
        rows = table3.query("parameter == @parameter and axis == 'yaw'").set_index("period")
        return {name: {key: _number(rows.loc[name, key]) for key in ("simulated", "flight")} for name in PERIODS}

    angles = table3[table3["parameter"] != "gyro_bias_std_deg_h"]
    difference = tables["biases"].query("axis == 'z' and forward == '-x minus +x'").set_index("period")
    return {
        "yaw_update_deg": periods("yaw_update_deg"),
        "yaw_accuracy_deg": periods("attitude_accuracy_deg"),
        "largest_seed_range_deg": _number((angles["highest"] - angles["lowest"]).max()),
        "requirements": {
            period: {
                name: {
                    "worst_axis_deg": _number(rows["simulated_deg"].max()),
                    "limit_deg": float(rows["limit_deg"].iloc[0]),
                    "met": bool(rows["met"].all()) if rows["met"].notna().all() else None,
                }
                for name, rows in chosen.groupby("requirement", sort=False)
            }
            for period, chosen in requirements.groupby("period", sort=False)
        },
        "bias_z_minus_x_less_plus_x_deg_h": {
            period: {key: _number(row[f"{key}_deg_h"]) for key in ("simulated", "standard_error", "formula")}
            for period, row in difference.iterrows()
        },
        "slew_deg": {
            maneuver: {
                period: {
                    row["axis"]: {key: _number(row[f"{key}_deg"]) for key in ("simulated", "std", "flight")}
                    for _, row in rows.iterrows()
                }
                for period, rows in chosen.groupby("tables", sort=False)
            }
            for maneuver, chosen in table2.groupby("maneuver", sort=False)
        },
        "slew_gap_deg": slews.gaps(table2),
        "spikes_deg": {state: _largest_errors(runs["spikes", state]) for state in SPIKE_FILTERS},
    }


def _number(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)


def _largest_errors(run: MissionRun) -> dict[str, float]:
    """Largest roll and pitch error, deg, true and as the computer sees it."""
    kinds = {"error": "", "estimate": "_on_board"}
    return {
        f"{axis}{suffix}": float(run.telemetry[f"{kind}_{axis}_deg"].abs().max())
        for axis in ("roll", "pitch")
        for kind, suffix in kinds.items()
    }


def summary_table(summary: dict[str, Any]) -> pd.DataFrame:
    """The questions a reader comes with, and the answers of this run."""

    def three(values: dict[str, dict[str, float | None]], key: str, digits: int) -> str:
        return " / ".join(_text(one[key], digits) for one in values.values())

    update, accuracy, bias = summary["yaw_update_deg"], summary["yaw_accuracy_deg"], summary["bias_z_minus_x_less_plus_x_deg_h"]
    best = min(summary["slew_gap_deg"], key=summary["slew_gap_deg"].__getitem__)
    before, after = (summary["slew_deg"][best][period] for period in SLEW_TABLES)
    spikes = summary["spikes_deg"]
    kept, missed = summary["requirements"]["postcalibration"], summary["requirements"]["precalibration"]
    rows = {
        "Yaw update before, with alignment, calibrated?": f"{three(update, 'simulated', 3)} deg; flight "
        f"{three(update, 'flight', 2)}",
        "Yaw accuracy in the same periods?": f"{three(accuracy, 'simulated', 3)} deg; flight {three(accuracy, 'flight', 3)}",
        "Requirements met when calibrated?": _verdict(kept),
        "And before?": _verdict(missed),
        "Does the z bias depend on orientation?": f"by {_text(bias['calibration1']['simulated'], 3)} deg/h before the gyro's "
        f"upload (R (8): {_text(bias['calibration1']['formula'], 3)}), {_text(bias['postcalibration']['simulated'], 4)} ± "
        f"{_text(bias['postcalibration']['standard_error'], 4)} after",
        f"Error of a yaw maneuver, {words.signed(best)}, before?": _slew_text(before),
        "And after?": _slew_text(after),
        "Pitch spikes by the S filter, on board and true?": ", ".join(
            f"{spikes[state]['pitch_on_board']:.3f} and {spikes[state]['pitch']:.3f} deg {name}"
            for state, name in (("restarted", "restarted wrongly"), ("off", "off"))
        ),
    }
    return pd.DataFrame({"question": rows.keys(), "answer": rows.values()})


def _slew_text(axes: dict[str, dict[str, float | None]]) -> str:
    """Roll, pitch and yaw beside the flight's."""
    simulated, flown = (
        ", ".join("–" if one[key] is None else f"{one[key]:+.3f}" for one in axes.values()) for key in ("simulated", "flight")
    )
    return f"{simulated} deg; flight {flown}"


def _text(value: float | None, digits: int) -> str:
    return render.number(np.nan if value is None else value, digits)


def _verdict(requirements: dict[str, dict[str, Any]]) -> str:
    if any(one["met"] is None for name, one in requirements.items() if name != "stability"):
        return render.NO_VALUE
    held = {name: one for name, one in requirements.items() if name != "stability"}
    cells = ", ".join(f"{name} {_text(one['worst_axis_deg'], 3)} of {one['limit_deg']:g} deg" for name, one in held.items())
    return f"{'yes' if all(one['met'] for one in held.values()) else 'NO'}: {cells}; stability is not verified"


def _write(
    folder: Path,
    study: MissionStudy,
    runs: Runs,
    months: Sequence[MissionRun],
    tables: dict[str, pd.DataFrame],
    summary: dict[str, Any],
    beside: AgainstFlight | None,
) -> None:
    """Tables as CSV, figures, the page, the summary."""
    uploads = [at for at, _ in flight_schedule(MissionConfig(), study.days).uploads]
    daily = figures.daily_means(months[0].orbits, uploads)
    drawn = figures.draw(runs, daily, months[0].updates, study.days, folder)
    updates = months[0].updates.assign(day=months[0].updates["t_s"] / DAY)[["day", "sensor", "forward", "update_deg"]]
    extra = {"daily": daily, "slews": slews.targeting(runs), "updates": updates}
    further = beside.tables if beside else {}
    drawn |= {one(folder / f"{name}.svg").name: title for name, (title, one) in (beside.figures if beside else {}).items()}
    for name, table in {**tables, **extra, **further}.items():
        write_csv(folder / f"{name}.csv", table, digits=DIGITS)
    found = words.checks(tables, summary)
    sections = [
        "# Mission Mode beside the flight",
        "",
        words.LEAD.strip(),
        "",
        render.markdown("Summary", summary_table(summary)),
        render.markdown("What was found", checks.shown(found)),
        *(f"- {one}" for one in checks.meanings(found)),
        "",
        "## What is not published, and what follows from it",
        "",
        *(f"- {one}" for one in words.NOT_PUBLISHED),
        "",
        *(render.markdown(title, _rounded(tables[name]), NOTES.get(name, "")) for name, title in TITLES.items()),
        *(render.markdown(title, _rounded(further[name]), MORE_NOTES.get(name, "")) for name, title in more(further)),
        f"Months: {study.seeds} seeds of {study.days:g} days; yaw maneuver: {study.slews} seeds. Figures 9 to 11 show the "
        "first seed; `daily.csv` and `updates.csv` hold what they show.",
        "",
    ]
    for name, title in drawn.items():
        sections += [f"## {title}", "", f"![{title}]({name})", ""]
    write_text(folder / "report.md", "\n".join(sections))
    write_json(folder / "summary.json", summary)


def more(tables: dict[str, pd.DataFrame]) -> list[tuple[str, str]]:
    """Names and titles of the further tables that there are."""
    return [(name, title) for name, title in MORE_TITLES.items() if name in tables]


def _rounded(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers to four decimals, as text."""
    out = table.copy()
    for name in out.select_dtypes("float").columns:
        out[name] = [render.number(value, 4) for value in out[name]]
    return out
