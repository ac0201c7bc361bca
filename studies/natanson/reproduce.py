"""Reproduce the TRMM gyro calibration: the main job.

In order: the flight's published numbers against the simulated motion; the Monte Carlo of N Tables 2–5; accuracy and
consistency of the estimates; N Figures 1–3; everything as CSV, Markdown and SVG with a manifest and ``summary.json``. Another
scenario than TRMM's six intervals has no flight beside it: then the Monte Carlo is all.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal import NAMES
from simulator.scenario import Scenario
from studies.calibration import psi, summaries
from studies.calibration.shared_truth import get_true_parameters
from studies.montecarlo import statistics
from studies.montecarlo.files import write_parquet, write_text
from studies.montecarlo.study import load_base_scenario
from studies.natanson import figures, flight, paper_tables
from studies.natanson.flight_comparison import compare_with_flight, describe_gap
from studies.natanson.omitted_effects import add_omitted_effects
from studies.natanson.paper_forms import TABLE_LAYOUTS, format_ways_table
from studies.natanson.paper_tables import PaperTablesConfig
from studies.report import panels
from studies.report import tables as render
from studies.report.claims import fill
from studies.report.committed_results import flatten, round_values
from studies.reproduction import Reproduction

REPRODUCTION_FOLDER = Path("build") / "reproduction"
CELL_NOTE = (
    "Cells: the flight's value | mean ± standard deviation over seeds | share of seeds below the flight's. "
    "Where nothing flew: mean ± standard deviation. ψ full, samples skipped; the CSV has the other variants and 5-95 % ranges."
)
WAYS_NOTE = "Mean ± standard deviation over seeds, samples skipped."
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
QUESTIONS = """
Residuals before less after calibration (18) | noise-free, timings assumed
| {flight_gap_rms_deg.flight_rms:.3f} deg RMS before | {clean_gap_rms_deg.assumed:.4f} deg
| slews' timings; four common fitted: {clean_gap_rms_deg.common:.4f}, nine: {clean_gap_rms_deg.each:.4f}
| {clean_gap_scan_deg.held_out.before:.4f} to {clean_gap_scan_deg.held_out.after:.4f} deg on intervals 2, 4, 6, each held out

Residuals before calibration (18) | noise-free, R (9) as truth
| {flight_gap_rms_deg.flight_rms:.3f} deg RMS | {flight_gap_rms_deg.published:.4f} deg
| the flight's noise, its residuals after: {flight_gap_rms_deg.floor:.4f} | {clean_gap_rms_deg.assumed:.4f} deg

Residuals after, from those before, 0.5 s | least squares of the flown ones
| N Table 2, calibrated | {own_calibration_rms_deg.assumed.0.5:.4f} deg
| N's {own_calibration.0.5.steepest} is not the least-squares one: it leaves {own_calibration.0.5.gradient_deg:.3f} deg
| {own_calibration.0.5.rms_of_the_others_deg:.4f} deg without {own_calibration_farthest.0.5}

The same, 1 s | least squares | N Table 2, calibrated | {own_calibration_rms_deg.assumed.1:.4f} deg | none
| {own_calibration_rms_deg.assumed.1:.4f} deg

The same, 2 s | least squares | N Table 2, calibrated | {own_calibration.2.as_printed_deg:.4f} deg
| a sign of Table 2, as Table 4 says | {own_calibration_rms_deg.assumed.2:.4f} deg

Second iteration (12 cells) | of the flown residuals, 1 s, in (G, b) | N Table 5
| correlation {SECOND.gain_space.correlation:.2f}; {SECOND.gain_space.rms_1e6_G:.2f}e-6,
{SECOND.gain_space.rms_1e8_deg_s:.1f}e-8 deg/s | N iterates in gyro space
| correlation {SECOND.gyro_space.correlation:.2f}; {SECOND.gyro_space.rms_1e6_G:.2f}e-6,
{SECOND.gyro_space.rms_1e8_deg_s:.1f}e-8 deg/s

The same, G⁻¹ at 0.5 s | in gyro space | N Table 5
| correlation {SECOND.gyro_space.correlation:.2f}; {SECOND.gyro_space.rms_1e6_G:.2f}e-6
| its G⁻¹ is of 0.5 s, as its first iteration's
| correlation {SECOND.gyro_space.with_G_of_0.5_s.correlation:.2f}; {SECOND.gyro_space.with_G_of_0.5_s.rms_1e6_G:.2f}e-6

Printed digits the second iteration changes, 0.5 s
| {own_digits_changed.0.5.table2} of 18 in Table 2, {own_digits_changed.0.5.table4} of 6 in Table 4 | none, says N
| – | unknown | –

