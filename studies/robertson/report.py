"""The reproduction of R: everything flown, tables beside the flight's values, figures, one page, manifest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from simulator.mission_mode.config import DAY, MissionConfig
from simulator.mission_mode.flight import MissionRun, build_flight_schedule
from studies.report import checks
from studies.report import tables as render
from studies.report.claims import fill
from studies.report.committed_results import flatten, round_values
from studies.reproduction import Reproduction, call_all
from studies.robertson import (
    biases,
    combined_diagnosis,
    diagnosis,
    end_to_end,
    figures,
    geometry,
    ladder,
    performance,
    printed_coefficients,
    report_text,
    slews,
    stability,
    windows,
)
from studies.robertson.calendar import PERIODS
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.runs import (
    SLEW_TABLES,
    SPIKE_FILTERS,
    STUDY,
    MissionStudy,
    Runs,
    load_further_numbers,
    load_windows,
)
from studies.robertson.runs import load_flights as flown_runs

MISSION_FOLDER = Path("build") / "mission"
MISSION_TABLE_TITLES = {
    "table2": "R Table 2: attitude error of the yaw maneuver (deg, propagated minus true)",
    "table3": "R Table 3: Mission Mode performance",
    "requirements": "R Table 1: requirements",
    "biases": "R (8): gyro bias by orientation (deg/h)",
    "bias_scatter": "Scatter of the bias by orientation alone (deg/h)",
    "orientation": "Yaw by orientation",
    "mountings": "Yaw updates by how the sun sensors are mounted (deg)",
    "yaw_maneuvers": "Yaw maneuvers",
    "statistics": "R Table 3 by what it is compared with (deg, deg/h)",
    "ladder": "The ladder: RMS factor between simulated and flown",
    "ladder_numbers": "R Table 3 on every rung (deg, deg/h)",
    "diagnosis": "What parts the nominal from the flight",
    "diagnosis_sizes": "Sizes of the likeliest explanation",
    "diagnosis_left": "Flown minus simulated with the listed effects of that explanation, in sigmas",
    "all_data_ladder": "R's other data on every rung: Table 2, R (3), R (6), orientation signs",
    "all_data_numbers": "R's other data, number by number",
    "all_data": "What the other data change in the diagnosis",
    "printed_coefficients": "How probably R (6) is as printed, has lost zeros, or is something else",
    "sun_angles": "Yaw updates by sun angle, sensor and orientation (deg)",
    "availability": "Share of the orbit with sun sensor data, by the boresights' tilt and elevation toward zenith",
    "tangents": "What (c, d) of R (6) say of tan α",
    "chance": "Probability that random digits do as well as R (6)'s, slips allowed",
    "end_to_end": "From end to end: yaw updates by sun angle (deg)",
    "end_to_end_found": "From end to end: what was found, beside R's",
    "table2_change": "R Table 2, before minus after calibration (deg)",
    "stability": "R Table 1's stability with assumed sources of jitter",
}
TABLE_NOTES = {
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
    "statistics": "Single orbits through each period, the spacecraft as landed: boresights level, (c, d) as printed. "
    "onboard_minus_true has the scatter of the batch's bias too, since no other solution has one. later_tables: before "
    "December 11 the ground may have used the tables that were uploaded then; R does not say.",
    "ladder": "factor: exp of the RMS logarithm of simulated over flown; 18: all of R Table 3, 12: attitude and updates, 6: "
    "yaw, unfitted: those that no size was fitted on, of the 12 and of all. low, high: 16 to 84 % over windows drawn anew. "
    "Sizes are fitted on the postcalibration period only; the time constant of 250 s is assumed, and which effects are rungs "
    "was chosen with all 18 numbers in view.",
    "diagnosis": "Probability that a cause is at work, in any set; the rest is below 2 %.",
    "all_data_ladder": "R less simulated; no size was fitted on any of it. Sigmas: Table 2's of what R leaves open (duration, "
    "yaw bias), R (3)'s of the early orbits. R (3) is nearly put in, by the mounting. ln B: how much less likely R (6) is than "
    "of the nominal mounting. Ratios: R saw both above one.",
    "all_data_numbers": "change: before less after calibration, yaw maneuver from +x to −x, deg. m: of DSS-2, deg.",
    "printed_coefficients": "Of the nominal mounting, with prior shares, chosen, of 0.6, 0.1, 0.1, 0.2. sigma: of how it is "
    "computed.",
    "all_data": "Probability that a cause is at work: of Table 3 alone, and with the other data and signs in the same linear "
    "model; causes of 2 % in either.",
    "sun_angles": "Months of the nominal spacecraft, all updates of the period.",
    "availability": "Averaged over the sun angles of a year; the nominal spacecraft has a tilt of 20° and 29.4°.",
    "tangents": "Published over the head's angle, as printed and with the power of ten that comes nearest to the geometry. "
    "computed: for the least error at the updates of the nominal spacecraft.",
    "end_to_end": "Sensors as designed but for the heads; alignment at sun angles of 8 to 12°.",
    "table2_change": "The noise of the one flown maneuver is in both of R's columns and cancels, as for N.",
    "stability": "Largest peak to peak within a second over an orbit of the calibrated spacecraft, by the loop's cycle. size: "
    "assumed, not TRMM's. closed_form: on the axis moved most; size_of_limit: that which alone uses up 0.1°. Steps of the "
    "arrays last two cycles here while the body drifts back, so that less is flown. The body is rigid; one that rings "
    "moves more. `gyrocal mission OUT --calibrated --effect scan_torque=1` or `--effect array_step=0.1` flies one.",
}


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
    runs = flown_runs(what, outcome.table)
    months = [runs["months", str(k)] for k in range(what.seeds)]
    tables = build_mission_tables(runs, months, what)
    made.summary = summarise_mission(tables, runs)
    add_month_figures(made, runs, months, what)
    if what.windows:
        further = add_flight_comparison(made, load_windows(outcome.table), load_further_numbers(outcome.table), what.entropy)
        tables |= further | {
            "sun_angles": performance.average_by_sun_angle(months),
            "table2_change": slews.compare_calibration_change(tables["table2"]),
        }
        made.figures["figure10_sun_angle"] = ("Yaw updates against the sun angle", figures.draw_sun_angle_figure(months))
    for name, title in MISSION_TABLE_TITLES.items():
        if name in tables:
            table = tables[name]
            made.add(
                name, title, table, note=TABLE_NOTES.get(name, ""), formats=dict.fromkeys(table.select_dtypes("float"), ".4f")
            )
    made.summary = round_values(made.summary)
    write_mission_report(folder, what, made)
    made.show("table3", "table2", "requirements")
    render.print_table(made.console, "Mission Mode beside the flight", build_answers_table(made.summary))
    seeds = {"entropy": what.entropy, "stream": "generator(entropy + k, 0, 'mission_mode') of seed k"}
    command = "gyrocal reproduce --paper robertson"
    made.publish(outcome, folder, command=command, scenario=asdict(MissionConfig()), seeds=seeds)
    return made.summary


def build_mission_tables(runs: Runs, months: Sequence[MissionRun], study: MissionStudy) -> dict[str, pd.DataFrame]:
    """The tables of the flights without effects, by name, see `MISSION_TABLE_TITLES`."""
    return {
        "table2": slews.build_slew_table(slews.collect_slew_misses(runs)),
        "table3": performance.build_performance_table(months),
        "requirements": performance.build_requirements_table(months),
        "biases": biases.build_apparent_bias_table(months),
        "bias_scatter": biases.compute_orientation_scatter(months),
        "orientation": performance.compare_orientations(months),
        "mountings": performance.compare_mountings(runs),
        "yaw_maneuvers": performance.compare_maneuver_dates(study.days),
    }


def add_flight_comparison(
    made: Reproduction,
    rows: dict[tuple[str, ...], pd.DataFrame],
    further: dict[tuple[str, ...], dict[str, float]],
    entropy: int,
) -> dict[str, pd.DataFrame]:
    """R's own statistics, the geometry, the ladder and its diagnosis, and the story from end to end, which is flown here."""
    calls: list[Any] = [
        partial(end_to_end.simulate_full_history, entropy),
        partial(ladder.build_ladder_table, rows),
        partial(combined_diagnosis.diagnose_all_data, rows, further),
        partial(stability.build_stability_table, entropy),
        partial(diagnosis.diagnose_table3, rows),
        geometry.build_availability_table,
    ]
    story, rungs, together, steady, found, share = call_all(calls, made.jobs)
    tangents = geometry.compute_alpha_tangents()
    made.figures["figure6_geometry"] = ("R Figure 6: fields of view of the sun sensors", geometry.draw_sensor_fields())
    made.figures["ladder"] = ("The ladder from the Mission Mode as landed to the flight", figures.draw_ladder_figure(rungs))
    made.summary |= {
        "ladder": rungs.to_dict("records"),
        "diagnosis": found.summary(),
        "diagnosis_all_data": together.summary(),
        "geometry": geometry.summarise_geometry(share, tangents),
        "end_to_end": {
            "updates_deg": story.updates.to_dict("records"),
            "c_d": [list(one) for one in story.factors],
            "m_dss_2_deg": story.misalignment.tolist(),
        },
        "stability": stability.summarise_stability(steady),
    }
    return {
        "statistics": windows.compare_window_statistics(rows[ladder.LANDED]),
        "ladder": rungs,
        "ladder_numbers": ladder.build_rung_numbers(rows, windows.read_published_numbers()),
        **diagnosis.build_diagnosis_tables(found),
        "all_data_ladder": combined_diagnosis.build_rungs_table(rows, further),
        "all_data_numbers": combined_diagnosis.build_observations_table(further),
        "all_data": combined_diagnosis.compare_cause_probabilities(found, together),
        "printed_coefficients": printed_coefficients.build_reading_table(ladder.NOMINAL),
        "availability": share,
        "tangents": tangents,
        "chance": pd.DataFrame(
            [{"numbers": name, "probability": p} for name, p in geometry.compute_chance_probability().items()]
        ),
        "end_to_end": story.updates,
        "end_to_end_found": story.compare_published(),
        "stability": steady,
    }


