"""Reproduce the Mission Mode: R Tables 1 to 3 and Figures 6 to 13 beside the flight's published values."""

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import MissionRun, build_flight_schedule
from studies.report.committed_results import round_values
from studies.report.tables import NO_VALUE, Table, format_number
from studies.reproduction import Reproduction, call_all
from studies.robertson import diagnosis, figures, geometry, ground, ladder, performance
from studies.robertson.calendar import PERIODS
from studies.robertson.runs import SPIKE_FILTERS, STUDY, MissionStudy, Runs, load_flights, load_windows

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


def run(folder: Path, study: MissionStudy, jobs: int, console: Console) -> dict[str, Any]:
    """Simulate all flights in worker processes, write tables and figures to a folder, and return the summary."""
    reproduction = Reproduction(console, jobs)
    outcome = reproduction.run(STUDY, study, folder)
    runs = load_flights(study, outcome.table)
    months = [runs["months", str(k)] for k in range(study.seeds)]
    misses = performance.collect_slew_misses(runs)
    reproduction.tables = {
        "requirements": performance.build_requirements_table(months),
        "table2": performance.build_slew_table(misses),
        "table3": performance.build_performance_table(months),
        "biases": performance.build_apparent_bias_table(months),
        "orientation": performance.compare_orientations(months),
        "yaw_maneuvers": performance.compare_maneuver_dates(study.days),
    }
    reproduction.summary = summarise_mission(reproduction.tables, runs)
    if study.windows:
        add_flight_comparison(reproduction, load_windows(outcome.table), study.entropy)
    uploads = [time_s for time_s, _ in build_flight_schedule(MissionConfig(), study.days).uploads]
    daily = figures.average_by_day(months[0].orbits, uploads)
    reproduction.figures = figures.draw_mission_figures(runs, daily, months[0].updates, study.days)
    updates = months[0].updates.assign(day=months[0].updates["t_s"] / DAY)[["day", "sensor", "forward", "update_deg"]]
    reproduction.tables |= {"daily": daily, "slews": misses, "updates": updates}
    reproduction.summary = round_values(reproduction.summary)
    counts = f"Months: {study.seeds} seeds of {study.days:g} days; yaw maneuver: {study.slews} seeds."
    about = {
        "command": "gyrocal reproduce --paper robertson",
        "scenario": asdict(MissionConfig()),
        "seeds": {"entropy": study.entropy, "stream": "generator(entropy + k, 0, 'mission_mode') of seed k"},
    }
    head = ["# Mission Mode beside the flight", "", HEAD.strip(), counts, ""]
    reproduction.publish(outcome, folder, "report.md", head, build_page_tables(reproduction.tables), **about)
    return reproduction.summary


def add_flight_comparison(reproduction: Reproduction, rows: dict[tuple[str, ...], pd.DataFrame], entropy: int) -> None:
    """Add R's own statistic on the ladder of effects, its diagnosis, the alignment, and the sensors' geometry."""
    calls: list[Any] = [
        partial(ground.compare_alignment, entropy),
        partial(ladder.build_ladder_table, rows),
        partial(diagnosis.diagnose_table3, rows),
        geometry.build_availability_table,
    ]
    alignment, rungs, performance_diagnosis, availability = call_all(calls, reproduction.jobs)
    reproduction.summary |= {
        "diagnosis": performance_diagnosis.summary(),
        "geometry": geometry.summarise_availability(availability),
    }
    reproduction.tables |= {
        "diagnosis_sizes": diagnosis.build_size_table(performance_diagnosis),
        "ladder": rungs,
        "ladder_numbers": ladder.build_rung_numbers(rows, ladder.read_published_numbers()),
        "availability": availability,
        "tangents": geometry.compute_alpha_tangents(),
        "alignment": alignment,
    }


