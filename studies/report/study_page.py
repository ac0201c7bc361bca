"""A study as one page: how many of its checks pass, then its report with its figures."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from studies.montecarlo.files import write_text
from studies.report import markdown
from studies.report.html import document, paragraph
from studies.report.made import Made
from studies.report.source import Source


def write(folder: Path, path: Path, made: Made | None = None) -> None:
    """Write the page of the study in a folder."""
    write_text(path, page(folder, made))


def page(folder: Path, made: Made | None = None) -> str:
    """The whole page, made of what the folder holds."""
    source, text = Source.of(folder), (folder / "report.md").read_text(encoding="utf-8")
    title = text.splitlines()[0].removeprefix("# ")
    parts = [paragraph(verdict(folder), "quiet"), source.sections(markdown.sections(text), 2), source.made("report.md")]
    return document(title, parts, made)


def verdict(folder: Path) -> str:
    """How many checks of a study pass, and which do not."""
    path = folder / "checks.csv"
    if not path.is_file():
        return "This study has no checks."
    checks = pd.read_csv(path)
    judged = checks[checks["verdict"] != "note"]
    failed = judged.loc[judged["verdict"] == "fail", "check"]
    text = f"{len(judged) - len(failed)} of {len(judged)} checks pass."
    return f"{text} Not: {'; '.join(failed)}." if len(failed) else text
