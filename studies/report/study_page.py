"""A study as one page: how many of its checks pass, then its report with its figures."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from studies.report.pages import Page, ProvenanceFooter, Section, make_slug
from studies.report.source import Source


def build_study_page(folder: Path, made: ProvenanceFooter | None = None) -> str:
    """The whole page, made of the content of the folder."""
    source = Source.load(folder)
    sections = [Section("", [summarise_checks(folder)]), *source.sections("report.md", 2, make_slug)]
    return Page(
        source.title("report.md"), [*sections, Section("", [source.describe_origin("report.md")])], None, made
    ).render_html()


def summarise_checks(folder: Path) -> str:
    """Count the checks of a study that pass, and name the others."""
    path = folder / "checks.csv"
    if not path.is_file():
        return "This study has no checks."
    checks = pd.read_csv(path)
    judged = checks[checks["verdict"] != "note"]
    failed = judged.loc[judged["verdict"] == "fail", "check"]
    text = f"{len(judged) - len(failed)} of {len(judged)} checks pass."
    return f"{text} Not: {'; '.join(failed)}." if len(failed) else text
