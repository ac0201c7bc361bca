"""Reproduce the TRMM gyro calibration: N Tables 2 to 5 and Figures 1 to 3 beside the flight's published values.

A scenario other than TRMM's six intervals has no flight to compare with: then the Monte Carlo is all.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal import NAMES
from simulator.scenario import Scenario
from simulator.simulate import motion
from studies.calibration import summaries
from studies.calibration.shared_truth import get_true_parameters
from studies.montecarlo import statistics
from studies.montecarlo.files import write_parquet
from studies.montecarlo.study import load_base_scenario
from studies.natanson import flight, flight_gap, flight_recalibration, paper_forms, paper_tables, slew_timings
from studies.natanson.flight_diagnosis.table import compute_motion_numbers, load_present_baseline, read_flight_residual_table
from studies.natanson.paper_tables import PaperTablesConfig
from studies.report import panels
from studies.report.claims import fill
from studies.report.committed_results import flatten, round_values
from studies.report.panels import AXIS_COLOURS, AXIS_LINE_STYLES, Draw, Line, Panel
from studies.report.tables import Table
from studies.report.units import ONE_DEG_S
from studies.reproduction import Reproduction

ESTIMATES = {  # questions on the estimates, with or without a flight
    "Are the estimates unbiased?": "largest of 12 means {bias_in_standard_errors_max:.1f} standard errors ({unbiased}: below "
    "4)",
    "Are the claimed sigmas consistent?": "{consistent}: NEES {nees.value:.1f} in [{nees.bounds.0:.1f}, {nees.bounds.1:.1f}]; "
    "{one:.1f} / {two:.1f} / {three:.2f} % within 1 / 2 / 3 sigma",
    "And the paper's, without gyro noise?": "{control}: NEES {nees_references_only.value:.1f}",
    "Does one iteration do?": "the second changes G by {second_iteration_median.G:.1e}, residuals by up to "
    "{printed_digits.largest_median_mdeg:.2f} mdeg (medians), a printed digit of N Table 2 in {table2:.0f} %, of Table 4 in "
    "{table4:.0f} % of cases",
    "Does linear ψ do?": "at TRMM's rates it differs by {psi_difference_max.G:.1e} in G",
}
TABLE_NOTES = {
    "table2": "Residuals before and after calibration in deg: simulated mean ± standard deviation over the seeds. ψ is full, "
    "and samples are skipped, as N did.",
    "table3": "Bias in 1e-4 deg/s, scale factor minus one in 1e-5, misalignment to a body axis in deg.",
    "table4": "Over the six intervals, in deg. N's RMS is the norm divided by six; the true RMS of the flight follows from N "
    "Table 2.",
    "table5": "First iteration: 1e-3 for the elements of G⁻¹ at 0.5 s, 1e-5 deg/s for the biases at 1 s, as the printed "
    "numbers are. Second iteration: 1e-6 and 1e-8 deg/s, recalculated from the flight's own residuals at 1 s in gyro space.",
}

# Intervals and axes. In inertial hold z stays within the line's width of zero, as N says.
FIGURE_LAYOUTS = {
    "figure1_yaw_maneuvers": [(1, "xyz"), (5, "xyz")],
    "figure2_minus_y_forward": [(3, "xyz")],
    "figure3_inertial_hold": [(4, "xy")],
}
FIGURE_TITLES = {
    "figure1_yaw_maneuvers": "N Figure 1: body rates during both yaw maneuvers, simulated",
    "figure2_minus_y_forward": "N Figure 2: body rates in -y forward, simulated",
    "figure3_inertial_hold": "N Figure 3: body rates during inertial hold, simulated",
    "table3_distributions": "N Table 3 at 0.5 s: simulated calibrations, and the flight's value (red line)",
}


def run(folder: Path, config: PaperTablesConfig, jobs: int, console: Console) -> dict[str, Any]:
    """Reproduce the paper in worker processes, write tables and figures to a folder, and return the summary."""
    scenario = load_base_scenario(config)
    reproduction = Reproduction(console, jobs)
    outcome = reproduction.run(paper_tables.STUDY, config, folder)
    rows = outcome.load()
    reproduction.summary |= {"cases": config.cases, "entropy": config.entropy}
    reproduction.tables = paper_tables.build_paper_tables(rows, config)
    reproduction.summary |= summarise_estimates(reproduction.tables, rows, scenario)
    if flight.matches_flight(scenario):
        compare_with_flight(scenario, reproduction)
        finest_rows = paper_tables.select_variant(rows, flight.FLIGHT_STEPS_S[0])
        reproduction.figures |= draw_figures(scenario, finest_rows)
    reproduction.summary = round_values(reproduction.summary)
    write_parquet(folder / "cases.parquet", rows)
    page_tables = [Table("Summary", build_estimates_table(reproduction.summary)), *build_page_tables(reproduction.tables)]
    title = f"# Reproduction of the TRMM gyro calibration: {scenario.title}"
    head = [title, "", f"{config.cases} seeds, entropy {config.entropy}.", ""]
    reproduction.publish(outcome, folder, "tables.md", head, page_tables, command="gyrocal reproduce")
    return reproduction.summary


def compare_with_flight(scenario: Scenario, reproduction: Reproduction) -> None:
    """Add tables and summary of the flight's own numbers."""
    scan = slew_timings.scan_common_timings(scenario)
    reproduction.tables |= {"timing_scan": scan, "flight_gap": flight_gap.build_gap_comparison(scenario)}
    add_recalibration_tables(scenario, reproduction)
    reproduction.summary |= summarise_prediction(scenario, scan) | flight_gap.compare_signs(scenario)
    reproduction.summary["flight_noise"] = flight_gap.estimate_noise_from_steps()


