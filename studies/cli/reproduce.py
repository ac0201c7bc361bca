"""The command ``gyrocal reproduce``: both papers' numbers and figures beside the flight's."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

import click

from gyrocal.errors import InputError
from studies.cli.options import PATH, add_count_option, add_jobs_option, add_output_option, parse_assignment
from studies.montecarlo.files import write_json, write_text
from studies.report.console import make_console

LONGEST_REPRODUCED_DAYS = 200.0
DAYS = 154.2  # as of studies.robertson.runs
PAPER_FOLDERS = {"natanson": Path("build") / "reproduction", "robertson": Path("build") / "mission"}
COMMITTED = Path("results")
MOST_MOVED = 20  # numbers shown of those that moved


@click.command("reproduce")
@click.option("--paper", type=click.Choice(list(PAPER_FOLDERS)), help="One paper only; both by default.")
@click.option(
    "--out",
    type=PATH,
    help="Folder to write to; with both papers, the one that holds 'reproduction', 'mission' and the page; 'build' by default.",
)
@add_count_option("--cases", 200, "natanson: seeds of the Monte Carlo.", least=2)
@click.option("--scenario", default="trmm", show_default=True, help="natanson: built-in name or TOML file to calibrate on.")
@click.option(
    "--set", "changes", multiple=True, metavar="PATH=VALUE", help="natanson: a value of the scenario by its path; repeatable."
)
@add_count_option("--entropy", 1998, "Seed of all random streams.")
@add_count_option("--seeds", 1, "robertson: seeds of the months.", least=1)
@add_count_option("--slews", 20, "robertson: seeds of the yaw maneuver.", least=2)
@click.option(
    "--days",
    type=float,
    default=DAYS,
    show_default=True,
    help="robertson: simulated days from launch; with fewer, R's later periods are empty and there is no ladder of effects.",
)
@add_jobs_option("Processes or threads; the CPU count by default.")
@add_output_option("--json", "as_json", help="Also write the summary as JSON to this file, a key per paper.")
def command(
    paper: str | None,
    out: Path | None,
    cases: int,
    scenario: str,
    changes: tuple[str, ...],
    entropy: int,
    seeds: int,
    slews: int,
    days: float,
    jobs: int | None,
    as_json: Path | None,
) -> None:
    """Reproduce the two papers beside the flight's values.

    natanson: the gyro calibration, N Tables 2-5 and Figures 1-3. robertson: the Mission Mode, R Tables 1-3 and Figures 6-13.
    The output is compared with the committed results; 'make results' (--out results) replaces these. With both papers, a page
    (index.html) shows each claim of the papers beside its reproduction; the last line of the output is its path.

    \b
    Examples:
      gyrocal reproduce
      gyrocal reproduce --paper natanson --cases 50 --out /tmp/trmm
      gyrocal reproduce --paper natanson --set gyro.arw_deg_per_sqrt_s=1e-4 --out /tmp/quiet
      gyrocal reproduce --paper natanson --scenario mine.toml --out /tmp/mine
      gyrocal reproduce --paper robertson --seeds 1 --out /tmp/mission
    """
    if not 1.0 <= days <= LONGEST_REPRODUCED_DAYS:
        raise InputError(f"--days {days:g}: must be between 1 and {LONGEST_REPRODUCED_DAYS:g}")
    if paper != "natanson" and (scenario != "trmm" or changes):
        raise InputError("--scenario and --set are of one paper: give --paper natanson with them")
    if (scenario != "trmm" or changes) and out is None:
        raise InputError(f"{PAPER_FOLDERS['natanson']} holds the flight's own: give --out FOLDER with another scenario")

    from simulator.mission_mode.config import MissionConfig
    from simulator.mission_mode.flight import simulate_mission
    from studies import index_page
    from studies.natanson import paper_tables, reproduce
    from studies.natanson.paper_tables import PaperTablesConfig
    from studies.report import committed_results
    from studies.report import tables as render
    from studies.report.pages import build_provenance_footer
    from studies.reproduction import call_all
    from studies.robertson import reproduce as mission
    from studies.robertson.runs import MissionStudy

    workers, terminal = jobs or os.cpu_count() or 1, make_console()
    study = MissionStudy(days=days, seeds=seeds, slews=slews, entropy=entropy, windows=days >= DAYS)
    summaries: dict[str, dict[str, Any]] = {}
    folders = {name: folder for name, folder in PAPER_FOLDERS.items() if paper in (None, name)}
    if out is not None:
        folders = {name: out if paper else out / folder.name for name, folder in folders.items()}
    before = {name: committed_results.read(COMMITTED / PAPER_FOLDERS[name].name) for name in folders}
    if workers > 1 and not paper:
        # On a new checkout each paper's kernels are compiled by one worker, and not by every worker one after the other.
        warm_up: list[Any] = [partial(simulate_mission, MissionConfig(), seconds=60.0)]
        call_all([partial(paper_tables.tabulate_case, PaperTablesConfig(), 0), *warm_up], workers)
    for name, folder in folders.items():
        if name == "natanson":
            overrides = dict(parse_assignment(change) for change in changes)
            config = PaperTablesConfig(cases=cases, entropy=entropy, scenario=scenario, overrides=overrides)
            summaries[name] = reproduce.run(folder, config, workers, terminal)
        else:
            summaries[name] = mission.run(folder, study, workers, terminal)
    for name, folder in folders.items():
        if now := committed_results.read(folder):
            summary, moved = committed_results.compare_results(now, before[name])
            if len(moved):
                title = f"Moved against {COMMITTED / PAPER_FOLDERS[name].name}"
                render.print_table(terminal, title, moved.head(MOST_MOVED).astype(str))
            terminal.print(summary, highlight=False, markup=False)
    if as_json:
        write_json(as_json, summaries[paper] if paper else summaries)
    if not paper:
        page = (out or PAPER_FOLDERS["natanson"].parent) / "index.html"
        write_text(page, index_page.build_index_page(folders, COMMITTED / "studies", build_provenance_footer()))
        click.echo(page)
