"""The command ``gyrocal compare``: a recording among the flights of scenarios, and the gap before and after."""

from functools import partial
from pathlib import Path

import click

from gyrocal import InputError, load
from simulator import adopted
from simulator.effects import REGISTRY
from simulator.effects.registry import FILE_MODULE
from studies.cli.effect_files import effects_option
from studies.cli.options import PATH, STDOUT
from studies.compare.compare import BASELINE, FEWEST_FLIGHTS, compare
from studies.montecarlo.files import check_writable, json_text, write_json
from studies.report import comparison as comparison_report
from studies.report.console import console, progress
from studies.report.made import made_of


@click.command("compare")
@click.argument("recording", type=PATH)
@click.argument("scenarios", metavar="SCENARIO...", nargs=-1)
@effects_option
@click.option(
    "--runs", type=click.IntRange(FEWEST_FLIGHTS), default=200, show_default=True, help="Flights of each scenario, and of M0."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Root of the random streams.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes; results do not depend on it.")
@click.option(
    "--json", "as_json", type=PATH, help="Write the result as JSON to this file; - for standard output in place of the tables."
)
@click.option("--report", type=PATH, help="Write a page with all statistics (HTML, needs no network) to this file.")
def command(
    recording: Path,
    scenarios: tuple[str, ...],
    runs: int,
    seed: int,
    jobs: int,
    as_json: Path | None,
    report: Path | None,
) -> None:
    """Fly each SCENARIO many times and show where RECORDING stands among the flights, and how far the gap shrinks.

    A scenario is a file of 'gyrocal diagnose --adopt', or any scenario of the recording's samples and references, with
    [[effect]] tables or without; none at all compares with M0 alone, which is always flown. See docs/compare.md.

    \b
    Examples:
      gyrocal simulate trmm_series /tmp/rec --effect bias_orbital:z=0.3
      gyrocal diagnose /tmp/rec --adopt /tmp/adopted.toml
      gyrocal compare /tmp/rec /tmp/adopted.toml --report /tmp/compare.html
    """
    if report == STDOUT:
        raise InputError("--report -: give the name of a file")
    files = [path for path in (as_json, report) if path is not None and path != STDOUT]
    for path in files:
        check_writable(path)
    if len({path.resolve() for path in files}) < len(files):
        raise InputError(f"{report}: --json and --report need files of their own")
    if len(set(scenarios)) < len(scenarios) or BASELINE in scenarios:
        raise InputError(f"give each scenario once; {BASELINE} is flown anyway")
    loaded = load(recording)
    chosen = [(name, adopted.load(name)) for name in scenarios]
    foreign = [one.effect for _, scenario in chosen for one in scenario.effects if _from_file(one.effect)]
    if foreign and jobs > 1:
        raise InputError(f"{foreign[0]}: an effect of a file is not known to other processes; leave --jobs out")
    terminal = console()
    found = compare(loaded, chosen, runs=runs, seed=seed, jobs=jobs, progress=partial(progress, quiet=terminal.quiet))
    if as_json == STDOUT:
        click.echo(json_text(found.to_json()))
    else:
        comparison_report.show(terminal, found)
    if as_json and as_json != STDOUT:
        write_json(as_json, found.to_json())
    if report:
        comparison_report.write(found, report, made_of(loaded))


def _from_file(effect: str) -> bool:
    """Whether an effect is one of --effects."""
    return type(REGISTRY[effect]).__module__.startswith(FILE_MODULE)
