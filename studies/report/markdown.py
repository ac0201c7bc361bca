"""The project's own Markdown as pieces of a page: headings, paragraphs, lists, tables, figures; no more is written here."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from html import escape

import pandas as pd

from studies.report.html import Html, folded, table_of

LONG = 40  # rows, from which on a table is folded

ImageOf = Callable[[str, str], str]

_IMAGE = re.compile(r"!\[([^\]]*)\]\(([^)]+)\)$")
_BAR = re.compile(r"(?<!\\)\|")
_NUMBER = re.compile(r"[-+−–]?\d[\d.,]*(e[-+]?\d+)?$|–$|$")


@dataclass(frozen=True)
class Section:
    """A section of a report.

    Attributes
    ----------
    title : its heading, "" of what comes before the first
    lines : of its text
    """

    title: str
    lines: tuple[str, ...]


def sections(text: str) -> list[Section]:
    """The sections of a report, without its title."""
    found: list[tuple[str, list[str]]] = [("", [])]
    for line in text.splitlines():
        if line.startswith("## "):
            found.append((line[3:].strip(), []))
        elif not line.startswith("# "):
            found[-1][1].append(line)
    return [Section(title, tuple(lines)) for title, lines in found if title or any(map(str.strip, lines))]


def rendered(section: Section, image: ImageOf) -> str:
    """The body of a section.

    Parameters
    ----------
    section : of a report
    image : (path, alternative text) to a figure as HTML
    """
    return "".join(_block(block, section.title, image) for block in _blocks(section.lines))


def _blocks(lines: Sequence[str]) -> Iterator[list[str]]:
    """Runs of lines that belong together: between empty lines, with a list or a table apart from the text before it."""
    block: list[str] = []
    for line in [*lines, ""]:
        kind = line[:1] if line[:1] in "|-" else ""
        if block and (not line.strip() or (kind == "|") != block[0].startswith("|")):
            yield block
            block = []
        if line.strip():
            block.append(line)


def _block(block: list[str], title: str, image: ImageOf) -> str:
    found = _IMAGE.match(block[0])
    if found:
        return image(found[2], found[1])
    if block[0].startswith("|"):
        return _table(block, title)
    if block[0].startswith("- "):
        text = "\n".join(block)
        items = [" ".join(part.split()) for part in re.split(r"^- ", text, flags=re.MULTILINE) if part.strip()]
        return "<ul>" + "".join(f"<li>{words(item)}</li>" for item in items) + "</ul>\n"
    return f"<p>{words(' '.join(block))}</p>\n"


def _table(lines: Sequence[str], title: str) -> str:
    rows = [[cell.strip().replace("\\|", "|") for cell in _BAR.split(line.strip())[1:-1]] for line in lines]
    head, body = rows[0], rows[2:]
    names = [name if name not in head[:k] else f"{name} " for k, name in enumerate(head)]
    numbers = [name for k, name in enumerate(names) if body and all(_NUMBER.match(row[k]) for row in body)]
    cells = [[Html(words(cell)) for cell in row] for row in body]
    html = table_of(pd.DataFrame(cells, columns=names, dtype=object), None, numbers, label=title)
    return folded(f"{title or 'Table'}: {len(body)} rows", html) if len(body) > LONG else html


def words(text: str) -> str:
    """Text with its emphasis, code and, where they lead within the page or out of the project's tree, links as text."""
    out = escape(text)
    out = re.sub(r"`([^`]+)`", r"<code>\1</code>", out)
    out = re.sub(r"(?<![\w*])\*([^*]+)\*(?![\w*])", r"<em>\1</em>", out)
    return re.sub(r"\[([^\]]+)\]\((#?)([^)]+)\)", lambda found: _link(found[1], found[2], found[3]), out)


def _link(text: str, inside: str, target: str) -> str:
    return f'<a href="#{target}">{text}</a>' if inside else text
