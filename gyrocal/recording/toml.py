"""TOML files: read with every failure told in one line, and values written with all their digits."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from gyrocal.errors import InputError


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; every failure is an `InputError` that names the file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from None
    except (ValueError, RecursionError) as fault:  # TOML and UTF-8 errors are ValueErrors, as are endless integers
        raise InputError(f"{path}: not a TOML file: {fault}") from None


def format_toml(value: object) -> str:
    """One TOML value; floats with all their digits, so that what is read is what was written."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True).replace("\x7f", "\\u007f")  # a JSON string is a TOML basic string
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_format_key(str(key))} = {format_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, Iterable):
        return "[" + ", ".join(format_toml(item) for item in value) + "]"
    raise TypeError(f"no TOML form for {value!r}")


def _format_key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else format_toml(name)
