"""Markers and tables in a text, and numbers that look like a result's."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

MARKER = re.compile(r"<!--=([\w.]+)-->")
BLOCK = re.compile(r"<!--begin ([\w.]+)-->\n(.*?)<!--end-->", re.DOTALL)
CODE = re.compile(r"```.*?```|`[^`\n]+`|\]\([^)]*\)|<!--.*?-->", re.DOTALL)
COUNTED = (
    r"(?:sealed |scored |simulated |held-out |further |drawn |unlisted |bad |listed |single |synthetic )*"
    r"(?:cases|recordings|seeds|statements|effects|inputs|missions|pairs|faults|trials|flights|draws)"
)
RESULT = re.compile(
    r"\d[\d,.]* of (?:the |all |its )?\d[\d,]*"  # 244 of 256
    r"|\d+(?:\.\d+)? ?%"  # 95.3 %
    r"|[×x]\d+(?:\.\d+)?"  # ×1.9
    r"|\d+(?:\.\d+)? times"  # 63 times
    rf"|\b\d[\d,]* {COUNTED}\b"  # 400 scored cases
)
LEVEL = re.compile(  # a level of confidence, which is no result
    r"(?:[^.|\n]{0,40}\b(?:binomial|conformal|bootstrap)\b[^.|]{0,10})?\s*"
    r"(?:intervals?|confidence|half-width|bounds?|ellipsoids?|bands?|coverage|set|one-sided|bootstrap|binomial|conformal)\b"
)
SEALED = re.compile(r"\bseal(?:s|ed|ing)?\b", re.IGNORECASE)
EXAM = re.compile(r"\bexams?\b", re.IGNORECASE)


@dataclass(frozen=True)
class Problem:
    """What a text claims wrongly, and where."""

    file: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def line_of(text: str, place: int) -> int:
    """Number the line of a place in a text, from 1."""
    return text.count("\n", 0, place) + 1


def written(text: str, values: Mapping[str, str]) -> str:
    """Write values before their markers and between those of their blocks; a number is what has no blank before it."""

    def block(found: re.Match[str]) -> str:
        return f"<!--begin {found[1]}-->\n{values[found[1]]}<!--end-->" if found[1] in values else found[0]

    text = BLOCK.sub(block, text)
    out, last = [], 0
    for found in MARKER.finditer(text):
        before = text[last : found.start()]
        if found[1] in values:
            words = values[found[1]].count(" ") + 1
            before = re.sub(rf"(?:[^\s|(]+ ){{{words - 1}}}[^\s|(]+$", lambda _, name=found[1]: values[name], before)
        out += [before, found[0]]
        last = found.end()
    return "".join([*out, text[last:]])


def marked_problems(file: str, text: str, values: Mapping[str, str]) -> Iterator[Problem]:
    """Find markers and blocks whose text is not the value of their claim."""
    for found in MARKER.finditer(text):
        name = found[1]
        if name not in values:
            yield Problem(file, line_of(text, found.start()), f"no claim is called {name}")
        elif not text[: found.start()].endswith(values[name]):
            yield Problem(file, line_of(text, found.start()), f"{name} is {values[name]!r} by the committed result")
    for found in BLOCK.finditer(text):
        if found[1] not in values:
            yield Problem(file, line_of(text, found.start()), f"no table is called {found[1]}")
        elif found[2] != values[found[1]]:
            yield Problem(file, line_of(text, found.start()), f"table {found[1]} is not what the committed result says")


def unmarked(text: str, values: Mapping[str, str]) -> Iterator[tuple[int, str]]:
    """Find numbers that look like a result's outside of code, links, tables of results and marked values, with their places."""
    bare = BLOCK.sub(lambda found: " " * len(found[0]), text)
    for found in reversed(list(MARKER.finditer(bare))):
        value = values.get(found[1], "")
        start = found.start() - len(value)
        bare = bare[:start] + " " * (found.end() - start) + bare[found.end() :]
    bare = CODE.sub(lambda found: "".join("\n" if one == "\n" else " " for one in found[0]), bare)
    for found in RESULT.finditer(bare):
        if not (found[0].endswith("%") and LEVEL.match(bare, found.end())):
            yield found.start(), found[0]


def stated_problems(file: str, text: str, values: Mapping[str, str], stated: Mapping[str, str]) -> Iterator[Problem]:
    """Find unmarked numbers that are not among those stated; a stated phrase covers the numbers inside it."""
    covered = [found.span() for phrase in stated for found in re.finditer(re.escape(phrase), text)]
    for place, number in unmarked(text, values):
        if not any(low <= place and place + len(number) <= high for low, high in covered):
            yield Problem(file, line_of(text, place), f"{number!r} is bound to no result, and is not in stated.toml")


def unused_phrases(file: str, text: str, stated: Mapping[str, str]) -> Iterator[Problem]:
    """Find stated phrases that the text has not got."""
    for phrase in stated:
        if phrase not in text:
            yield Problem(file, 0, f"stated.toml says whence {phrase!r} comes, which is not in the text")


def sealed_problems(file: str, text: str) -> Iterator[Problem]:
    """Find paragraphs and rows that speak of sealed answers and of no exam."""
    for start, paragraph in _paragraphs(text):
        for found in SEALED.finditer(CODE.sub(lambda one: " " * len(one[0]), paragraph)):
            if not EXAM.search(paragraph):
                yield Problem(file, line_of(text, start + found.start()), "only an exam has sealed answers")


def _paragraphs(text: str) -> Iterator[tuple[int, str]]:
    place = 0
    for part in re.split(r"(\n\s*\n|\n(?=[|\-*]))", text):
        yield place, part
        place += len(part)
