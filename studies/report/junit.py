"""Verdicts as JUnit's XML, which continuous integration shows as test results."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from studies.montecarlo.files import write_bytes

if TYPE_CHECKING:
    from studies.report.checks import Check

NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Verdict:
    """The outcome of one check, as a test case of JUnit."""

    name: str  # of the check
    failure: str = ""  # reason of a failure; empty if it passed
    skipped: str = ""  # reason of a missing answer; empty if there is one


def convert_checks(checks: Sequence[Check]) -> list[Verdict]:
    """Convert the checks of a study; a note, which has no bounds or too few rows for them, is skipped."""
    from studies.report.checks import format_checks

    verdicts = []
    for check, row in zip(checks, format_checks(checks).to_dict("records"), strict=True):
        value = " ".join(f"{row['value']} {row['unit']}".split())
        failure = f"{value}, asked {row['asked']}" if check.verdict == "fail" else ""
        verdicts.append(Verdict(check.name, failure, f"{value}: a note" if check.verdict == "note" else ""))
    return verdicts


def write_junit(path: Path, suite: str, subject: str, verdicts: Sequence[Verdict]) -> None:
    """Write verdicts as a suite of one class, the subject."""
    counts = {"tests": len(verdicts), "errors": 0}
    counts["failures"] = sum(bool(verdict.failure) for verdict in verdicts)
    counts["skipped"] = sum(bool(verdict.skipped) for verdict in verdicts)
    root = ElementTree.Element("testsuites")
    element = _add_element(root, "testsuite", name=suite, **{key: str(count) for key, count in counts.items()})
    for verdict in verdicts:
        case = _add_element(element, "testcase", classname=subject, name=verdict.name)
        for kind, message in (("failure", verdict.failure), ("skipped", verdict.skipped)):
            if message:
                _add_element(case, kind, message=message)
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _add_element(parent: ElementTree.Element, tag: str, **texts: str) -> ElementTree.Element:
    """Add an element whose attributes have no character that XML cannot hold."""
    clean = {name: NOT_IN_XML.sub("\N{REPLACEMENT CHARACTER}", text) for name, text in texts.items()}
    return ElementTree.SubElement(parent, tag, clean)
