"""Reproduce the TRMM gyro calibration: the main job.

In order: the flight's published numbers against the simulated motion; the Monte Carlo of N Tables 2–5; accuracy and
consistency of the estimates; N Figures 1–3; everything as CSV, Markdown and SVG with a manifest and ``summary.json``. Another
scenario than TRMM's six intervals has no flight beside it: then the Monte Carlo is all.
"""

import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal import NAMES
from simulator.scenario import Scenario
from studies.calibration import psi
from studies.calibration.prepared import true_parameters
from studies.montecarlo import engine, statistics
from studies.montecarlo.backends import Name
from studies.montecarlo.files import write_csv, write_json, write_parquet, write_text
from studies.montecarlo.study import base_scenario
from studies.natanson import figures, flight, paper_tables
from studies.natanson.flight_part import flight_part, gap_note, summary_rows
from studies.natanson.left_out import left_out
from studies.natanson.paper_forms import LAYOUTS, paper_form, ways_form
from studies.natanson.paper_tables import PaperTablesConfig
from studies.natanson.products import Products
from studies.natanson.questions import question_table
from studies.report import panels
from studies.report import tables as render
from studies.report.committed import DIGITS, settled
from studies.report.console import progress

DEFAULT_FOLDER = Path("build") / "reproduction"
TITLES = {
    "table2": "N Table 2: residuals (deg)",
    "table3": "N Table 3: calibration parameters",
    "table4": "N Table 4: mean and RMS over the intervals (deg)",
    "table5": "N Table 5: corrections to b (deg/s) and G⁻¹, iterated in (G, b)",
}
CELL_NOTE = (
    "Cells: the flight's value | mean ± standard deviation over seeds | share of seeds below the flight's. "
    "Where nothing flew: mean ± standard deviation. ψ full, samples skipped; the CSV has the other variants and 5-95 % ranges."
)
ESTIMATES = (  # questions on the estimates, with or without a flight
    "Are the estimates unbiased?",
    "Are the claimed sigmas consistent?",
    "And the paper's, without gyro noise?",
    "Does one iteration do?",
    "Does linear ψ do?",
)
WAYS_NOTE = "Mean ± standard deviation over seeds, samples skipped."
WORDS = """
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
    folder: Path = DEFAULT_FOLDER,
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
    started = time.monotonic()
    out = console or Console(quiet=True)
    config = config or PaperTablesConfig()
    scenario = base_scenario(config)
    products = Products(out)
    display = partial(progress, quiet=out.quiet)
    work = engine.work_folder(folder, paper_tables.STUDY, config)
    backend: Name = "loky" if jobs > 1 else "serial"
    outcome = engine.run(paper_tables.STUDY, config, work, backend=backend, jobs=jobs, progress=display)
    outcome.check()
    rows = outcome.load()
    if flight.flew(scenario):
        flight_part(scenario, products, config.entropy)
        left_out(scenario, products, config.entropy)
    products.summary |= {"cases": config.cases, "entropy": config.entropy}
    monte_carlo_part(rows, scenario, products)
    if any(interval.slew for interval in scenario.interval):
        products.add("psi_sweep", "Linear against full ψ over slew rate and step, noise-free", psi.run(scenario))
    products.summary = settled(products.summary)
    write(folder, config, scenario, products, rows)
    write_json(folder / "summary.json", products.summary)
    wall_s = round(time.monotonic() - started, 2)
    engine.publish(outcome, folder, command="gyrocal reproduce", wall_s=wall_s)
    render.terminal(out, "Summary", summary_table(products.summary))
    out.print(f"Written to {folder} in {wall_s:.0f} s.", highlight=False)
    return products.summary


def summary_table(summary: dict[str, Any]) -> pd.DataFrame:
    """The questions a reader comes with, and the answers of this run."""
    nees, paper, shares = summary["nees"], summary["nees_references_only"], summary["coverage"]
    inside = f"NEES {nees['value']:.1f} in [{nees['bounds'][0]:.1f}, {nees['bounds'][1]:.1f}]"
    changed = {name: 100 * (1 - summary["printed_digits"][f"{name}_unchanged_share"]) for name in ("table2", "table4")}
    rows = summary_rows(summary) if "clean_gap_rms_deg" in summary else {}
    answers = (
        f"largest of 12 means {summary['bias_in_standard_errors_max']:.1f} standard errors "
        f"({'yes' if summary['bias_in_standard_errors_max'] < 4 else 'NO'}: below 4)",
        f"{'yes' if nees['inside'] else 'NO'}: {inside}; "
        f"{100 * shares['68']:.1f} / {100 * shares['95']:.1f} / {100 * shares['99.7']:.2f} % within 1 / 2 / 3 sigma",
        f"{'yes' if paper['inside'] else 'no'}: NEES {paper['value']:.1f}",
        f"the second changes G by {summary['second_iteration_median']['G']:.1e}, residuals by up to "
        f"{summary['printed_digits']['largest_median_mdeg']:.2f} mdeg (medians), a printed digit of N Table 2 in "
        f"{changed['table2']:.0f} %, of Table 4 in {changed['table4']:.0f} % of cases",
        f"at TRMM's rates it differs by {summary['psi_difference_max']['G']:.1e} in G",
    )
    rows |= dict(zip(ESTIMATES, answers, strict=True))
    return pd.DataFrame({"question": rows.keys(), "answer": rows.values()})


def monte_carlo_part(rows: pd.DataFrame, scenario: Scenario, products: Products) -> None:
    """The paper's tables, and how right and how consistent the estimates are."""
    truth, add = true_parameters(scenario), products.add
    flown = flight.flew(scenario)
    for name, title in TITLES.items():
        table = getattr(paper_tables, name)(rows, flown)
        add(name, title, table, note=CELL_NOTE, shown=paper_form(table, name))
        products.show(name)
        if LAYOUTS[name].ways_digits is not None:
            add(f"{name}_ways", f"{title.split(':')[0]}, both ψ and both iterations", ways_form(table, name), note=WAYS_NOTE)
    accuracy = add("accuracy", "Recovered minus injected", paper_tables.accuracy(rows, truth))
    add("consistency", "Consistency of the claimed covariance", paper_tables.consistency(rows, truth))
    between = add("psi_difference", "Largest difference between full and linear ψ", paper_tables.psi_difference(rows))
    second = add("second_iteration", "Size of the second iteration's corrections", paper_tables.second_iteration(rows))
    digits = add("printed_digits", "Printed digits the second iteration changes", paper_tables.printed_digits(rows))
    finest = scenario.gyro.sample_s
    headline = accuracy.query("psi == 'full' and step_s == @finest").drop(columns=["psi", "resampling", "step_s"])
    short = headline[[c for c in headline.columns if not c.endswith(("_low", "_high"))]]
    render.terminal(products.console, f"Recovered minus injected, ψ full, Δt = {finest:g} s", short)
    products.show("consistency", "second_iteration", "printed_digits", "psi_difference")
    chosen = paper_tables.choose(rows, finest)
    errors, sigmas = paper_tables.errors_and_sigmas(chosen, truth)
    check = statistics.nees_check(chosen["nees"].to_numpy(), len(NAMES))
    paper = statistics.nees_check(
        paper_tables.choose(rows, finest, covariance="references only")["nees"].to_numpy(), len(NAMES)
    )
    counts = {level: statistics.coverage(errors, sigmas, level) for level in statistics.LEVELS}
    at_finest = second.query("psi == 'full' and step_s == @finest").iloc[0]
    psi_finest = between.query("step_s == @finest")
    products.summary |= {
        "second_iteration_max": {"G": float(at_finest["G_max"]), "bias_deg_s": float(at_finest["bias_deg_s_max"])},
        "second_iteration_median": {"G": float(at_finest["G_median"]), "bias_deg_s": float(at_finest["bias_deg_s_median"])},
        "printed_digits": digits.query("psi == 'full' and step_s == @finest").iloc[0, 3:].to_dict(),
        "psi_difference_max": {name: float(psi_finest[name].max()) for name in ("G", "bias_deg_s")},
        "coverage": {level: inside / total for level, (inside, total) in counts.items()},
        "nees": {"value": check.value, "bounds": [check.lower, check.upper], "dof": check.dof, "inside": check.inside},
        "nees_references_only": {"value": paper.value, "bounds": [paper.lower, paper.upper], "inside": paper.inside},
        "bias_in_standard_errors_max": float(np.abs(headline["bias_in_standard_errors"]).max()),
    }


