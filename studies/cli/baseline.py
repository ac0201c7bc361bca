"""The command ``gyrocal baseline``: recordings and studies compared with their stored values."""

from pathlib import Path

import click

from studies.cli.options import PATH, add_json_option, add_output_option
from studies.montecarlo.files import write_json
from studies.report.console import make_console
from studies.report.junit import Verdict, write_junit

PROJECT_BASELINE = Path("results") / "baseline" / "baseline.toml"
SHOWN_LINES = 40  # of the values of one entry that moved


@click.command("baseline")
@click.argument("file", type=PATH, default=PROJECT_BASELINE)
@click.option("--write", is_flag=True, help="Replace the stored values.")
@add_json_option("what moved")
@add_output_option("--junit", help="Write each comparison as a test to this file, JUnit's XML.")
def command(file: Path, write: bool, as_json: Path | None, junit: Path | None) -> None:
    """Repeat the calibrations and studies listed in FILE and show the values that changed; exit status 1 if one did.

    FILE is a TOML with [recordings.NAME] and [studies.NAME], see docs/ci.md; by default the project's own,
    results/baseline/baseline.toml. The stored values are in the folder expected/ next to FILE.

    \b
    Example:
      gyrocal baseline baseline.toml --write --json /tmp/moved.json
      gyrocal baseline baseline.toml --junit /tmp/baseline.xml
    """
    from studies.baseline import compare_baseline
    from studies.report import tables as render

    results = compare_baseline(file, write)
    for entry in results:
        if entry.moved.empty:
            click.echo(f"{entry.name}: nothing moved")
        else:
            title = f"{entry.name}: {len(entry.moved)} values moved"
            render.print_table(make_console(), title, entry.moved.head(SHOWN_LINES))
    if as_json:
        moved = {entry.name: entry.moved.to_dict("records") for entry in results}
        write_json(as_json, {"file": str(file), "moved": moved})
    if junit:
        pairs = [(entry.name, verdict) for entry in results for verdict in entry.verdicts]
        verdicts = [Verdict(f"{name}: {verdict.name}", verdict.failure) for name, verdict in pairs]
        write_junit(junit, "gyrocal baseline", str(file), verdicts)
    if write:
        click.echo(f"{file.parent / 'expected'}: written")
    elif not all(entry.moved.empty for entry in results):
        raise SystemExit(1)
