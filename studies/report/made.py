"""How a page came about: by which version and command, on which day, of which input. Every page says so at its end."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from importlib import metadata

from gyrocal.recording import Recording
from simulator.adopted import digest


@dataclass(frozen=True)
class Made:
    """What a page's footer says.

    Attributes
    ----------
    version : of gyrocal
    day : as YYYY-MM-DD, UTC
    command : as typed
    sha256 : of the input, or "" if there is none
    what : that the hash is of
    """

    version: str
    day: str
    command: str
    sha256: str = ""
    what: str = "samples, references and stated noises"

    def line(self) -> str:
        """The footer as HTML."""
        hashed = f" SHA-256 of {escape(self.what)}: <code>{self.sha256}</code>." if self.sha256 else ""
        return f"<p>gyrocal {escape(self.version)}, {self.day}. Made by <code>{escape(self.command)}</code>.{hashed}</p>"


def made_of(recording: Recording | None = None) -> Made:
    """What is so of the command that is running, and of the recording it reads."""
    command = shlex.join(["gyrocal", *sys.argv[1:]])
    day = datetime.now(UTC).date().isoformat()
    return Made(metadata.version("gyrocal"), day, command, "" if recording is None else digest(recording))
