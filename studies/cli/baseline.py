"""The command ``gyrocal baseline``: what moved of the recovered parameters that are held."""

from pathlib import Path

import click

from gyrocal.errors import InputError
from studies.cli.options import PATH, add_json_option
from studies.montecarlo.files import write_json
from studies.report.console import make_console


@click.command("baseline")
@click.option("--write", "regenerate", is_flag=True, help="Replace the stored baseline.")
@click.option(
    "--file", "path", type=PATH, default=None, help="CSV file of the baseline; results/baseline/recovered.csv by default."
)
@add_json_option("what moved")
def command(regenerate: bool, path: Path | None, as_json: Path | None) -> None:
    """Recompute the baseline of recovered parameters and show what moved; exit status 1 if something did.

    The baseline holds the parameters that fixed simulated recordings are calibrated to, so that a change of the code that
    changes results is seen.

    \b
    Example:
      gyrocal baseline --write
    """
    from studies.report import tables as render
    from studies.validation import baseline

    path = path or baseline.BASELINE_PATH
    stored = baseline.read_baseline(path) if path.exists() else None
    if stored is None and not regenerate:
        raise InputError(f"{path}: no baseline there; run in the project's folder, or write one with --write")
    new = baseline.estimate_baseline_parameters()
    if stored is not None:
        table = baseline.find_changed_values(stored, new)
        if as_json:
            write_json(as_json, {"file": str(path), "moved": table.to_dict("records")})
        if table.empty:
            click.echo(f"{path}: nothing moved by more than {baseline.RTOL:g} of itself")
        else:
            render.print_table(
                make_console(), f"{len(table)} values moved by more than {baseline.RTOL:g} of themselves", table.head(40)
            )
    if regenerate:
        baseline.write_baseline(new, path)
        click.echo(f"{path}: written")
    elif not table.empty:
        raise SystemExit(1)
