"""Reproduce the Mission Mode: R Tables 1 to 3 and Figures 6 to 13 beside the flight's published values."""

from collections.abc import Hashable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import MissionRun, build_flight_schedule
from studies.report import tables as render
from studies.report.committed_results import round_values
from studies.report.tables import Table, format_number
from studies.reproduction import Reproduction, call_all
from studies.robertson import diagnosis, figures, geometry, ground, ladder, performance
from studies.robertson.calendar import PERIODS
from studies.robertson.runs import SPIKE_FILTERS, STUDY, MissionStudy, Runs, load_flights, load_windows

MISSION_FOLDER = Path("build") / "mission"
HEAD = """
The simulated Mission Mode runs from launch to the end of April 1998. R is Robertson et al. (1999), N is Natanson (1998). The
periods are R's: before December 11, to February 27, March and April. [docs/mission.md](../../docs/mission.md) lists what
is from R and what is assumed.
"""
PERIOD_NAMES = dict(zip(PERIODS, ("before calibration", "with alignment", "calibrated"), strict=True))
SLEW_NAMES = {"calibration1": "before calibration", "postcalibration": "after"}
PARAMETER_NAMES = {
    "attitude_accuracy_deg": "accuracy",
    "yaw_update_deg": "update",
    "gyro_bias_std_deg_h": "bias scatter",
}
REQUIREMENT_NOTE = (
    "Deg. Simulated: three times the RMS over the period; of stability the largest change within a second. The nominal "
    "spacecraft has no source of jitter, so stability is not verified."
)
SLEW_NOTE = (
    "Propagated minus true attitude at the end of a yaw maneuver, deg: simulated mean ± standard deviation over the seeds. R "
    "does not say which maneuver its table is of."
)
PERFORMANCE_NOTE = (
    "Accuracy and update in deg, bias scatter in deg/h. Accuracy is on board minus a ground batch, as R has it. Simulated: "
    "the nominal spacecraft. With effects: horizon noise and a random walk of the y bias, whose sizes are fitted "
    "to three of the 18 numbers (roll and pitch accuracy and y bias scatter, calibrated)."
)
MONTHS_NOTE = "Accuracy and update in deg, bias scatter in deg/h. Simulated accuracy is on board minus true."


def run(
    folder: Path = MISSION_FOLDER, study: MissionStudy | None = None, jobs: int = 1, console: Console | None = None
) -> dict[str, Any]:
    """Fly everything, write everything, and return the summary.

    Parameters
    ----------
    folder : where everything is written
    study : what is flown
    jobs : worker processes; the results do not depend on it
    console : for tables; None prints nothing
    """
    what = study or MissionStudy()
    made = Reproduction(console or Console(quiet=True), jobs)
    outcome = made.run(STUDY, what, folder)
    runs = load_flights(what, outcome.table)
    months = [runs["months", str(k)] for k in range(what.seeds)]
    tables = {
        "requirements": performance.build_requirements_table(months),
        "table2": performance.build_slew_table(performance.collect_slew_misses(runs)),
        "table3": performance.build_performance_table(months),
        "biases": performance.build_apparent_bias_table(months),
        "orientation": performance.compare_orientations(months),
        "yaw_maneuvers": performance.compare_maneuver_dates(what.days),
    }
    made.summary = summarise_mission(tables, runs)
    if what.windows:
        tables |= compare_with_flight(made, load_windows(outcome.table), what.entropy)
    uploads = [at for at, _ in build_flight_schedule(MissionConfig(), what.days).uploads]
    daily = figures.average_by_day(months[0].orbits, uploads)
    made.figures = figures.draw_mission_figures(runs, daily, months[0].updates, what.days)
    updates = months[0].updates.assign(day=months[0].updates["t_s"] / DAY)[["day", "sensor", "forward", "update_deg"]]
    tables |= {"daily": daily, "slews": performance.collect_slew_misses(runs), "updates": updates}
    for name, data in tables.items():
        made.add(name, name, data)
    made.summary = round_values(made.summary)
    shown = build_page_tables(tables)
    flown = f"Months: {what.seeds} seeds of {what.days:g} days; yaw maneuver: {what.slews} seeds."
    made.write(folder, "report.md", ["# Mission Mode beside the flight", "", HEAD.strip(), flown, ""], shown)
    for table in shown:
        render.print_table(made.console, table.title, table.data, table.note)
    seeds = {"entropy": what.entropy, "stream": "generator(entropy + k, 0, 'mission_mode') of seed k"}
    command = "gyrocal reproduce --paper robertson"
    made.publish(outcome, folder, command=command, scenario=asdict(MissionConfig()), seeds=seeds)
    return made.summary


def compare_with_flight(made: Reproduction, rows: dict[tuple[str, ...], pd.DataFrame], entropy: int) -> dict[str, pd.DataFrame]:
    """R's own statistic on the ladder of effects, its diagnosis, the alignment, and the sensors' geometry."""
    calls: list[Any] = [
        partial(ground.compare_alignment, entropy),
        partial(ladder.build_ladder_table, rows),
        partial(diagnosis.diagnose_table3, rows),
        geometry.build_availability_table,
    ]
    aligned, rungs, found, share = call_all(calls, made.jobs)
    made.summary |= {"diagnosis": found.summary(), "geometry": geometry.summarise_availability(share)}
    return {
        "ladder": rungs,
        "ladder_numbers": ladder.build_rung_numbers(rows, ladder.read_published_numbers()),
        **diagnosis.build_diagnosis_tables(found),
        "availability": share,
        "tangents": geometry.compute_alpha_tangents(),
        "alignment": aligned,
    }