def add_month_figures(made: Reproduction, runs: Runs, months: Sequence[MissionRun], study: MissionStudy) -> None:
    """R Figures 7 to 13, and as tables without a place on the page what they show."""
    uploads = [at for at, _ in build_flight_schedule(MissionConfig(), study.days).uploads]
    daily = figures.average_by_day(months[0].orbits, uploads)
    made.figures |= figures.draw_mission_figures(runs, daily, months[0].updates, study.days)
    updates = months[0].updates.assign(day=months[0].updates["t_s"] / DAY)[["day", "sensor", "forward", "update_deg"]]
    for name, table in {"daily": daily, "slews": slews.collect_slew_misses(runs), "updates": updates}.items():
        made.add(name, "", table)


def summarise_mission(tables: dict[str, pd.DataFrame], runs: Runs) -> dict[str, Any]:
    """The numbers that answer the study's questions, as plain values; None for what was not flown."""
    table3, table2, requirements = tables["table3"], tables["table2"], tables["requirements"]

    def periods(parameter: str) -> dict[str, dict[str, float | None]]:
        rows = table3.query("parameter == @parameter and axis == 'yaw'").set_index("period")
        return {name: {key: _convert_missing(rows.loc[name, key]) for key in ("simulated", "flight")} for name in PERIODS}

    angles = table3[table3["parameter"] != "gyro_bias_std_deg_h"]
    difference = tables["biases"].query("axis == 'z' and forward == '-x minus +x'").set_index("period")
    return {
        "yaw_update_deg": periods("yaw_update_deg"),
        "yaw_accuracy_deg": periods("attitude_accuracy_deg"),
        "largest_seed_range_deg": _convert_missing((angles["highest"] - angles["lowest"]).max()),
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
        "slew_deg": {
            maneuver: {
                period: {
                    row["axis"]: {key: _convert_missing(row[f"{key}_deg"]) for key in ("simulated", "std", "flight")}
                    for _, row in rows.iterrows()
                }
                for period, rows in chosen.groupby("tables", sort=False)
            }
            for maneuver, chosen in table2.groupby("maneuver", sort=False)
        },
        "slew_gap_deg": slews.compute_slew_gaps(table2),
        "spikes_deg": {state: _find_largest_errors(runs["spikes", state]) for state in SPIKE_FILTERS},
    }


