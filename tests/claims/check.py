"""All claims of a checkout, checked and written."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.claims import text
from tests.claims.registry import CLAIMS
from tests.claims.text import Problem

STATED = Path("tests") / "claims" / "stated.toml"


def pages(root: Path) -> list[Path]:
    """List README, changelog and the pages of the documentation."""
    return [root / "README.md", root / "CHANGELOG.md", *sorted((root / "docs").rglob("*.md"))]


def values_of(root: Path) -> dict[str, str]:
    """Read what each claim is; one whose result is missing is left out."""
    values = {}
    for name, claim in CLAIMS.items():
        try:
            values[name] = claim(root)
        except (FileNotFoundError, IndexError, KeyError):
            continue
    return values


def problems(root: Path) -> list[Problem]:
    """Find everything that the pages of a checkout claim wrongly."""
    values, stated = values_of(root), tomllib.loads((root / STATED).read_text())
    return list(_text_problems(root, values, stated))


def _text_problems(root: Path, values: Mapping[str, str], stated: Mapping[str, Mapping[str, str]]) -> Iterator[Problem]:
    for path in pages(root):
        file, words = path.relative_to(root).as_posix(), path.read_text()
        phrases = stated.get("everywhere", {}) | stated.get(file, {})
        yield from text.marked_problems(file, words, values)
        yield from text.stated_problems(file, words, values, phrases)
        yield from text.unused_phrases(file, words, stated.get(file, {}))
        yield from text.sealed_problems(file, words)


def write(root: Path, values: Mapping[str, str]) -> None:
    """Write the values into all pages."""
    for path in pages(root):
        words = path.read_text()
        made = text.written(words, values)
        if made != words:
            path.write_text(made)


__all__ = ["pages", "problems", "values_of", "write"]
