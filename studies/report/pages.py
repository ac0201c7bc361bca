"""Results as pages, on the terminal and in HTML: the answer first, then sections of paragraphs, lists, tables and figures.

Both show the same texts and tables; the terminal leaves out the figures. A page in HTML is one file that needs no network and
no script. Figures are SVG inside of it: the same lines drawn by Plotly weigh 4.8 MB, by Bokeh 1.3 MB, by Vega-Altair 1.0 MB, as
SVG 0.05 MB. Texts are escaped by the template; only `Markup` is HTML.
"""

from __future__ import annotations

import base64
import re
import shlex
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib import metadata, resources
from typing import TYPE_CHECKING

import pandas as pd
from markupsafe import Markup
from rich.console import Console

from gyrocal.recording import Recording
from simulator.adopted_scenario import hash_recording
from studies.report import svg
from studies.report.tables import format_cells, print_table
from studies.report.units import format_heading

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

NUMERIC_CELL = re.compile(r"[-+−–]?\d[\d.,]*(e[-+]?\d+)?( ± \d[\d.]*)?$|–$|$")


class SmallParagraph(str):
    """A paragraph in small, grey letters."""

    kind = "quiet"


@dataclass(frozen=True)
class Picture:
    """A figure of the page."""

    name: str  # of its anchor
    draw: Callable[[], Figure | bytes]  # makes it, or its SVG
    alt: str  # its content in words, for those who do not see it
    caption: str  # how to read it

    @property
    def source(self) -> str:
        """The figure as SVG in a URL that holds it."""
        figure = self.draw()
        data = svg.shorten_svg(figure if isinstance(figure, bytes) else svg.render_svg(figure))
        return f"data:image/svg+xml;base64,{base64.b64encode(data).decode()}"


@dataclass(frozen=True)
class PageTable:
    """A table of the page; a column of numbers is aligned at its right."""

    frame: pd.DataFrame  # its cells, texts or numbers
    strong: Sequence[bool] | pd.Series = ()  # rows in bold; none by default
    label: str = "Table"  # its content: the title on the terminal, the name for a screen reader
    note: str = ""  # how to read it
    most_rows: int | None = None  # on the terminal; all by default

    @cached_property
    def _texts(self) -> list[list[str]]:
        return list(format_cells(self.frame, {}))

    @cached_property
    def _numeric(self) -> list[bool]:
        return [all(NUMERIC_CELL.match(text) for text in column) for column in zip(*self._texts, strict=True)]

    @property
    def heads(self) -> list[tuple[str, bool]]:
        """Names of the columns, and whether they are numbers."""
        names = [format_heading(str(name)) for name in self.frame.columns]
        return list(zip(names, self._numeric or [False] * len(names), strict=True))

    @property
    def rows(self) -> Iterator[tuple[bool, list[tuple[str, bool]]]]:
        """Whether a row is strong, and its texts."""
        strong = list(self.strong) or [False] * len(self._texts)
        for is_strong, row in zip(strong, self._texts, strict=True):
            yield bool(is_strong), list(zip(row, self._numeric, strict=True))


Item = str | Picture | PageTable | Mapping[str, str] | Sequence[str] | Sequence[Picture] | Sequence[PageTable]


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    title: str  # its heading, "" for none
    # paragraphs, lists, definitions (a mapping), tables, figures and pairs of figures in their order; empty ones are left out
    items: Sequence[Item]
    level: int = 2  # of the heading
    anchor: str = ""  # name of the heading; made of the title by default

    @property
    def name(self) -> str:
        """The anchor."""
        return self.anchor or make_slug(self.title)


@dataclass(frozen=True)
class Answer:
    """The first screen of a page."""

    kind: str  # "gap", "open", or "" for an agreement
    picture: Picture | None  # of the answer
    sentence: str  # of the answer
    lines: Mapping[str, str] = field(default_factory=dict)  # answers by question


@dataclass(frozen=True)
class ProvenanceFooter:
    """Contents of a page's footer."""

    version: str  # of gyrocal
    day: str  # as YYYY-MM-DD, UTC
    command: str  # as typed
    sha256: str = ""  # of the input's samples, references and stated noises, or "" if there is none


def build_provenance_footer(recording: Recording | None = None) -> ProvenanceFooter:
    """Describe the command that is running, and the recording it reads."""
    command = shlex.join(["gyrocal", *sys.argv[1:]])
    date = datetime.now(UTC).date().isoformat()
    return ProvenanceFooter(metadata.version("gyrocal"), date, command, "" if recording is None else hash_recording(recording))


@dataclass(frozen=True)
class Page:
    """A whole page."""

    title: str  # its heading
    sections: Sequence[Section]  # in order
    answer: Answer | None = None  # the first screen
    provenance: ProvenanceFooter | None = None  # of the result, for the footer
    short: str = ""  # title of the window; the heading by default

    @property
    def chapters(self) -> list[Section]:
        """Sections of the first level, which the page lists."""
        return [section for section in self.sections if section.level == 2 and section.title]

    def render_html(self) -> str:
        """Render the page; the same content gives the same bytes."""
        style = Markup(resources.files("studies.report").joinpath("templates", "style.css").read_text(encoding="utf-8"))
        return _create_environment().get_template("page.html").render(page=self, style=style).lstrip()

    def show(self, console: Console) -> None:
        """Print the page without its figures."""
        _print_lines(console, [f"{self.short}: {self.title}." if self.short else f"{self.title}."])
        if self.answer:
            _print_lines(console, [self.answer.sentence, *(f"{name} {text}" for name, text in self.answer.lines.items())])
        for section in self.sections:
            _show_section(console, section)


def _show_section(console: Console, section: Section) -> None:
    """Print the texts of a section below its title, and its tables below theirs."""
    lines: list[str] = []
    for item in section.items:
        if isinstance(item, PageTable):
            shown = item.frame.head(item.most_rows or len(item.frame))
            hidden = len(item.frame) - len(shown)
            note = f"{item.note} {hidden} more rows are in the JSON and on the page.".strip() if hidden else item.note
            print_table(console, item.label, shown, note)
        elif isinstance(item, str):
            lines.append(item)
        elif isinstance(item, Mapping):
            lines += [f"- {name}: {text}" for name, text in item.items()]
        elif not isinstance(item, Picture):
            lines += [f"- {text}" for text in item]
    if any(lines):
        is_titled = any(isinstance(item, PageTable) and item.label == section.title for item in section.items)
        _print_lines(console, lines if is_titled or not section.title else ["", section.title, *lines])


def _print_lines(console: Console, lines: Sequence[str]) -> None:
    """Print lines without markup, folded where the console has a width to fold to."""
    for line in lines:
        hang = "  " if line.startswith("- ") else ""
        folded = line if console.soft_wrap else textwrap.fill(line, console.width, subsequent_indent=hang)
        console.print(folded, highlight=False, markup=False, emoji=False)


@cache
def _create_environment() -> Environment:
    from jinja2 import Environment, PackageLoader  # late: the terminal needs no template

    return Environment(loader=PackageLoader("studies.report"), autoescape=True, trim_blocks=True, lstrip_blocks=True)


def make_slug(text: str) -> str:
    """Make the name of an anchor from a text."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