def _convert_missing(value: Any) -> float | None:
    return None if pd.isna(value) else float(value)


def _find_largest_errors(run: MissionRun) -> dict[str, float]:
    """Largest roll and pitch error, deg, true and as the computer sees it."""
    kinds = {"error": "", "estimate": "_on_board"}
    return {
        f"{axis}{suffix}": float(run.telemetry[f"{kind}_{axis}_deg"].abs().max())
        for axis in ("roll", "pitch")
        for kind, suffix in kinds.items()
    }


def build_answers_table(summary: dict[str, Any]) -> pd.DataFrame:
    """The questions a reader comes with, and the answers of this run."""

    def join_periods(name: str, key: str, digits: int) -> str:
        return " / ".join(f"{{{name}.{period}.{key}:.{digits}f}}" for period in PERIODS)

    def join_axes(period: str) -> str:
        simulated, flown = (
            ", ".join(f"{{slew_deg.{best}.{period}.{axis}.{key}:+.3f}}" for axis in ROTATION_NAMES)
            for key in ("simulated", "flight")
        )
        return f"{simulated} deg; flight {flown}"

    best = min(summary["slew_gap_deg"], key=summary["slew_gap_deg"].__getitem__)
    rows = {
        "Yaw update before, with alignment, calibrated?": f"{join_periods('yaw_update_deg', 'simulated', 3)} deg; flight "
        + join_periods("yaw_update_deg", "flight", 2),
        "Yaw accuracy in the same periods?": f"{join_periods('yaw_accuracy_deg', 'simulated', 3)} deg; flight "
        + join_periods("yaw_accuracy_deg", "flight", 3),
        "Requirements met when calibrated?": _describe_requirements(summary["requirements"]["postcalibration"]),
        "And before?": _describe_requirements(summary["requirements"]["precalibration"]),
        "Does the z bias depend on orientation?": "by {Z.calibration1.simulated:.3f} deg/h before the gyro's upload (R (8): "
        "{Z.calibration1.formula:.3f}), {Z.postcalibration.simulated:.4f} ± {Z.postcalibration.standard_error:.4f} after",
        f"Error of a yaw maneuver, {report_text.format_direction(best)}, before?": join_axes(SLEW_TABLES[0]),
        "And after?": join_axes(SLEW_TABLES[1]),
        "Pitch spikes by the S filter, on board and true?": "{spikes_deg.restarted.pitch_on_board:.3f} and "
        "{spikes_deg.restarted.pitch:.3f} deg restarted wrongly, {spikes_deg.off.pitch_on_board:.3f} and "
        "{spikes_deg.off.pitch:.3f} deg off",
    }
    values = flatten(summary)
    answers = [fill(text.replace("{Z.", "{bias_z_minus_x_less_plus_x_deg_h."), values) for text in rows.values()]
    return pd.DataFrame({"question": rows.keys(), "answer": answers})


