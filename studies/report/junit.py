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
    """One thing that is asked."""

    name: str  # what is asked
    failure: str = ""  # why it is not as it should be; empty where it is
    skipped: str = ""  # why it has no answer; empty where it has one


def convert_checks(checks: Sequence[Check]) -> list[Verdict]:
    """Convert the checks of a study; a note, which has no bounds or too few rows for them, is skipped."""
    from studies.report.checks import format_checks

    out = []
    for check, row in zip(checks, format_checks(checks).to_dict("records"), strict=True):
        said = " ".join(f"{row['value']} {row['unit']}".split())
        failure = f"{said}, asked {row['asked']}" if check.verdict == "fail" else ""
        out.append(Verdict(check.name, failure, f"{said}: a note" if check.verdict == "note" else ""))
    return out


def write_junit(path: Path, suite: str, subject: str, verdicts: Sequence[Verdict]) -> None:
    """Write verdicts as a suite of one class, the subject."""
    counts = {"failures": sum(bool(one.failure) for one in verdicts), "skipped": sum(bool(one.skipped) for one in verdicts)}
    about = {"name": _replace_invalid_characters(suite), "tests": str(len(verdicts)), "errors": "0"} | {
        key: str(n) for key, n in counts.items()
    }
    root = ElementTree.Element("testsuites")
    element = ElementTree.SubElement(root, "testsuite", about)
    for one in verdicts:
        case = ElementTree.SubElement(
            element,
            "testcase",
            {"classname": _replace_invalid_characters(subject), "name": _replace_invalid_characters(one.name)},
        )
        for kind, message in (("failure", one.failure), ("skipped", one.skipped)):
            if message:
                ElementTree.SubElement(case, kind, {"message": _replace_invalid_characters(message)})
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")


def _replace_invalid_characters(text: str) -> str:
    """Text without the characters that XML cannot hold."""
    return NOT_IN_XML.sub("\N{REPLACEMENT CHARACTER}", text)