def write(folder: Path, config: PaperTablesConfig, scenario: Scenario, products: Products, rows: pd.DataFrame) -> None:
    """Tables as CSV, one Markdown page, the rows as Parquet, the figures."""
    flown = "flight_gap" in products.tables
    write_parquet(folder / "cases.parquet", rows)
    sections = [
        f"# Reproduction of the TRMM gyro calibration{'' if flown else f': {scenario.title}'}",
        "",
        f"{config.cases} seeds, entropy {config.entropy}; `gyrocal reproduce` makes this page.",
        "",
        render.markdown("Summary", summary_table(products.summary), WORDS.strip() if flown else ""),
        render.markdown("What parts simulated and flown", question_table(products.summary)) if flown else "",
        gap_note(products.summary) if flown else "No flight stands beside this scenario.",
        "",
    ]
    for name, table in products.tables.items():
        write_csv(folder / f"{name}.csv", table.data, digits=DIGITS)
        text = render.markdown(table.title, table.for_people(), table.note, table.formats)
        write_text(folder / f"{name}.md", text)
        sections.append(text)
    write_text(folder / "tables.md", "\n".join(sections))
    if flown:
        figures.natanson_figures(scenario, folder)
        table2 = products.tables["table2"].data.query(
            "psi == 'full' and resampling == 'skip' and step_s == 0.5 and phase == 'prelaunch'"
        )
        figures.flight_gap_figure(products.tables["flight_gap"].data, table2.reset_index(drop=True), folder / "flight_gap.svg")
    chosen = paper_tables.choose(rows, scenario.gyro.sample_s)
    errors, sigmas = paper_tables.errors_and_sigmas(chosen, true_parameters(scenario))
    figures.error_figure(errors, sigmas, list(NAMES), folder / "errors.svg")
    if "psi_sweep" in products.tables:
        panels.sheet(psi.map_of(products.tables["psi_sweep"].data), size=(6.0, 3.6))(folder / "psi_sweep.svg")
