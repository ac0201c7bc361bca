"""The command ``gyrocal exam``: seal, take and verify a first-sight exam of the diagnosis."""

import os
from functools import partial
from pathlib import Path

import click

from gyrocal.errors import InputError
from studies import catalogue
from studies.cli.options import PATH, add_jobs_option
from studies.report.console import make_console, show_progress


@click.group("exam")
def command() -> None:
    """Seal, take and verify first-sight exams of the diagnosis.

    \b
    Examples:
      gyrocal exam verify
      gyrocal exam verify 001
    """


@command.command("seal")
@click.argument("name")
@click.option("--entropy", type=click.IntRange(0), required=True, help="Seed of all random streams.")
@click.option("--cases", type=click.IntRange(1), default=200, show_default=True, help="Number of recordings.")
@add_jobs_option()
def seal(name: str, entropy: int, cases: int, jobs: int | None) -> None:
    """Draw the cases of the exam NAME and write its seal, to be committed before the exam is taken.

    \b
    Example:
      gyrocal exam seal 002 --entropy 20270101
    """
    path = catalogue.load_module("exam").seal(name, entropy, cases, jobs or os.cpu_count() or 1)
    make_console().print(f"{path}: commit it, then 'gyrocal exam run {name}'", highlight=False, markup=False)


@command.command("run")
@click.argument("name")
@click.option("--work", type=PATH, default=None, help="Folder of the rows; build/exam/NAME by default.")
@add_jobs_option()
def run(name: str, work: Path | None, jobs: int | None) -> None:
    """Take the exam NAME: diagnose every recording once, and write keys, answers and score.

    \b
    Example:
      gyrocal exam run 002
    """
    from studies.report import tables as render

    exam, terminal = catalogue.load_module("exam"), make_console()
    place = work or Path("build") / "exam" / name
    path = exam.take(name, jobs or os.cpu_count() or 1, place, partial(show_progress, quiet=terminal.quiet))
    rows = exam.read_case_rows(path.parent)
    render.print_table(terminal, "Rates, with 95 % binomial intervals", exam.score.rates(rows))
    terminal.print(f"{path}: commit it with keys and answers, whatever it says", highlight=False, markup=False)


@command.command("verify")
@click.argument("names", nargs=-1)
def verify(names: tuple[str, ...]) -> None:
    """Check exams against the history of the repository; exit status 2 where one does not hold.

    \b
    Examples:
      gyrocal exam verify
      gyrocal exam verify 001
    """
    import pandas as pd

    from studies.report import tables as render

    exam = catalogue.load_module("exam")
    faults = {name: exam.verify(name) for name in names or exam.exams()}
    rows = [{"exam": name, "verdict": "; ".join(found) or "holds"} for name, found in faults.items()]
    render.print_table(make_console(), "Exams", pd.DataFrame(rows, columns=["exam", "verdict"]))
    failed = [name for name, found in faults.items() if found]
    if failed:
        raise InputError(f"exam {', '.join(failed)}: does not hold; the table says why")
