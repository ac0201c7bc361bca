"""Reproduce the TRMM gyro calibration: the main job.

In order: the flight's published numbers against prediction (signs, timings, noise); the Monte Carlo of N Tables 2–5; accuracy
and consistency of the estimates; N Figures 1–3; everything as CSV, Markdown and SVG with a manifest and ``summary.json``.
"""

import tempfile
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from gyrocal import NAMES, GyrocalError, GyroParameters
from simulator.scenario import Scenario
from studies.calibration import psi
from studies.montecarlo import engine, statistics
from studies.montecarlo.backends import Name
from studies.montecarlo.manifest import manifest, write_json
from studies.montecarlo.study import base_scenario, resolved
from studies.natanson import figures, flight, flight_gap, paper_tables
from studies.natanson.paper_layout import LAYOUTS, paper_layout
from studies.report import panels
from studies.report import tables as render
from studies.report.console import progress

DEFAULT_FOLDER = Path("results") / "reproduction"
TITLES = {
    "table2": "N Table 2: residuals (deg)",
    "table3": "N Table 3: calibration parameters after the first iteration",
    "table4": "N Table 4: mean and RMS over the intervals (deg)",
    "table5": "N Table 5: corrections to b and G⁻¹",
}
CELL_NOTE = (
    "Cells: the flight's value | mean ± standard deviation over seeds | share of seeds below the flight's. "
    "Where nothing flew: mean ± standard deviation. ψ full, samples skipped; the CSV has the other variants and 5-95 % ranges."
)
WORDS = """
*Predicted* is the noise-free simulation with R eq. (9) as truth, processed with the pre-launch parameters of N Table 3; the
*gap* is flown minus predicted. Nothing in it is fitted, but the slews' timings are not published: they are assumed (60 s after
the interval's start, 0.25 deg/s, about an hour in -y forward, one orbit in inertial hold), and the *timing scan* shows the gap
for other assumptions. The *floor* is the flight's residual after its calibration, what the gap would be with the true timings.
*NEES* is the normalised estimation error squared; its mean must be the number of parameters, 12, and its bounds are 99 %.
N is Natanson (1998), R is Robertson et al. (1999).
"""


@dataclass
class Products:
    """Tables by name, and the summary they give."""

    tables: dict[str, pd.DataFrame] = field(default_factory=dict)
    titles: dict[str, str] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)

    def add(self, name: str, title: str, table: pd.DataFrame) -> pd.DataFrame:
        """Keep a table."""
        self.tables[name], self.titles[name] = table, title
        return table


def run(
    folder: Path = DEFAULT_FOLDER, cases: int = 200, jobs: int = 1, entropy: int = 1998, console: Console | None = None
) -> dict[str, Any]:
    """Do the whole reproduction and return the summary.

    Parameters
    ----------
    folder : where everything is written
    cases : seeds of the Monte Carlo
    jobs : worker processes; the results do not depend on it
    entropy : root of the random streams
    console : for tables; None prints nothing
    """
    started = time.monotonic()
    out = console or Console(quiet=True)
    config = paper_tables.PaperTablesConfig(cases=cases, entropy=entropy)
    scenario = base_scenario(config)
    folder.mkdir(parents=True, exist_ok=True)
    products = Products()
    flight_part(scenario, products, out)
    rows = monte_carlo_part(config, scenario, products, jobs, out)
    psi_part(scenario, products, out)
    write(folder, config, scenario, products, rows)
    config_values = resolved(config).model_dump(mode="json")
    write_json(folder / "summary.json", products.summary)
    write_json(folder / "manifest.json", manifest("gyrocal reproduce", config_values, folder, time.monotonic() - started))
    render.terminal(out, "Summary", summary_table(products.summary))
    out.print(f"Written to {folder} in {time.monotonic() - started:.0f} s.", highlight=False)
    return products.summary