def summarise_mission(tables: Mapping[str, pd.DataFrame], runs: Runs) -> dict[str, Any]:
    """Summarise the numbers that the claims need, as plain values; None for missing flights."""
    table3, table2, requirements = tables["table3"], tables["table2"], tables["requirements"]

    def summarise_periods(parameter: str) -> dict[str, dict[str, float | None]]:
        rows = table3.query("parameter == @parameter and axis == 'yaw'").set_index("period")
        return {name: {key: _convert_missing(rows.loc[name, key]) for key in ("simulated", "flight")} for name in PERIODS}

    difference = tables["biases"].query("axis == 'z' and forward == '-x minus +x'").set_index("period")
    return {
        "yaw_update_deg": summarise_periods("yaw_update_deg"),
        "yaw_accuracy_deg": summarise_periods("attitude_accuracy_deg"),
        "requirements": {
            period: {
                name: {
                    "worst_axis_deg": _convert_missing(rows["simulated_deg"].max()),
                    "limit_deg": float(rows["limit_deg"].iloc[0]),
                    "met": bool(rows["met"].all()) if rows["met"].notna().all() else None,
                }
                for name, rows in period_rows.groupby("requirement", sort=False)
            }
            for period, period_rows in requirements.groupby("period", sort=False)
        },
        "bias_z_minus_x_less_plus_x_deg_h": {
            period: {key: _convert_missing(row[f"{key}_deg_h"]) for key in ("simulated", "standard_error", "formula")}
            for period, row in difference.iterrows()
        },
        "slew_gap_deg": performance.compute_slew_gaps(table2),
        "spikes_deg": {state: _find_largest_errors(runs["spikes", state]) for state in SPIKE_FILTERS},
    }


def _convert_missing(value: Any) -> float | None:
    """Convert a number, or NaN to None."""
    return None if pd.isna(value) else float(value)


def _find_largest_errors(run: MissionRun) -> dict[str, float]:
    """Find the largest pitch error, deg, true and on board."""
    kinds = {"pitch": "error_pitch_deg", "pitch_on_board": "estimate_pitch_deg"}
    return {name: float(run.telemetry[column].abs().max()) for name, column in kinds.items()}


def build_page_tables(tables: Mapping[str, pd.DataFrame]) -> list[Table]:
    """Build R Tables 1 to 3 with the flight's values from the reproduction's tables."""
    limits = tables["requirements"]
    names = limits["period"].map(PERIOD_NAMES) + ": " + limits["requirement"] + " " + limits["axis"]
    required = {"number": names, "required": limits["limit_deg"].map("{:g}".format)}
    first = _format_table(required, limits["simulated_deg"], limits["limit_deg"])
    slews = tables["table2"]
    names = slews["maneuver"].str.replace("-", "−") + ", " + slews["tables"].map(SLEW_NAMES) + ": " + slews["axis"]
    flown = {"number": names, "flown": slews["flight_deg"].map("{:.3f}".format)}
    second = _format_table(flown, slews["simulated_deg"], slews["flight_deg"], slews["std_deg"])
    has_ladder = "ladder_numbers" in tables
    numbers = tables["ladder_numbers" if has_ladder else "table3"]
    names = numbers["period"].map(PERIOD_NAMES) + ": " + numbers["parameter"].map(PARAMETER_NAMES) + " " + numbers["axis"]
    flown = {"number": names, "flown": numbers["flight"].map("{:g}".format)}
    third = _format_table(flown, numbers["computed_coefficients" if has_ladder else "simulated"], numbers["flight"])
    if has_ladder:
        third["with effects"] = numbers["gyro_walk:y"].map("{:.3f}".format)
    return [
        Table("R Table 1: requirements", first, REQUIREMENT_NOTE),
        Table("R Table 2: attitude error of the yaw maneuver", second, SLEW_NOTE),
        Table("R Table 3: Mission Mode performance", third, PERFORMANCE_NOTE if has_ladder else MONTHS_NOTE),
    ]


def _format_table(
    start: Mapping[str, pd.Series], simulated: pd.Series, reference: pd.Series, sigma: pd.Series | None = None
) -> pd.DataFrame:
    """Format simulated numbers and their differences to known ones as texts, after the first columns."""
    format_milli = partial(format_number, digits=3)
    texts = simulated.map(format_milli)
    return pd.DataFrame(
        {
            **start,
            "simulated": texts if sigma is None else texts + " ± " + sigma.map(format_milli),
            "difference": (simulated - reference).map(lambda value: NO_VALUE if pd.isna(value) else f"{value:+.3f}"),
        }
    )
