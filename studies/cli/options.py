"""Options, types and checks that several commands have in common.

This module and those of the commands import numba, scipy, pandas and matplotlib in the functions that need them: the help and a
refusal take a fraction of a second.
"""

from __future__ import annotations

import json
import math
import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from gyrocal.errors import InputError
from gyrocal.files import is_replaced
from studies.montecarlo.files import format_json, write_json, write_text
from studies.report.console import make_console
from studies.report.junit import Verdict, write_junit

if TYPE_CHECKING:
    from gyrocal.recording import Recording
    from studies.report.pages import Page, ProvenanceFooter

T = TypeVar("T")
PATH = click.Path(path_type=Path)
FOLDER_TYPE = click.Path(path_type=Path, file_okay=False)
STDOUT = Path("-")
MOST_BYTES = 100_000_000  # of a JSON file that is read
LONGEST_S = 1e7  # of a time limit
STATUS = 3  # of a command of which a --fail-on holds
CONDITION = re.compile(r"\s*(\w+)\s*([<>])\s*(\S+)\s*")

RATE = click.option("--rate", "rate_hz", type=float, help="Gyro samples a second; the time tags are put on an even time base.")
FORCE = click.option("--force", is_flag=True, help="Replace a recording that is in OUT already.")
GYRO_TABLE_OPTIONS = (
    click.option("--mapping", "file", type=PATH, help="Mapping as TOML: the options' words, and axes, G, mounting, bias, …."),
    click.option("--time", metavar="COLUMNS:UNIT", help="s, ms, us, ns, unix, iso, gps; e.g. t:ms or secs,nsecs:s+ns."),
    click.option("--gyro", metavar="COLUMNS:UNIT", help="rad/s, deg/s, deg/h, counts; deg, rad, arcsec of accumulated angle."),
    click.option("--lsb", metavar="'SIZE UNIT'", help="Of counts, e.g. '0.0175 deg/s', or '5e-9 rad' of accumulated angle."),
    click.option(
        "--wrap", type=float, help="Where an accumulated angle wraps, or the full range of rates that overflow; column's unit."
    ),
    click.option("--rows", metavar="COLUMN:VALUE", help="Rows of the gyro's table to read, where it holds several gyros."),
    click.option("--gyros", metavar="NAMES", help="Gyros to use, three or more, e.g. 1,2,4; all are joined by default."),
    RATE,
    click.option("--sample-number", metavar="COLUMN", help="Column of the gyro's table that counts the samples."),
)
JUNIT = "Write each --fail-on as a test to this file, JUnit's XML."
PAGE = "Write a page with the figures (HTML, needs no network) to this file."


def add_options(*options: Any) -> Any:
    """Return a decorator that gives a command several options, in this order."""

    def add(function: Any) -> Any:
        for option in reversed(options):
            function = option(function)
        return function

    return add


def add_count_option(name: str, default: int | None, help: str, least: int = 0) -> Any:
    """Return an option with a whole number, such as ``--seed`` or ``--jobs``."""
    return click.option(name, type=click.IntRange(least), default=default, show_default=default is not None, help=help)


