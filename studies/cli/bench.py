"""The command ``gyrocal bench``: a fixed set of recordings, diagnosed by two versions of the code and compared."""

from pathlib import Path

import click

from studies import catalogue
from studies.cli.options import PATH, add_jobs_option
from studies.report.console import make_console


@click.group("bench")
def command() -> None:
    """Diagnose a fixed set of simulated recordings, and compare two runs of it.

    \b
    Examples:
      gyrocal bench run build/bench/before
      gyrocal bench compare build/bench/before build/bench/after
    """


@command.command("run")
@click.argument("out", type=PATH)
@add_jobs_option()
@click.option("--cases", type=click.IntRange(1), default=None, help="Diagnose only this number of recordings, the first ones.")
def run(out: Path, jobs: int | None, cases: int | None) -> None:
    """Diagnose the set with the code as it is, and write rows and report to the folder OUT.

    \b
    Example:
      gyrocal bench run build/bench/before
    """
    settings = {} if cases is None else {"cases": cases}
    terminal = make_console()
    outcome = catalogue.run("bench", out, settings, terminal, jobs=jobs)
    terminal.print(outcome.summary(), highlight=False, markup=False)


@command.command("compare")
@click.argument("before", type=PATH)
@click.argument("after", type=PATH)
@click.option("--out", type=PATH, default=None, help="Folder for the report; none by default.")
def compare(before: Path, after: Path, out: Path | None) -> None:
    """Compare two runs case by case: recordings gained and lost, McNemar's p, processor time and memory.

    \b
    Example:
      gyrocal bench compare build/bench/before build/bench/after
    """
    from studies.report import entry

    bench = catalogue.load_module("bench")
    made = bench.compare(bench.load_bench_run(before), bench.load_bench_run(after))
    entry.show(made, make_console())
    if out:
        entry.write(made, f"Bench: {before.name} and {after.name}", out)