def flight_part(scenario: Scenario, products: Products, out: Console) -> None:
    """The flight's numbers: prediction, signs, timings, noise."""
    with progress("flight gap", 7, out.quiet) as advance:
        comparison = products.add(
            "flight_gap", "Pre-launch residuals at 0.5 s: flown and predicted", flight_gap.comparison(scenario)
        )
        advance(1)
        sign = products.add("residual_sign", "Sign of the residual", flight_gap.residual_sign(scenario))
        scan = products.add("timing_scan", "Gap over guesses of the common timings", flight_gap.timing_scan(scenario))
        advance(1)
        common = flight_gap.fit_common(scenario)
        advance(1)
        each = flight_gap.fit_each(scenario)
        advance(2)
        rate = products.add("minus_y_rate", "Interval 4: rate about x", flight_gap.minus_y_rate_test(scenario))
        advance(1)
        yaw = products.add("yaw_directions", "Intervals 2 and 6: direction of the yaw", flight_gap.yaw_direction_test(scenario))
        advance(1)
    noise = flight_gap.noise_from_steps()
    published = flight_gap.gap_rms(flight_gap.predict(scenario))
    gaps = gap_table(scenario, common, each)
    products.add("flight_gap_by_interval", "Gap by interval (deg RMS), without and with fitted timings", gaps)
    products.add("fitted_timings", "Fitted timings", fitted_table(common, each))
    best = rate.sort_values("gap_rms_deg").iloc[0]
    products.summary |= {
        "flight_gap_rms_deg": {
            "published": published,
            "fitted": common.gap_rms_deg,
            "fitted_values": common.count,
            "fitted_each_maneuver": each.gap_rms_deg,
            "fitted_each_maneuver_values": each.count,
            "scan_min": float(scan["gap_rms_deg"].min()),
            "scan_max": float(scan["gap_rms_deg"].max()),
            "floor": flight_gap.floor_rms(),
            "flight_rms": float(flight.rms(flight.residuals("prelaunch").ravel())),
        },
        "flight_noise": noise,
        "minus_y_rate_rpo": {
            "favoured": int(best["rate_rpo"]),
            "gap_rms_deg": {str(int(r["rate_rpo"])): float(r["gap_rms_deg"]) for _, r in rate.iterrows()},
            "fitted_gap_rms_deg": {str(int(r["rate_rpo"])): float(r["fitted_gap_rms_deg"]) for _, r in rate.iterrows()},
        },
        "yaw_direction_deg": {
            str(k): int(rows.sort_values("gap_rms_deg").iloc[0]["yaw_deg"]) for k, rows in yaw.groupby("interval")
        },
        "residual_sign_gap_rms_deg": {
            "N (16)": float(sign["gap_rms_deg"][0]),
            "N (29) as printed": float(sign["gap_rms_deg"][1]),
        },
    }
    render.terminal(out, products.titles["flight_gap"], comparison)
    render.terminal(out, products.titles["flight_gap_by_interval"], gaps, gap_note(products.summary))
    render.terminal(out, products.titles["minus_y_rate"], rate)
    render.terminal(out, products.titles["yaw_directions"], yaw)


def gap_note(summary: dict[str, Any]) -> str:
    """What the gap means, in words."""
    gap, noise = summary["flight_gap_rms_deg"], summary["flight_noise"]
    return (
        f"Floor: with the true timings the gap would be the flight's residual after calibration. Guesses of the common timings "
        f"give {gap['scan_min']:.4f} to {gap['scan_max']:.4f} deg. The spread between the flight's step sizes says "
        f"gyro noise is {noise['residual_rms_deg']:.4f} deg RMS in a residual (ARW {noise['arw_deg_per_sqrt_s']:.2e} deg/√s), "
        f"of which a calibration of 12 parameters to 18 numbers leaves {noise['residual_rms_deg'] * np.sqrt(6 / 18):.4f} deg."
    )


def gap_table(scenario: Scenario, common: flight_gap.TimingFit, each: flight_gap.TimingFit) -> pd.DataFrame:
    """Gap RMS of each interval and of all, for the scenario's timings and both fits, and the floor."""
    columns = {
        "timings assumed": flight_gap.predict(scenario),
        f"{common.count} common timings fitted": flight_gap.predict(common.scenario),
        f"{each.count} timings fitted": flight_gap.predict(each.scenario),
    }
    flown = flight.residuals("prelaunch")
    differences = {name: flown - predicted for name, predicted in columns.items()}
    differences["floor"] = flight.residuals("calibrated")
    table = pd.DataFrame({"interval": [*(str(k + 1) for k in range(len(flown))), "all"]})
    table["flight"] = [*flight.rms(flown.T), float(flight.rms(flown.ravel()))]
    for name, difference in differences.items():
        table[name] = [*flight.rms(difference.T), float(flight.rms(difference.ravel()))]
    return table


