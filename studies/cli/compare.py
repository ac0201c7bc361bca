"""The command ``gyrocal compare``: a recording among the simulations of scenarios, and the gap before and after."""

from functools import partial
from pathlib import Path

import click

from gyrocal.errors import InputError
from gyrocal.recording import load
from studies.cli.options import (
    PATH,
    add_jobs_option,
    add_json_option,
    add_output_option,
    add_seed_option,
    effects_option,
    write_result,
)
from studies.report.console import show_progress

BASELINE, FEWEST_FLIGHTS = "M0", 20  # as of studies.compare.compare


@click.command("compare")
@click.argument("recording", type=PATH)
@click.argument("scenarios", metavar="SCENARIO...", nargs=-1)
@effects_option
@click.option(
    "--runs",
    type=click.IntRange(FEWEST_FLIGHTS),
    default=200,
    show_default=True,
    help="Simulations of each scenario, and of M0.",
)
@add_seed_option("Root of the random streams.")
@add_jobs_option("Processes; results do not depend on it.", default=1)
@add_json_option(stdout="the tables")
@add_output_option("--report", help="Write a page with all statistics (HTML, needs no network) to this file.")
def command(
    recording: Path,
    scenarios: tuple[str, ...],
    runs: int,
    seed: int,
    jobs: int,
    as_json: Path | None,
    report: Path | None,
) -> None:
    """Simulate each SCENARIO repeatedly; report the percentile of RECORDING among the simulations, and how far the gap shrinks.

    The gap is the misfit between recording and simulation. A scenario is a file of 'gyrocal diagnose --adopt', or any scenario
    with the recording's samples and references, with or without [[effect]] tables. The baseline M0, which has no effect, is
    always simulated; without a SCENARIO it is the only one. See docs/compare.md.

    \b
    Examples:
      gyrocal simulate trmm_series /tmp/rec --effect bias_orbital:z=0.3
      gyrocal diagnose /tmp/rec --adopt /tmp/adopted.toml
      gyrocal compare /tmp/rec /tmp/adopted.toml --report /tmp/compare.html
    """
    if len(set(scenarios)) < len(scenarios) or BASELINE in scenarios:
        raise InputError(f"give each scenario once; {BASELINE} is simulated anyway")
    loaded = load(recording)

    from simulator import adopted_scenario
    from simulator.effects import REGISTRY
    from simulator.effects.registry import FILE_MODULE
    from studies.compare.compare import compare
    from studies.compare.page import build_comparison_page

    loaded_scenarios = [(name, adopted_scenario.load(name)) for name in scenarios]
    for effect in [setting.effect for _, scenario in loaded_scenarios for setting in scenario.effects] if jobs > 1 else ():
        if type(REGISTRY[effect]).__module__.startswith(FILE_MODULE):
            raise InputError(f"{effect}: an effect of a file is not known to other processes; leave --jobs out")
    comparison = compare(loaded, loaded_scenarios, runs=runs, seed=seed, jobs=jobs, progress=show_progress)
    write_result(comparison.to_json(), as_json, partial(build_comparison_page, comparison), report, loaded)
