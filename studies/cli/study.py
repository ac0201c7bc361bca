"""The command ``gyrocal study``: run one of the studies, or one case of it again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gyrocal.errors import InputError
from studies import catalogue
from studies.cli.options import PATH, STATUS, add_jobs_option, add_output_option, parse_assignment, parse_duration
from studies.montecarlo.files import write_json
from studies.report.console import make_console

if TYPE_CHECKING:
    from studies.montecarlo import engine


@click.command("study")
@click.argument("name", required=False)
@click.option("--out", type=PATH, help="Folder to write; results/studies/NAME by default. An unfinished study resumes.")
@click.option("--config", type=PATH, help="Settings as TOML.")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="One setting by its dotted path; repeatable.")
@click.option(
    "--cases",
    type=click.IntRange(1),
    help="Number of cases; the study's own by default. Studies of a grid have one for each point of it.",
)
@click.option("--entropy", type=click.IntRange(0), help="Seed of all random streams.")
@click.option("--backend", type=click.Choice(["serial", "loky", "dask"]), default="loky", show_default=True)
@add_jobs_option("Workers; the CPU count by default.")
@click.option("--scheduler", help="Address of a dask scheduler, with --backend dask.")
@click.option(
    "--limit",
    "limit_s",
    metavar="TIME",
    callback=lambda context, option, text: parse_duration(text) if text else 0.0,
    help="End a case that takes longer, such as 30s, 10min or 2h, as a failed case; the others go on.",
)
@click.option(
    "--rerun", "again", type=click.IntRange(0), help="Repeat this one case of the study in the folder and keep its recording."
)
@click.option("--retry-failed", is_flag=True, help="Run failed cases of an earlier run again.")
@click.option(
    "--until",
    metavar="COLUMN<LIMIT",
    help="Stop when the half-width of the 95 % interval of a column's mean, or of p95(COLUMN), std(COLUMN) …, is below a "
    "limit, or after --cases cases. The column may be 'failed'.",
)
@click.option(
    "--require",
    "required",
    metavar="'pNN(COLUMN)<LIMIT @ NN%'",
    multiple=True,
    help="Answer whether a percentile of a column is below a limit (or above, with >) with this confidence, 90 % by default: "
    "met, not met, or how many further cases could show it met; repeatable.",
)
@click.option(
    "--fail-on",
    "fail_on",
    metavar="WORDS",
    default="",
    help="End with status 3 if one of these holds, comma separated: failed (a case failed), until (the criterion of --until is "
    "not met), require (a requirement is not met or undecided).",
)
@add_output_option(
    "--json",
    "as_json",
    help="Write the numbers of cases and the failures as JSON to this file; the findings are in the report.",
)
@add_output_option("--junit", help="Write the findings as tests to this file, JUnit's XML; a failed case is a failed test.")
def command(
    name: str | None,
    out: Path | None,
    config: Path | None,
    changes: tuple[str, ...],
    cases: int | None,
    entropy: int | None,
    again: int | None,
    as_json: Path | None,
    until: str | None,
    required: tuple[str, ...],
    fail_on: str,
    junit: Path | None,
    **options: Any,
) -> None:
    """Run the study NAME; without a name, list the studies.

    NAME may be a file with a STUDY of your own, such as ./mystudy.py.

    A study runs many cases, writes a row or more for each, and reports on them in OUT/report.md. The rows do not depend on
    --backend or --jobs. Ctrl-C stops cleanly, and the same command then continues where it stopped.

    \b
    Examples:
      gyrocal study
      gyrocal study psi --set 'steps_s=[0.5,2.0]' --out /tmp/psi
      gyrocal study paper --cases 20 --set overrides.gyro.arw_deg_per_sqrt_s=1e-4 --out /tmp/paper
      gyrocal study paper --out /tmp/paper --rerun 17
      gyrocal study ./mystudy.py --cases 1440 --require 'p99.73(largest_error_ppm)<40 @ 90%'
      gyrocal study ./mystudy.py --cases 500 --until 'p95(largest_error_ppm)<20' --limit 10min --fail-on failed
    """
    if name is None:
        _list_studies(as_json)
        return
    folder = out or Path("results") / "studies" / (Path(name).stem if catalogue.is_file(name) else name)
    settings = dict(parse_assignment(change) for change in changes)
    settings |= {key: value for key, value in (("cases", cases), ("entropy", entropy)) if value is not None}
    if again is not None:
        result = catalogue.rerun(name, folder, settings, again, config)
        _show_rerun(result, folder)
        if as_json:
            about = {"study": name, "case": again, "rows": result.rows.to_dict("records")}
            write_json(as_json, about | {"same": result.same, "traceback": result.traceback})
        return
    options |= _parse_criteria(until, required)
    words = _parse_fail_on(fail_on, {"failed": True, "until": bool(until), "require": bool(required)})
    terminal = make_console()
    outcome = catalogue.run(name, folder, settings, terminal, config, junit=junit, **options)
    terminal.print(outcome.summary(), highlight=False, markup=False)
    for message, count in outcome.warnings.items():
        click.echo(f"gyrocal: warning, {count} times: {message}", err=True)
    if as_json:
        failures = {str(case): error for case, error in outcome.failures.items()}
        about = {"study": name, "folder": str(folder), "cases": outcome.cases, "failures": failures}
        write_json(as_json, about | {name: outcome.manifest.get(name) for name in ("until", "requirements")})
    reasons = _describe_failures(outcome)
    if failed := [f"--fail-on {word}: {reasons[word]}" for word in words if reasons[word]]:
        click.echo(f"gyrocal: {', '.join(failed)}", err=True)
        raise SystemExit(STATUS)


def _list_studies(as_json: Path | None) -> None:
    """Print the list of studies, and write it as JSON to a file."""
    import pandas as pd

    from studies.report import tables as render

    studies = [{"study": key, "what": catalogue.describe_study(key)} for key in catalogue.STUDY_NAMES]
    render.print_table(make_console(), "Studies", pd.DataFrame(studies))
    if as_json:
        write_json(as_json, {"studies": studies})


def _describe_failures(outcome: engine.Outcome) -> dict[str, str]:
    """Return the reason why each word of --fail-on holds; empty for a word that does not hold."""
    stop, answers = outcome.manifest.get("until"), outcome.manifest.get("requirements", ())
    unmet = [f"{answer['requirement']} is {answer['outcome']}" for answer in answers if answer["outcome"] != "met"]
    return {
        "failed": f"{len(outcome.failures)} of {outcome.cases} cases failed" if outcome.failures else "",
        "until": f"{stop['asked']} is not met" if stop and not stop["met"] else "",
        "require": "; ".join(unmet),
    }


def _show_rerun(result: engine.Rerun, folder: Path) -> None:
    """Print the rows of a repeated case, its traceback, its recording's folder, and whether the rows are the same."""
    from studies.report import tables as render

    render.print_table(make_console(), "Rows of the case", result.rows.T.reset_index().astype(str))
    if result.traceback:
        click.echo(result.traceback, err=True)
    if result.recording:
        click.echo(f"Its recording is in {result.recording}")
    if result.same is not None:
        click.echo(f"The rows are {'those' if result.same else 'NOT those'} of the study in {folder}, bit for bit.")


def _parse_fail_on(text: str, known: dict[str, bool]) -> list[str]:
    """Parse the words of --fail-on; an `InputError` if one is unknown, or on a criterion that is not given."""
    words = [word.strip() for word in text.split(",") if word.strip()]
    for word in words:
        if word not in known:
            raise InputError(f"--fail-on {word}: give failed, until or require, comma separated")
        if not known[word]:
            raise InputError(f"--fail-on {word}: there is no --{word}; give one")
    return words


def _parse_criteria(until: str | None, required: tuple[str, ...]) -> dict[str, Any]:
    """Parse the criteria of --until and --require; the parsers are loaded only if they are given."""
    if not (until or required):
        return {"until": None, "requirements": []}
    from studies.montecarlo.criteria import Requirement, StoppingRule

    return {
        "until": StoppingRule.parse(until) if until else None,
        "requirements": [Requirement.parse(text) for text in required],
    }