def fitted_table(common: flight_gap.TimingFit, each: flight_gap.TimingFit) -> pd.DataFrame:
    """Fitted timings, and whether they stopped at the bound of what can be flown."""
    return pd.DataFrame(
        [
            {"fit": name, "timing": timing, "fitted": value, "at_bound": timing in fit.at_bound, "degrees_of_freedom": fit.dof}
            for name, fit in (("common", common), ("each maneuver", each))
            for timing, value in fit.timings.items()
        ]
    )


def summary_table(summary: dict[str, Any]) -> pd.DataFrame:
    """The questions a reader comes with, and the answers of this run."""
    gap, nees, rate = summary["flight_gap_rms_deg"], summary["nees"], summary["minus_y_rate_rpo"]
    paper, shares = summary["nees_references_only"], summary["coverage"]
    inside = f"NEES {nees['value']:.1f} in [{nees['bounds'][0]:.1f}, {nees['bounds'][1]:.1f}]"
    rows = {
        "Is the flight predicted, timings assumed?": f"gap {gap['published']:.4f} deg RMS of {gap['flight_rms']:.3f}; "
        f"{gap['scan_min']:.4f} to {gap['scan_max']:.4f} over other assumptions; floor {gap['floor']:.4f}",
        "And with four common timings fitted?": f"gap {gap['fitted']:.4f} deg RMS",
        "Rate about x in -y forward?": f"{rate['favoured']:+d} RPO: gap {rate['gap_rms_deg']['-1']:.3f} deg against "
        f"{rate['gap_rms_deg']['1']:.3f} ({rate['fitted_gap_rms_deg']['1']:.3f} with any timing that can be flown)",
        "Are the estimates unbiased?": f"largest of 12 means {summary['bias_in_standard_errors_max']:.1f} standard errors "
        f"({'yes' if summary['bias_in_standard_errors_max'] < 4 else 'NO'}: below 4)",
        "Are the claimed sigmas honest?": f"{'yes' if nees['inside'] else 'NO'}: {inside}; "
        f"{100 * shares['68']:.1f} / {100 * shares['95']:.1f} / {100 * shares['99.7']:.2f} % within 1 / 2 / 3 sigma",
        "And the paper's, without gyro noise?": f"{'yes' if paper['inside'] else 'no'}: NEES {paper['value']:.1f}",
        "Does one iteration do?": f"the second changes G by {summary['second_iteration_median']['G']:.1e} (median)",
        "Does linear ψ do?": f"at TRMM's rates it differs by {summary['psi_difference_max']['G']:.1e} in G",
    }
    return pd.DataFrame({"question": rows.keys(), "answer": rows.values()})


