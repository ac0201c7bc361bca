"""The command ``gyrocal plan``: the visible sizes of effects in a motion, before it is made."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gyrocal.errors import InputError, suggest_names
from gyrocal.recording import read_toml
from studies.cli.options import (
    PATH,
    add_json_option,
    add_options,
    add_output_option,
    add_seed_option,
    effects_option,
    write_result,
)
from studies.montecarlo.files import write_text
from studies.report.console import make_console, show_stages

if TYPE_CHECKING:
    from diagnosis.plan.slew_design import SlewLimits
    from simulator.scenario import Scenario

OPTIMISE_OPTIONS = (
    add_output_option(
        "--optimise", help="Find slews with smaller sigmas of G and b, and write the scenario (TOML) to this file."
    ),
    click.option(
        "--slew-time", type=click.FloatRange(0), metavar="S", help="Time of all slews; the scenario's own by default."
    ),
    click.option("--max-rate", type=float, metavar="DEG/S", help="Largest rate of a slew; the scenario's own by default."),
    click.option(
        "--max-acceleration", type=float, metavar="DEG/S2", help="Largest acceleration; the scenario's own by default."
    ),
    click.option(
        "--keep-out", metavar="AXIS,DEG", help="Smallest angle of a body axis to the Sun, as in z,45 or -z,45, during slews."
    ),
    click.option(
        "--dither",
        type=click.FloatRange(0, 30, min_open=True),
        metavar="DEG",
        help="Leave the slews as they are, and add sinusoids of at most DEG in all to each interval that has none.",
    ),
)


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
@click.option(
    "--named",
    is_flag=True,
    help="Also find the smallest size at which an effect is identified alone; slow, so best with --effect.",
)
@click.option(
    "--separate",
    metavar="A,B",
    help="List the extra maneuvers by how well they separate effect A from effect B; with --optimise, search slews for it.",
)
@add_json_option(stdout="the tables")
@add_output_option("--report", help="Write a page with all tables (HTML, needs no network) to this file.")
@add_options(*OPTIMISE_OPTIONS)
@add_seed_option()
def command(
    scenario: str,
    effects: tuple[str, ...],
    files: tuple[Path, ...],
    no_extras: bool,
    named: bool,
    separate: str | None,
    as_json: Path | None,
    report: Path | None,
    optimise: Path | None,
    slew_time: float | None,
    max_rate: float | None,
    max_acceleration: float | None,
    keep_out: str | None,
    dither: float | None,
    seed: int,
) -> None:
    """Compute the smallest visible size of each effect in SCENARIO (a built-in name or a TOML file), the pairs that cannot be
    told apart, and the extra maneuver that helps most.

    The linear model of the diagnosis predicts this without a recording. It takes about a minute. With --optimise, search slews
    with the smallest worst sigma of G and b instead; this takes up to some minutes. See docs/plan.md.

    \b
    Examples:
      gyrocal plan trmm_series
      gyrocal plan trmm --json /tmp/plan.json --report /tmp/plan.html
      gyrocal plan mine.toml --effect bias_orbital --effect time_offset --extra roll.toml --named
      gyrocal plan trmm_series --separate bias_drift,bias_orbital
      gyrocal plan trmm --optimise /tmp/better.toml --slew-time 1231 --max-rate 0.6 --max-acceleration 0.03
    """
    from simulator import scenario as scenarios
    from simulator.effects import ARRAY_EFFECTS, EFFECTS, TRACKER_EFFECTS

    for name in effects:
        if name not in {**EFFECTS, **TRACKER_EFFECTS, **ARRAY_EFFECTS}:
            raise InputError(f"--effect {name}: no such effect; {suggest_names(name, EFFECTS)}")
    of_search = {"--slew-time": slew_time, "--keep-out": keep_out}
    of_all = {"--max-rate": max_rate, "--max-acceleration": max_acceleration, "--dither": dither}
    given = [name for name, value in {**of_search, **of_all}.items() if value is not None]
    if given and not optimise:
        raise InputError(f"{given[0]} is an option of --optimise; give --optimise FILE, the scenario to write")
    if dither and (unused := [name for name in given if name in of_search]):
        raise InputError(f"{unused[0]} is for a search of slews, and --dither leaves them as they are; give one of the two")
    if separate and dither:
        raise InputError("--separate searches slews, and --dither leaves them as they are; give one of the two")
    pair = _parse_pair(separate) if separate else None
    chosen = scenarios.load(scenario)
    if optimise:
        slews = _read_limits(chosen, slew_time, max_rate, max_acceleration, keep_out, dither)
        return _optimise(chosen, slews, dither and radians(dither), pair, optimise, as_json)

    from diagnosis.plan import list_maneuvers, plan
    from studies.report import plan as plan_report
    from studies.report.pages import build_provenance_footer

    extras = {} if no_extras else dict(list_maneuvers(chosen))
    extras |= _read_extras(chosen, files)
    if pair:
        return _separate(chosen, pair, extras, as_json)
    with show_stages("plan") as tell:
        found = plan(chosen, effects=effects or None, extras=extras, named=named, progress=tell, seed=seed)
    if report:
        write_text(report, plan_report.build_plan_page(found, build_provenance_footer()))
    write_result(as_json, found.to_json(), lambda: plan_report.show(make_console(), found))


def _read_limits(
    chosen: Scenario,
    slew_time: float | None,
    max_rate: float | None,
    max_acceleration: float | None,
    keep_out: str | None,
    dither: float | None,
) -> SlewLimits:
    """The limits that are given, else the scenario's own."""
    from diagnosis.plan.slew_design import SlewLimits, compute_slew_time, read_limits

    rate, acceleration = read_limits(chosen)
    rate = rate if max_rate is None else radians(max_rate)
    acceleration = acceleration if max_acceleration is None else radians(max_acceleration)
    slew_s = compute_slew_time(chosen) if slew_time is None else slew_time
    for name, value in (("--max-rate", rate), ("--max-acceleration", acceleration), ("--slew-time", slew_s)):
        if not value > 0 and not (dither and name == "--slew-time"):
            raise InputError(f"{name}: must be above zero, and be given if the scenario has no slew to take it from")
    return SlewLimits(rate, acceleration, slew_s, keep_out=_parse_keep_out(keep_out))