def summarise_prediction(scenario: Scenario, scan: pd.DataFrame) -> dict[str, Any]:
    """Summarise gap and clean gap with assumed and scanned timings, and the effect of rounding; deg."""
    predicted, clean = flight_gap.predict_residuals(scenario), scan["clean_gap_rms_deg"]
    assumed = flight_gap.compute_clean_gap_rms(predicted)
    covariance = compute_motion_numbers(read_flight_residual_table(), load_present_baseline()).covariance
    return {
        "clean_gap_rms_deg": {"assumed": assumed},
        "clean_gap_scan_deg": {
            **{statistic: float(getattr(clean, statistic)()) for statistic in ("min", "median", "max")},
            "timings": len(scan),
            "share_below_assumed": float(np.mean(clean < assumed)),
            "print": float(np.sqrt(np.mean(np.diag(covariance)))),
        },
        "flight_gap_rms_deg": {
            "published": flight_gap.compute_gap_rms(predicted),
            "scan_min": float(scan["gap_rms_deg"].min()),
            "scan_max": float(scan["gap_rms_deg"].max()),
            "floor": flight_gap.compute_floor_rms(),
            "flight_rms": float(flight.compute_rms(flight.read_published_residuals("prelaunch").ravel())),
        },
    }


def add_recalibration_tables(scenario: Scenario, reproduction: Reproduction) -> None:
    """Add the recalibration of the flight's residuals, compared with N's results, and N Table 5's second iteration."""
    calibrations = flight_recalibration.calibrate_each_step(scenario)
    agreement = flight_recalibration.compare_residuals_by_step(calibrations)
    second = flight_recalibration.build_second_iteration_table(scenario)
    reproduction.tables |= {"own_agreement": agreement, "table5_second": second}
    by_step = agreement.set_index(agreement["step_s"].map("{:g}".format))
    reproduction.summary |= {
        "own_calibration_rms_deg": by_step["rms_difference_deg"].to_dict(),
        "own_calibration": by_step[["as_printed_deg", "steepest", "gradient_deg"]].to_dict("index"),
        "own_digits_changed": flight_recalibration.count_changed_digits(calibrations),
        "table5_second_iteration": flight_recalibration.score_second_iteration(second),
    }


def build_page_tables(tables: dict[str, pd.DataFrame]) -> list[Table]:
    """Format N Tables 2 to 5 with simulated and flight values; Tables 2 to 4 once per propagation step."""
    page_tables = []
    for name in ("table2", "table3", "table4"):
        title, note = paper_tables.PAPER_TABLE_TITLES[name], TABLE_NOTES[name]
        for step, part in paper_forms.format_paper_table(tables[name], name).groupby("Δt (s)", sort=False):
            page_tables.append(Table(f"{title}, Δt = {step} s", part.drop(columns="Δt (s)"), note))
            note = ""
    corrections = paper_forms.format_corrections(tables["table5"], tables.get("table5_second"))
    return [*page_tables, Table(paper_tables.PAPER_TABLE_TITLES["table5"], corrections, TABLE_NOTES["table5"])]