Rate about x in -y forward | +1 RPO, as printed | N Table 2, interval 4 | {minus_y_rate_rpo.gap_rms_deg.1:.3f} deg
| it is -1 RPO | {minus_y_rate_rpo.gap_rms_deg.-1:.3f} deg
""".replace("SECOND", "table5_second_iteration")
REPRODUCTION_TEXT = """
*Predicted* is the noise-free simulation with R eq. (9) as truth, processed with the pre-launch parameters of N Table 3. The
*clean gap* is θ_pre − θ_cal − predicted, θ_pre and θ_cal being the flight's residuals before and after calibration: its noise
cancels, and what is left is the motion's, and print. The *gap* is θ_pre − predicted, and its *floor* θ_cal. The slews' timings
are not published: they are assumed (60 s after the interval's start, 0.25 deg/s, about an hour in -y forward, one orbit in
inertial hold), and the *timing scan* says what others give. *NEES* is the normalised estimation error squared; its mean must be
the number of parameters, 12, and its bounds are 99 %. N is Natanson (1998), R is Robertson et al. (1999).

*What is circular.* The truth put in, R (9), is what N fitted to these very residuals; the simulated gyro noise is taken from
the spread between the step sizes of N Table 2, the references' sigma from the residuals after calibration. So the gap near
its floor, the simulated scatter and the percentiles of the calibrated columns, near 50 % in Table 3, hold by construction: they
show that the chain is consistent with itself. Not circular are the clean gap with assumed timings (which were guessed with the
paper at hand: see the scan), the rival signs and directions, the calibration of the flight's own residuals, which takes
nothing but the motion from the simulator, and N Table 5's second iteration, which follows from it.
"""


def run(
    folder: Path = REPRODUCTION_FOLDER,
    config: PaperTablesConfig | None = None,
    jobs: int = 1,
    console: Console | None = None,
) -> dict[str, Any]:
    """Do the whole reproduction and return the summary.

    Parameters
    ----------
    folder : where everything is written
    config : cases, entropy, scenario and overrides of the Monte Carlo; TRMM's by default
    jobs : worker processes; the results do not depend on it
    console : for tables; None prints nothing
    """
    config = config or PaperTablesConfig()
    scenario = load_base_scenario(config)
    made = Reproduction(console or Console(quiet=True), jobs)
    outcome = made.run(paper_tables.STUDY, config, folder)
    rows = outcome.load()
    if flight.matches_flight(scenario):
        compare_with_flight(scenario, made, config.entropy)
        add_omitted_effects(scenario, made, config.entropy)
    made.summary |= {"cases": config.cases, "entropy": config.entropy}
    add_monte_carlo_tables(rows, config, scenario, made)
    if any(interval.slew for interval in scenario.interval):
        made.add("psi_sweep", "Linear against full ψ over slew rate and step, noise-free", psi.run(scenario))
    write_reproduction(folder, config, scenario, made, rows)
    made.publish(outcome, folder, command="gyrocal reproduce")
    return made.summary


def build_estimates_table(summary: dict[str, Any]) -> pd.DataFrame:
    """The questions on the estimates, and the answers of this run."""
    percent = dict(zip(("one", "two", "three"), (100 * share for share in summary["coverage"].values()), strict=True))
    percent |= {name: 100 * (1 - summary["printed_digits"][f"{name}_unchanged_share"]) for name in ("table2", "table4")}
    words = {
        "unbiased": "yes" if summary["bias_in_standard_errors_max"] < 4 else "NO",
        "consistent": "yes" if summary["nees"]["inside"] else "NO",
        "control": "yes" if summary["nees_references_only"]["inside"] else "no",
    }
    answers = [fill(text, flatten(summary), **percent, **words) for text in ESTIMATES.values()]
    return pd.DataFrame({"question": ESTIMATES.keys(), "answer": answers})


def build_question_table(summary: dict[str, Any]) -> pd.DataFrame:
    """Build the table of questions on where simulation and the flight of N differ, a row each."""
    names = ["question", "simulated", "flown", "gap before", "effect found", "gap after, on numbers that fitted nothing"]
    rows = fill(" ".join(QUESTIONS.replace("\n\n", "¶").split()), flatten(summary)).split("¶")
    return pd.DataFrame([[cell.strip() for cell in row.split("|")] for row in rows], columns=names)


def add_monte_carlo_tables(rows: pd.DataFrame, config: PaperTablesConfig, scenario: Scenario, made: Reproduction) -> None:
    """The paper's tables, and how right and how consistent the estimates are."""
    for name, table in paper_tables.build_paper_tables(rows, config).items():
        note = CELL_NOTE if name in TABLE_LAYOUTS else ""
        made.add(name, table.title, table.data, note=note, shown=table.shown)
        if name in TABLE_LAYOUTS:
            made.show(name)
            if TABLE_LAYOUTS[name].ways_digits is not None:
                title = f"{table.title.split(':')[0]}, both ψ and both iterations"
                made.add(f"{name}_ways", title, format_ways_table(table.data, name), note=WAYS_NOTE)
    found = {name: made.tables[name].data for name in paper_tables.PAPER_TABLE_TITLES}
    finest, usual = scenario.gyro.sample_s, "psi == 'full' and step_s == @finest"
    headline = found["accuracy"].query(usual).drop(columns=["psi", "resampling", "step_s"])
    short = headline[[c for c in headline.columns if not c.endswith(("_low", "_high"))]]
    render.print_table(made.console, f"Recovered minus injected, ψ full, Δt = {finest:g} s", short)
    made.show("consistency", "second_iteration", "printed_digits", "psi_difference")
    chosen = paper_tables.select_variant(rows, finest)
    counts = {
        level: summaries.count_covered(*compute_variant_errors(chosen, scenario), level) for level in summaries.SIGMA_LEVELS
    }
    nees, control = (
        statistics.check_mean_nees(paper_tables.select_variant(rows, finest, covariance=model)["nees"].to_numpy(), len(NAMES))
        for model in ("full", "references only")
    )
    second = found["second_iteration"].query(usual).iloc[0]
    made.summary |= {
        f"second_iteration_{how}": {name: float(second[f"{name}_{how}"]) for name in ("G", "bias_deg_s")}
        for how in ("max", "median")
    }
    between = found["psi_difference"].query("step_s == @finest")
    made.summary |= {
        "printed_digits": found["printed_digits"].query(usual).iloc[0, 3:].to_dict(),
        "psi_difference_max": {name: float(between[name].max()) for name in ("G", "bias_deg_s")},
        "coverage": {level: inside / total for level, (inside, total) in counts.items()},
        "nees": {"value": nees.value, "bounds": [nees.lower, nees.upper], "dof": nees.dof, "inside": nees.is_inside},
        "nees_references_only": {"value": control.value, "bounds": [control.lower, control.upper], "inside": control.is_inside},
        "bias_in_standard_errors_max": float(np.abs(headline["bias_in_standard_errors"]).max()),
    }