def summarise_mission(tables: Mapping[str, pd.DataFrame], runs: Runs) -> dict[str, Any]:
    """Summarise the numbers that the claims need, as plain values; None for what was not flown."""
    table3, table2, requirements = tables["table3"], tables["table2"], tables["requirements"]

    def periods(parameter: str) -> dict[str, dict[str, float | None]]:
        rows = table3.query("parameter == @parameter and axis == 'yaw'").set_index("period")
        return {name: {key: _convert_missing(rows.loc[name, key]) for key in ("simulated", "flight")} for name in PERIODS}

    difference = tables["biases"].query("axis == 'z' and forward == '-x minus +x'").set_index("period")
    return {
        "yaw_update_deg": periods("yaw_update_deg"),
        "yaw_accuracy_deg": periods("attitude_accuracy_deg"),
        "requirements": {
            period: {
                name: {
                    "worst_axis_deg": _convert_missing(rows["simulated_deg"].max()),
                    "limit_deg": float(rows["limit_deg"].iloc[0]),
                    "met": bool(rows["met"].all()) if rows["met"].notna().all() else None,
                }
                for name, rows in chosen.groupby("requirement", sort=False)
            }
            for period, chosen in requirements.groupby("period", sort=False)
        },
        "bias_z_minus_x_less_plus_x_deg_h": {
            period: {key: _convert_missing(row[f"{key}_deg_h"]) for key in ("simulated", "standard_error", "formula")}
            for period, row in difference.iterrows()
        },
        "slew_gap_deg": performance.compute_slew_gaps(table2),
        "spikes_deg": {state: _find_largest_errors(runs["spikes", state]) for state in SPIKE_FILTERS},
    }


def _convert_missing(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)


def _find_largest_errors(run: MissionRun) -> dict[str, float]:
    """Largest pitch error, deg, true and as the computer sees it."""
    kinds = {"pitch": "error_pitch_deg", "pitch_on_board": "estimate_pitch_deg"}
    return {name: float(run.telemetry[column].abs().max()) for name, column in kinds.items()}


def build_page_tables(tables: Mapping[str, pd.DataFrame]) -> list[Table]:
    """Build R Tables 1 to 3 beside the flight's values from the reproduction's tables."""
    if "ladder_numbers" in tables:
        third = Table("R Table 3: Mission Mode performance", _format_ladder_numbers(tables["ladder_numbers"]), PERFORMANCE_NOTE)
    else:
        third = Table("R Table 3: Mission Mode performance", _format_months(tables["table3"]), MONTHS_NOTE)
    return [
        Table("R Table 1: requirements", _format_requirements(tables["requirements"]), REQUIREMENT_NOTE),
        Table("R Table 2: attitude error of the yaw maneuver", _format_slews(tables["table2"]), SLEW_NOTE),
        third,
    ]


def _format_requirements(table: pd.DataFrame) -> pd.DataFrame:
    rows = [
        {
            "number": f"{PERIOD_NAMES[row['period']]}: {row['requirement']} {row['axis']}",
            "required": f"{row['limit_deg']:g}",
            "simulated": format_number(row["simulated_deg"], 3),
            "difference": _format_difference(row["simulated_deg"] - row["limit_deg"], 3),
        }
        for row in table.to_dict("records")
    ]
    return pd.DataFrame(rows)


def _format_slews(table: pd.DataFrame) -> pd.DataFrame:
    rows = [
        {
            "number": f"{row['maneuver'].replace('-', '−')}, {SLEW_NAMES[row['tables']]}: {row['axis']}",
            "flown": f"{row['flight_deg']:.3f}",
            "simulated": f"{format_number(row['simulated_deg'], 3)} ± {format_number(row['std_deg'], 3)}",
            "difference": _format_difference(row["simulated_minus_flight_deg"], 3),
        }
        for row in table.to_dict("records")
    ]
    return pd.DataFrame(rows)


def _name_number(row: Mapping[Hashable, Any]) -> str:
    return f"{PERIOD_NAMES[row['period']]}: {PARAMETER_NAMES[row['parameter']]} {row['axis']}"


def _format_ladder_numbers(table: pd.DataFrame) -> pd.DataFrame:
    rows = [
        {
            "number": _name_number(row),
            "flown": f"{row['flight']:g}",
            "simulated": f"{row['computed_coefficients']:.3f}",
            "difference": _format_difference(row["computed_coefficients"] - row["flight"], 3),
            "with effects": f"{row['gyro_walk:y']:.3f}",
        }
        for row in table.to_dict("records")
    ]
    return pd.DataFrame(rows)


def _format_months(table: pd.DataFrame) -> pd.DataFrame:
    rows = [
        {
            "number": _name_number(row),
            "flown": f"{row['flight']:g}",
            "simulated": format_number(row["simulated"], 3),
            "difference": _format_difference(row["simulated_minus_flight"], 3),
        }
        for row in table.to_dict("records")
    ]
    return pd.DataFrame(rows)


def _format_difference(value: float, digits: int) -> str:
    return render.NO_VALUE if pd.isna(value) else f"{value:+.{digits}f}"
