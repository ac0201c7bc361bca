"""Notes of an import in the folder of a recording: the mapping, the assumptions, and implausible values."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gyrocal.files import open_replacement
from gyrocal.recording.header import format_toml

NOTES_FILE = "import.toml"  # beside recording.toml; not needed to load a recording
NOISE_PHRASES = ("angle random walk", "sigma of the references", "1-sigma about")  # first words of a note on estimated noise


def write_import_notes(
    folder: str | os.PathLike[str], warnings: Sequence[str], assumed: Sequence[str], mapping: dict[str, Any]
) -> None:
    """Write the warnings, the assumptions and the entries of the mapping to `NOTES_FILE`."""
    lines = ["# How this recording was imported."]
    for name, texts in (("implausible", warnings), ("assumed", assumed)):
        lines += [f"{name} = [", *(f"    {format_toml(text)}," for text in texts), "]"] if texts else []
    lines += ["", "[mapping]"]
    lines += [f"{key} = {format_toml(value)}" for key, value in mapping.items()]
    with open_replacement(Path(folder) / NOTES_FILE) as file:
        file.write(("\n".join(lines) + "\n").encode())


def read_estimated_noise(folder: str | os.PathLike[str]) -> list[str]:
    """Read the notes on the noise that an import estimated, a sentence each; empty if none is recorded."""
    return [text for text in _read_notes(folder, "assumed") if text.startswith(NOISE_PHRASES)]


def read_import_warnings(folder: str | os.PathLike[str]) -> list[str]:
    """Read the warnings of an import, a sentence each; empty if none is recorded."""
    return _read_notes(folder, "implausible")


def _read_notes(folder: str | os.PathLike[str], name: str) -> list[str]:
    """Read a list of sentences of `NOTES_FILE`; empty if the file or the list is absent or damaged."""
    try:
        texts = tomllib.loads((Path(folder) / NOTES_FILE).read_text(encoding="utf-8"))[name]
        return [text for text in texts if isinstance(text, str)]
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError, TypeError):
        return []