def monte_carlo_part(
    config: paper_tables.PaperTablesConfig, scenario: Scenario, products: Products, jobs: int, out: Console
) -> pd.DataFrame:
    """The paper's tables, and how right and how honest the estimates are."""
    with tempfile.TemporaryDirectory() as folder:
        display = partial(progress, quiet=out.quiet)
        backend: Name = "loky" if jobs > 1 else "serial"
        outcome = engine.run(paper_tables.STUDY, config, Path(folder), backend=backend, jobs=jobs, progress=display)
        rows = outcome.load()
    if outcome.failures:
        number, error = next(iter(outcome.failures.items()))
        raise GyrocalError(f"{len(outcome.failures)} of {config.cases} cases failed, the first one case {number}: {error}")
    truth = true_parameters(scenario)
    for name, title in TITLES.items():
        table = products.add(name, title, getattr(paper_tables, name)(rows))
        render.terminal(out, title, paper_layout(table, name), CELL_NOTE)
    accuracy = products.add("accuracy", "Recovered minus injected", paper_tables.accuracy(rows, truth))
    consistency = products.add("consistency", "Consistency of the claimed covariance", paper_tables.consistency(rows, truth))
    between = products.add("psi_difference", "Largest difference between full and linear ψ", paper_tables.psi_difference(rows))
    second = products.add("second_iteration", "Size of the second iteration's corrections", paper_tables.second_iteration(rows))
    finest = scenario.gyro.sample_s
    headline = accuracy.query("psi == 'full' and step_s == @finest").drop(columns=["psi", "resampling", "step_s"])
    short = headline[[c for c in headline.columns if not c.endswith(("_low", "_high"))]]
    render.terminal(out, f"{products.titles['accuracy']}, ψ full, Δt = {finest:g} s", short)
    render.terminal(out, products.titles["consistency"], consistency)
    render.terminal(out, products.titles["second_iteration"], second)
    render.terminal(out, products.titles["psi_difference"], between)
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
        "cases": config.cases,
        "entropy": config.entropy,
        "second_iteration_max": {"G": float(at_finest["G_max"]), "bias_deg_s": float(at_finest["bias_deg_s_max"])},
        "second_iteration_median": {"G": float(at_finest["G_median"]), "bias_deg_s": float(at_finest["bias_deg_s_median"])},
        "psi_difference_max": {name: float(psi_finest[name].max()) for name in ("G", "bias_deg_s")},
        "coverage": {level: inside / total for level, (inside, total) in counts.items()},
        "nees": {"value": check.value, "bounds": [check.lower, check.upper], "dof": check.dof, "inside": check.inside},
        "nees_references_only": {"value": paper.value, "bounds": [paper.lower, paper.upper], "inside": paper.inside},
        "bias_in_standard_errors_max": float(np.abs(headline["bias_in_standard_errors"]).max()),
    }
    return rows


def psi_part(scenario: Scenario, products: Products, out: Console) -> None:
    """Where linear ψ stops being good enough."""
    with progress("psi sweep", 1, out.quiet) as advance:
        products.add("psi_sweep", "Linear against full ψ over slew rate and step, noise-free", psi.run(scenario))
        advance(1)


def true_parameters(scenario: Scenario) -> GyroParameters:
    """G and b a scenario injects."""
    return GyroParameters(np.array(scenario.gyro.true_G), np.deg2rad(scenario.gyro.true_bias_deg_s))


def write(
    folder: Path, config: paper_tables.PaperTablesConfig, scenario: Scenario, products: Products, rows: pd.DataFrame
) -> None:
    """Tables as CSV, one Markdown page, the rows as Parquet, the figures."""
    rows.to_parquet(folder / "cases.parquet", index=False)
    sections = [
        "# Reproduction of the TRMM gyro calibration",
        "",
        f"{config.cases} seeds, entropy {config.entropy}; `gyrocal reproduce` makes this page.",
        "",
        render.markdown("Summary", summary_table(products.summary), WORDS.strip()),
        gap_note(products.summary),
        "",
    ]
    for name, table in products.tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, float_format="%.9g")
        paper = name in LAYOUTS
        shown = paper_layout(table, name) if paper else table
        text = render.markdown(products.titles[name], shown, CELL_NOTE if paper else "")
        (folder / f"{name}.md").write_text(text, encoding="utf-8")
        sections.append(text)
    (folder / "tables.md").write_text("\n".join(sections), encoding="utf-8")
    figures.natanson_figures(scenario, folder)
    table2 = products.tables["table2"].query(
        "psi == 'full' and resampling == 'skip' and step_s == 0.5 and phase == 'prelaunch'"
    )
    figures.flight_gap_figure(products.tables["flight_gap"], table2.reset_index(drop=True), folder / "flight_gap.svg")
    chosen = paper_tables.choose(rows, scenario.gyro.sample_s)
    errors, sigmas = paper_tables.errors_and_sigmas(chosen, true_parameters(scenario))
    figures.error_figure(errors, sigmas, list(NAMES), folder / "errors.svg")
    panels.sheet(psi.map_of(products.tables["psi_sweep"]), size=(6.0, 3.6))(folder / "psi_sweep.svg")