def _describe_requirements(requirements: dict[str, dict[str, Any]]) -> str:
    if any(one["met"] is None for name, one in requirements.items() if name != "stability"):
        return render.NO_VALUE
    held = {name: one for name, one in requirements.items() if name != "stability"}
    cells = ", ".join(fill(f"{name} {{worst_axis_deg:.3f}} of {{limit_deg:g}} deg", one) for name, one in held.items())
    return f"{'yes' if all(one['met'] for one in held.values()) else 'NO'}: {cells}; stability is not verified"


def write_mission_report(folder: Path, study: MissionStudy, made: Reproduction) -> None:
    """The page and what is on it."""
    found = report_text.build_mission_checks({name: table.data for name, table in made.tables.items()}, made.summary)
    head = [
        "# Mission Mode beside the flight",
        "",
        report_text.LEAD.strip(),
        "",
        render.format_markdown("Summary", build_answers_table(made.summary)),
        render.format_markdown("What was found", checks.format_checks(found)),
        *(f"- {one}" for one in checks.list_meanings(found)),
        "",
        "## What is not published, and what follows from it",
        "",
        *(f"- {one}" for one in report_text.NOT_PUBLISHED),
        "",
    ]
    closing = (
        f"Months: {study.seeds} seeds of {study.days:g} days; yaw maneuver: {study.slews} seeds. Figures 9 to 11 show the "
        "first seed; `daily.csv` and `updates.csv` hold what they show."
    )
    made.write(folder, "report.md", head, [closing, ""])
