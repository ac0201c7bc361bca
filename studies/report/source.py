"""A folder of results as a page shows it: figures and reports, each with the command, commit and hash that make it again."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from studies.report import html, markdown


@dataclass(frozen=True)
class Source:
    """A folder of results and how it was made.

    Attributes
    ----------
    folder : with its ``manifest.json``
    manifest : what that says
    """

    folder: Path
    manifest: Mapping[str, Any]

    @classmethod
    def of(cls, folder: Path) -> Source:
        """The folder with its manifest."""
        path = folder / "manifest.json"
        return cls(folder, json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {})

    def made(self, file: str) -> str:
        """Command, commit and hash that make a file again, as HTML."""
        command = self.manifest.get("command") or f"gyrocal study {self.folder.name}"
        commit, sha256 = self.manifest.get("commit") or "unknown", self.manifest.get("files", {}).get(file, "unknown")
        later = self.manifest.get("reported", {}).get("commit", "")
        again = f", reported from its rows at <code>{escape(_short(later))}</code>" if later else ""
        return (
            f'<p class="made"><code>{escape(command)}</code> at commit <code>{escape(_short(commit))}</code>{again}; '
            f"<code>{escape(file)}</code>, SHA-256 <code>{escape(sha256[:16])}</code></p>\n"
        )

    def figure(self, file: str, alt: str) -> str:
        """A figure of the folder, with what makes it."""
        path = self.folder / file
        if not path.is_file():
            return ""
        name = f"{self.folder.name}-{path.stem}"
        return html.figure(name, path.read_bytes(), alt, alt) + self.made(file)

    def sections(self, some: Sequence[markdown.Section], level: int) -> str:
        """Sections of the folder's report, with headings of a level."""
        return "".join(
            (f"<h{level}>{escape(one.title)}</h{level}>\n" if one.title else "") + markdown.rendered(one, self.figure)
            for one in some
        )


def _short(commit: str) -> str:
    """A commit by twelve digits, and whether there were changes."""
    return commit[:12] + commit[40:]