def compute_variant_errors(rows: pd.DataFrame, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """Recovered minus injected, and formal sigma, of rows of one variant."""
    return paper_tables.compute_errors_and_sigmas(rows, get_true_parameters(scenario))


def write_reproduction(
    folder: Path, config: PaperTablesConfig, scenario: Scenario, made: Reproduction, rows: pd.DataFrame
) -> None:
    """Tables as CSV and each as Markdown, one Markdown page, the rows as Parquet, the figures."""
    made.summary, flown = round_values(made.summary), "flight_gap" in made.tables
    summary = {"Summary": build_estimates_table(made.summary)}
    if flown:
        summary |= {"What parts simulated and flown": build_question_table(made.summary)}
    head = [
        f"# Reproduction of the TRMM gyro calibration{'' if flown else f': {scenario.title}'}",
        "",
        f"{config.cases} seeds, entropy {config.entropy}; `gyrocal reproduce` makes this page.",
        "",
        render.format_markdown("Summary", summary["Summary"], REPRODUCTION_TEXT.strip() if flown else ""),
        *(render.format_markdown(title, table) for title, table in list(summary.items())[1:]),
        describe_gap(made.summary) if flown else "No flight stands beside this scenario.",
        "",
    ]
    write_parquet(folder / "cases.parquet", rows)
    if flown:
        made.figures |= {name: ("", draw) for name, draw in figures.draw_natanson_figures(scenario).items()}
        table2 = made.tables["table2"].data.query(
            "psi == 'full' and resampling == 'skip' and step_s == 0.5 and phase == 'prelaunch'"
        )
        draw = figures.draw_flight_gap_figure(made.tables["flight_gap"].data, table2.reset_index(drop=True))
        made.figures["flight_gap"] = ("", draw)
    errors, sigmas = compute_variant_errors(paper_tables.select_variant(rows, scenario.gyro.sample_s), scenario)
    made.figures["errors"] = ("", figures.draw_error_figure(errors, sigmas, list(NAMES)))
    if "psi_sweep" in made.tables:
        made.figures["psi_sweep"] = ("", panels.build_sheet(psi.make_psi_map(made.tables["psi_sweep"].data), size=(6.0, 3.6)))
    made.write(folder, "tables.md", head)
    for name in made.tables:
        write_text(folder / f"{name}.md", made.format_section(name))
    for title, table in summary.items():
        render.print_table(made.console, title, table)