def draw_figures(scenario: Scenario, rows: pd.DataFrame) -> dict[str, tuple[str, Draw]]:
    """Draw N Figures 1 to 3, and the distributions of the parameters of N Table 3 at 0.5 s."""
    cells, samples = paper_forms.convert_to_gyro_form(rows[[f"first_{name}" for name in NAMES]].to_numpy())
    published = flight.read_published_parameters("calibrated", flight.FLIGHT_STEPS_S[0]).vector * ONE_DEG_S
    (values,) = paper_forms.convert_to_gyro_form(published[None])[1]
    distributions = []
    for k, (quantity, gyro) in enumerate(cells):
        offset, scale, _ = paper_forms.UNITS.get(("table3", quantity), (0.0, 1.0, 3))
        title = f"{gyro} gyro, {paper_forms.WORDS[quantity]}"
        simulated, flown = (samples[:, k] - offset) * scale, (values[k] - offset) * scale
        distributions.append(panels.make_distribution(simulated, flown, title=title))
    sheets = draw_body_rates(scenario)
    sheets["table3_distributions"] = panels.build_sheet(*distributions, size=(6.4, 6.4), columns=3)
    return {name: (FIGURE_TITLES[name], sheet) for name, sheet in sheets.items()}


def draw_body_rates(scenario: Scenario) -> dict[str, Draw]:
    """Draw N Figures 1–3: body rates through both yaw maneuvers, in -y forward, and in inertial hold."""
    truth = motion(scenario)

    def body_rates(k: int, axis_names: str) -> Panel:
        part, interval = truth.intervals[k], scenario.interval[k]
        minutes, rates = (truth.t_s[part] - interval.start_s) / 60, np.rad2deg(truth.rates[part])
        start = pd.Timestamp(scenario.epoch) + pd.Timedelta(seconds=interval.start_s)
        lines = [
            Line(minutes, rates[:, "xyz".index(axis)], f"ω$_{axis}$", AXIS_COLOURS[axis], AXIS_LINE_STYLES[axis])
            for axis in axis_names
        ]
        title = f"{interval.name}: {interval.activity}, from {start:%Y-%m-%d %H:%M} UTC"
        axes: dict[str, Any] = {"x": "minutes from the interval's start", "y": "body rate (deg/s)", "legend": "best"}
        return panels.make_curves(lines, title=title, **axes)

    panels_of = {name: [body_rates(k, axis_names) for k, axis_names in parts] for name, parts in FIGURE_LAYOUTS.items()}
    return {name: panels.build_sheet(*rows, size=(6.4, 2.5 * len(rows)), columns=1) for name, rows in panels_of.items()}


def build_estimates_table(summary: dict[str, Any]) -> pd.DataFrame:
    """Build the table of questions on the estimates and this run's answers."""
    percent = dict(zip(("one", "two", "three"), (100 * share for share in summary["coverage"].values()), strict=True))
    percent |= {name: 100 * (1 - summary["printed_digits"][f"{name}_unchanged_share"]) for name in ("table2", "table4")}
    words = {
        "unbiased": "yes" if summary["bias_in_standard_errors_max"] < 4 else "NO",
        "consistent": "yes" if summary["nees"]["inside"] else "NO",
        "control": "yes" if summary["nees_references_only"]["inside"] else "no",
    }
    answers = [fill(text, flatten(summary), **percent, **words) for text in ESTIMATES.values()]
    return pd.DataFrame({"question": ESTIMATES.keys(), "answer": answers})


def summarise_estimates(tables: dict[str, pd.DataFrame], rows: pd.DataFrame, scenario: Scenario) -> dict[str, Any]:
    """Summarise how right and how consistent the estimates are, with full ψ at the scenario's own step."""
    finest, query = scenario.gyro.sample_s, "psi == 'full' and step_s == @finest"
    errors = paper_tables.compute_errors_and_sigmas(paper_tables.select_variant(rows, finest), get_true_parameters(scenario))
    counts = {level: summaries.count_covered(*errors, level) for level in summaries.SIGMA_LEVELS}
    nees, control = (
        statistics.check_mean_nees(paper_tables.select_variant(rows, finest, covariance=model)["nees"].to_numpy(), len(NAMES))
        for model in ("full", "references only")
    )
    second = tables["second_iteration"].query(query).iloc[0]
    psi_difference = tables["psi_difference"].query("step_s == @finest")
    bias = tables["accuracy"].query(query)["bias_in_standard_errors"]
    return {
        **{
            f"second_iteration_{statistic}": {name: float(second[f"{name}_{statistic}"]) for name in ("G", "bias_deg_s")}
            for statistic in ("max", "median")
        },
        "printed_digits": second.filter(regex="table|largest").to_dict(),
        "psi_difference_max": {name: float(psi_difference[name].max()) for name in ("G", "bias_deg_s")},
        "coverage": {level: inside / total for level, (inside, total) in counts.items()},
        "nees": {"value": nees.value, "bounds": [nees.lower, nees.upper], "dof": nees.dof, "inside": nees.is_inside},
        "nees_references_only": {"value": control.value, "bounds": [control.lower, control.upper], "inside": control.is_inside},
        "bias_in_standard_errors_max": float(np.abs(bias).max()),
    }