def _parse_keep_out(text: str | None) -> tuple[tuple[float, float, float], float] | None:
    """The body axis and the angle, rad, of --keep-out."""
    if text is None:
        return None
    found = re.fullmatch(r"([+-]?)([xyz]),([0-9]+\.?[0-9]*)", text.strip())
    if found is None or not float(found[3]) < 180:
        raise InputError(f"--keep-out {text}: must be a body axis and an angle below 180 deg, as in z,45 or -z,45")
    sign = -1.0 if found[1] == "-" else 1.0
    x, y, z = (sign * (found[2] == name) for name in "xyz")
    return (x, y, z), radians(float(found[3]))


def _optimise(
    chosen: Scenario,
    limits: SlewLimits,
    dither: float | None,
    pair: tuple[str, str] | None,
    path: Path,
    as_json: Path | None,
) -> None:
    """Find better slews or add a dither, rad, write the scenario and show it."""
    from diagnosis.plan.dither import add_dither
    from diagnosis.plan.optimise import optimise_plan
    from simulator.scenario import format_scenario
    from studies.report import optimised_plan

    with show_stages("plan") as tell:
        found = add_dither(chosen, dither, limits) if dither else optimise_plan(chosen, limits, tell, pair)
    write_text(path, format_scenario(found.scenario))
    write_result(as_json, found.to_json(), lambda: optimised_plan.show(make_console(), found, path))


def _parse_pair(text: str) -> tuple[str, str]:
    """The two effects of --separate."""
    from simulator.effects import EFFECTS

    names = [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in EFFECTS]
    if unknown or len(names) != 2 or names[0] == names[1]:
        hint = f"; {suggest_names(unknown[0], EFFECTS)}" if unknown else ""
        raise InputError(f"--separate {text}: must be the names of two effects, as in bias_drift,bias_orbital{hint}")
    return names[0], names[1]


def _separate(chosen: Scenario, pair: tuple[str, str], extras: dict[str, list[dict[str, Any]]], as_json: Path | None) -> None:
    """List how the plan, and the plan with each extra maneuver, separates two effects."""
    from dataclasses import asdict

    from diagnosis.plan.separate import list_separations
    from studies.report import optimised_plan

    with show_stages("plan") as tell:
        found = list_separations(chosen, *pair, extras, progress=tell)
    document = {"format": 1, "scenario": chosen.title, "separations": [asdict(one) for one in found]}
    write_result(as_json, document, lambda: optimised_plan.show_separations(make_console(), found))


def _read_extras(chosen: Scenario, files: Sequence[Path]) -> dict[str, list[dict[str, Any]]]:
    """The extra maneuvers on file, each checked as a continuation of the scenario."""
    from diagnosis.plan import append_intervals

    out = {}
    for path in files:
        document = read_toml(path)
        sections = document.pop("interval", None)
        unknown = set(document) - {"title"}
        if unknown:
            raise InputError(f"{path}: {sorted(unknown)[0]} is not known; an extra maneuver has title and [[interval]]")
        if not isinstance(sections, list) or not sections or not all(isinstance(one, dict) for one in sections):
            raise InputError(f"{path}: no [[interval]] sections")
        try:
            append_intervals(chosen, sections)
        except InputError as error:
            raise InputError(f"{path}: {str(error).removeprefix('override: ')}") from None
        out[str(document.get("title", path.stem))] = sections
    return out
