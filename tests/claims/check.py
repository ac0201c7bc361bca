"""All claims of a checkout, checked and written."""

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.claims import text
from tests.claims.freshness import changed_sources
from tests.claims.registry import CLAIMS
from tests.claims.text import Problem

STATED = Path("tests") / "claims" / "stated.toml"
SHOWN = 3  # sources that a problem names


def pages(root: Path) -> list[Path]:
    """List README, changelog and the pages of the documentation."""
    return [root / "README.md", root / "CHANGELOG.md", *sorted((root / "docs").rglob("*.md"))]


def values_of(root: Path) -> dict[str, str]:
    """Read what each claim is; one whose result is missing is left out."""
    values = {}
    for name, claim in CLAIMS.items():
        try:
            values[name] = claim.text(root)
        except (FileNotFoundError, IndexError, KeyError):
            continue
    return values


def problems(root: Path, fresh: bool = True) -> list[Problem]:
    """Find everything that is claimed wrongly.

    Parameters
    ----------
    root : of the checkout
    fresh : whether to ask if results are of the present code, too
    """
    values, stated = values_of(root), tomllib.loads((root / STATED).read_text())
    return [*_text_problems(root, values, stated), *(_stale(root) if fresh else ())]


def _text_problems(root: Path, values: Mapping[str, str], stated: Mapping[str, Mapping[str, str]]) -> Iterator[Problem]:
    for path in pages(root):
        file, words = path.relative_to(root).as_posix(), path.read_text()
        phrases = stated.get("everywhere", {}) | stated.get(file, {})
        yield from text.marked_problems(file, words, values)
        yield from text.stated_problems(file, words, values, phrases)
        yield from text.unused_phrases(file, words, stated.get(file, {}))
        yield from text.sealed_problems(file, words)


def _stale(root: Path) -> Iterator[Problem]:
    """Find claims and committed results that were made by other code than the present one."""
    used = {
        found[1]
        for path in pages(root)
        for pattern in (text.MARKER, text.BLOCK)
        for found in pattern.finditer(path.read_text())
    }
    folders = {folder for name in used if name in CLAIMS for folder in CLAIMS[name].results}
    folders |= {path.parent.relative_to(root / "results").as_posix() for path in (root / "results").rglob("manifest.json")}
    for folder in sorted(folders):
        changed = changed_sources(root / "results" / folder)
        if changed:
            more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
            yield Problem(f"results/{folder}", 0, f"stale: {', '.join(changed[:SHOWN])}{more} changed since; make it again")


def write(root: Path, values: Mapping[str, str]) -> None:
    """Write the values into all pages."""
    for path in pages(root):
        words = path.read_text()
        made = text.written(words, values)
        if made != words:
            path.write_text(made)


__all__ = ["pages", "problems", "values_of", "write"]
