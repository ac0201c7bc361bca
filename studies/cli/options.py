"""What several commands have in common: types of options, and settings as PATH=VALUE."""

import tomllib
from pathlib import Path
from typing import Any

import click

from gyrocal import InputError
from gyrocal.recording import toml_value
from studies.montecarlo.files import check_writable

PATH = click.Path(path_type=Path)
STDOUT = Path("-")


def json_file(what: str) -> Any:
    """The option ``--json FILE``, refused before the work where it cannot be written."""

    def writable(_: click.Context, __: click.Parameter, value: Path | None) -> Path | None:
        check_writable(value)
        return value

    return click.option("--json", "as_json", type=PATH, callback=writable, help=f"Write {what} as JSON to this file.")


def assignment(text: str) -> tuple[str, Any]:
    """Path and value of a setting; a value that is no TOML is text.

    Raises
    ------
    InputError
        There is no = in it, or nothing before it.
    """
    path, separator, value = text.partition("=")
    if not separator or not path:
        raise InputError(f"--set {text}: give it as PATH=VALUE, e.g. gyro.arw_deg_per_sqrt_s=1e-4")
    try:
        return path, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return path, tomllib.loads(f"value = {toml_value(value)}")["value"]