def parse_spans(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> list[list[float]] | None:
    """Parse stretches of time such as "12.5:14", each as two numbers in s; None without any."""
    spans = []
    for text in texts:
        try:
            first, stop = (float(part) for part in text.split(":"))
        except ValueError:
            first = stop = math.nan
        if not -math.inf < first < stop < math.inf:
            raise InputError(f"{option.opts[0]} {text}: give FROM:TO in s since the first gyro sample, such as 12.5:14")
        spans.append([first, stop])
    return spans or None


EXCLUDE = click.option(
    "--exclude",
    multiple=True,
    metavar="FROM:TO",
    callback=parse_spans,
    help="Leave out this stretch, s since the first gyro sample; repeatable.",
)


def add_seed_option(help: str = "Seed of the random draws.") -> Any:
    """Return the option ``--seed``."""
    return add_count_option("--seed", 0, help)


def add_jobs_option(help: str = "Worker processes; the CPU count by default.", default: int | None = None) -> Any:
    """Return the option ``--jobs``."""
    return add_count_option("--jobs", default, help, least=1)


# ---- files ---------------------------------------------------------------------------------------------------------------


def add_output_option(*names: str, help: str, stdout: bool = False, endings: Sequence[str] = ()) -> Any:
    """Return an option of a file to write, refused beforehand if it is not writable or another option has it.

    With `stdout` the file - is standard output. Its name must have one of the endings, if there are any.
    """

    def check(context: click.Context, option: click.Parameter, path: Path | None) -> Path | None:
        name, outputs = option.opts[0], context.meta.setdefault("gyrocal.outputs", {})
        if path is None or (path == STDOUT and stdout):
            return path
        if path == STDOUT:
            raise InputError(f"{name} -: give the name of a file")
        if endings and path.suffix not in endings:
            raise InputError(f"{name} {path}: the name must end in {' or '.join(endings)}")
        check_writable(path)
        taken_by = outputs.setdefault(path.resolve(), name)
        if taken_by != name:
            raise InputError(f"{path}: {taken_by} and {name} need files of their own")
        return path

    return click.option(*names, type=PATH, callback=check, help=help)


def check_writable(path: Path) -> None:
    """Raise `InputError`, before the work, if a file is a folder, in no folder, or without permission."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise InputError(f"{path}: no folder {path.parent}")
    # A regular file is replaced, which its folder must allow; a device or a pipe is only written to.
    try:
        allowed = os.access(path.parent if is_replaced(path) else path, os.W_OK)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    if not allowed or (path.exists() and not os.access(path, os.W_OK)):
        raise InputError(f"{path}: cannot be written")


def add_json_option(content: str = "the result", stdout: str = "") -> Any:
    """Return the option ``--json FILE``; with `stdout`, - is standard output in place of the tables or the summary."""
    dash = f"; - for standard output in place of {stdout}" if stdout else ""
    return add_output_option("--json", "as_json", help=f"Write {content} as JSON to this file{dash}.", stdout=bool(stdout))


def write_result(
    document: Any,
    as_json: Path | None,
    build: Callable[[ProvenanceFooter | None], Page],
    report: Path | None = None,
    recording: Recording | None = None,
) -> None:
    """Print a result as a page, or as JSON in place of it, and write the requested files; build makes the page."""
    if as_json == STDOUT:
        click.echo(format_json(document))
    else:
        build(None).show(make_console())
        if as_json:
            write_json(as_json, document)
    if report:
        from studies.report.pages import build_provenance_footer

        write_text(report, build(build_provenance_footer(recording)).render_html())


def read_json(path: Path, description: str, convert: Callable[[Any], T]) -> T:
    """Read a JSON file and convert its document; an `InputError` if it is no JSON, or cannot be converted."""
    try:
        with path.open("rb") as file:
            text = file.read(MOST_BYTES + 1)
        if len(text) > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES} bytes")
        return convert(json.loads(text))
    except (KeyError, TypeError, ValueError, RecursionError) as fault:
        raise InputError(f"{path}: not {description}: {fault}") from None


def refuse_existing(out: Path, force: bool) -> None:
    """Refuse to write where a recording is."""
    if (out / "recording.toml").exists() and not force:
        raise InputError(f"{out}: a recording is there already; choose another folder, or replace it with --force")


# ---- settings and effects ------------------------------------------------------------------------------------------------


def parse_assignment(text: str) -> tuple[str, Any]:
    """Parse path and value of a setting; a value that is not TOML is text.

    Raises `InputError` if there is no = in it, or nothing before it.
    """
    path, separator, value = text.partition("=")
    if not separator or not path:
        raise InputError(f"--set {text}: give it as PATH=VALUE, e.g. gyro.arw_deg_per_sqrt_s=1e-4")
    from gyrocal.recording import format_toml

    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return path, tomllib.loads(f"value = {format_toml(value)}")["value"]


def parse_duration(text: str) -> float:
    """Parse a time such as 30s, 10min or 2h, in s; an `InputError` if it is none."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*(s|min|h)\s*", text)
    seconds = float(match[1]) * {"s": 1.0, "min": 60.0, "h": 3600.0}[match[2]] if match else 0.0
    if not 0 < seconds < LONGEST_S:
        raise InputError(f"--limit {text}: give a time such as 30s, 10min or 2h")
    return seconds


def _register(context: click.Context, _: click.Parameter, files: tuple[Path, ...]) -> None:
    """Register the effects of the user's files until the command ends."""
    if not files:
        return
    from simulator.effects import REGISTRY

    for path in files:
        for effect in REGISTRY.load_file(path):
            context.call_on_close(lambda name=effect.name: REGISTRY.remove(name))


# The user's own effects beside the built-in ones: registered before the command runs, and removed after it.
effects_option = click.option(
    "--effects",
    "effect_files",
    multiple=True,
    type=PATH,
    metavar="FILE.py",
    expose_value=False,
    is_eager=True,  # before options that name one of these effects
    callback=_register,
    help="Python file with effects of your own, see docs/extending.md; repeatable.",
)


# ---- conditions on which a command fails ---------------------------------------------------------------------------------


def compare_conditions(texts: Sequence[str], numbers: Mapping[str, float]) -> list[Verdict]:
    """Compare conditions such as "p<0.001" with numbers by name; a condition on an unknown number holds.

    Raises `InputError` if a text is no condition on one of the numbers.
    """
    verdicts = []
    for text in texts:
        name, sign, limit = parse_condition(text, numbers)
        value = numbers[name]
        holds = not (value >= limit if sign == "<" else value <= limit)
        value_text = "is not known" if math.isnan(value) else f"is {value:.4g}"
        verdicts.append(Verdict(text.strip(), f"{name} {value_text}" if holds else ""))
    return verdicts


def parse_condition(text: str, names: Sequence[str] | Mapping[str, float]) -> tuple[str, str, float]:
    """Parse name, sign and limit of a condition; an `InputError` if it is none, or on an unknown name."""
    match = CONDITION.fullmatch(text)
    try:
        if match is None or match[1] not in names:
            raise ValueError
        limit = float(match[3])
        if math.isnan(limit):
            raise ValueError
    except ValueError:
        raise InputError(f"--fail-on {text}: give NAME<LIMIT or NAME>LIMIT, where NAME is {' or '.join(names)}") from None
    return match[1], match[2], limit


def end(command: str, subject: str, verdicts: Sequence[Verdict], junit: Path | None, limits: Sequence[Verdict] = ()) -> None:
    """Write the verdicts as JUnit, and leave with status 3 if one of them is a failure, or 1 if one of the limits is."""
    if junit:
        write_junit(junit, f"gyrocal {command}", subject, [*verdicts, *limits])
    if any(verdict.failure for verdict in [*verdicts, *limits]):
        raise SystemExit(STATUS if any(verdict.failure for verdict in verdicts) else 1)
