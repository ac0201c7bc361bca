"""The command ``gyrocal plan``: the visible sizes of effects in a motion, before it is made."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gyrocal.errors import InputError, suggest_names
from gyrocal.recording import read_toml
from studies.cli.options import (
    PATH,
    add_json_option,
    add_output_option,
    add_seed_option,
    effects_option,
    write_result,
)
from studies.report.console import show_stages

if TYPE_CHECKING:
    from simulator.scenario import Scenario


@click.command("plan")
@click.argument("scenario")
@effects_option
@click.option(
    "--effect", "effects", multiple=True, metavar="NAME", help="Look at this effect only, see 'gyrocal effects'; repeatable."
)
@click.option(
    "--extra",
    "files",
    multiple=True,
    type=PATH,
    metavar="FILE",
    help="An extra maneuver: TOML with further [[interval]] sections, times counted from the scenario's end; repeatable.",
)
@click.option("--no-extras", is_flag=True, help="Leave the built-in extra maneuvers out.")
@add_json_option(stdout="the tables")
@add_output_option("--report", help="Write a page with all tables (HTML, needs no network) to this file.")
@add_seed_option()
def command(
    scenario: str,
    effects: tuple[str, ...],
    files: tuple[Path, ...],
    no_extras: bool,
    as_json: Path | None,
    report: Path | None,
    seed: int,
) -> None:
    """Compute the smallest visible size of each effect in SCENARIO (a built-in name or a TOML file), the pairs that cannot be
    told apart, and the extra maneuver that helps most.

    The linear model of the diagnosis predicts this without a recording. It takes about a minute. See docs/plan.md.

    \b
    Examples:
      gyrocal plan trmm_series
      gyrocal plan trmm --json /tmp/plan.json --report /tmp/plan.html
      gyrocal plan mine.toml --effect bias_orbital --effect time_offset --extra roll.toml
    """
    from simulator import scenario as scenarios
    from simulator.effects import EFFECTS

    for name in effects:
        if name not in EFFECTS:
            raise InputError(f"--effect {name}: no such effect; {suggest_names(name, EFFECTS)}")
    chosen = scenarios.load(scenario)

    from diagnosis.plan.extras import list_maneuvers
    from diagnosis.plan.pipeline import plan
    from studies.report.plan import build_plan_page

    extras = {} if no_extras else dict(list_maneuvers(chosen))
    extras |= _read_extras(chosen, files)
    with show_stages("plan") as progress:
        result = plan(chosen, effects=effects or None, extras=extras, progress=progress, seed=seed)
    write_result(result.to_json(), as_json, partial(build_plan_page, result), report)


def _read_extras(chosen: Scenario, files: Sequence[Path]) -> dict[str, list[dict[str, Any]]]:
    """Read the extra maneuvers of files, each checked as a continuation of the scenario."""
    from diagnosis.plan.extras import append_intervals

    extras = {}
    for path in files:
        document = read_toml(path)
        sections = document.pop("interval", None)
        unknown = set(document) - {"title"}
        if unknown:
            raise InputError(f"{path}: {sorted(unknown)[0]} is not known; an extra maneuver has title and [[interval]]")
        if not isinstance(sections, list) or not sections or not all(isinstance(section, dict) for section in sections):
            raise InputError(f"{path}: no [[interval]] sections")
        try:
            append_intervals(chosen, sections)
        except InputError as error:
            raise InputError(f"{path}: {str(error).removeprefix('override: ')}") from None
        extras[str(document.get("title", path.stem))] = sections
    return extras
