"""A folder of results as sections of a page: its report in Markdown, its figures, and how each file was made."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd
from markdown_it import MarkdownIt
from markdown_it.rules_core import StateCore
from markdown_it.token import Token
from markupsafe import Markup

from studies.report.pages import NUMERIC_CELL, Item, Page, Picture, ProvenanceFooter, Section, SmallParagraph, make_slug

LONG = 40  # rows of a report's table, above which it is folded

_IMAGE = re.compile(r"^!\[([^\]]*)\]\(([^)]+)\)$", re.MULTILINE)


@dataclass(frozen=True)
class Source:
    """A folder of results and its manifest."""

    folder: Path  # with its ``manifest.json``
    manifest: Mapping[str, Any]  # its content

    @classmethod
    def load(cls, folder: Path) -> Source:
        """The folder with its manifest."""
        path = folder / "manifest.json"
        return cls(folder, json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {})

    def describe_origin(self, file: str) -> SmallParagraph:
        """Command, commit and hash that make a file again."""
        command = self.manifest.get("command") or f"gyrocal study {self.folder.name}"
        commit, sha256 = self.manifest.get("commit") or "unknown", self.manifest.get("files", {}).get(file, "unknown")
        later = self.manifest.get("reported", {}).get("commit", "")
        again = f", reported from its rows at {_shorten_commit(later)}" if later else ""
        return SmallParagraph(f"{command} at commit {_shorten_commit(commit)}{again}; {file}, SHA-256 {sha256[:16]}")

    def figure(self, file: str, alt: str) -> list[Item]:
        """A figure of the folder with its origin; nothing if it is not there."""
        path = self.folder / file
        if not path.is_file():
            return []
        return [Picture(f"{self.folder.name}-{path.stem}", path.read_bytes, alt, alt), self.describe_origin(file)]

    def title(self, file: str) -> str:
        """Title of a report in the folder; empty if it is not there."""
        return self._read_text(file).partition("\n")[0].removeprefix("# ")

    def _read_text(self, file: str) -> str:
        path = self.folder / file
        return path.read_text(encoding="utf-8") if path.is_file() else ""

    def sections(self, file: str, level: int, anchor: Callable[[str], str]) -> Iterator[Section]:
        """Sections of a report in the folder, without its title.

        Parameters
        ----------
        file : the report, in Markdown; nothing if it is not there
        level : of the headings
        anchor : name of a heading by its title
        """
        parts = re.split(r"^## (.*)\n", re.sub(r"\A# .*\n", "", self._read_text(file)), flags=re.MULTILINE)
        for title, body in zip(["", *parts[1::2]], parts[::2], strict=True):
            yield Section(title, self._build_items(body), level, anchor(title))

    def _build_items(self, text: str) -> list[Item]:
        """Text of a report, with its figures between."""
        items: list[Item] = []
        texts = _IMAGE.split(text)
        for body, alt, file in zip(texts[::3], [*texts[1::3], ""], [*texts[2::3], ""], strict=True):
            items += [render_markdown(body), *self.figure(file, alt)] if file else [render_markdown(body)]
        return items


def render_markdown(text: str) -> Markup:
    """Markdown as HTML; its own HTML is text, and so are links that lead out of the page."""
    return Markup(_create_parser().render(text))


@cache
def _create_parser() -> MarkdownIt:
    parser = MarkdownIt("commonmark", {"html": False}).enable("table")
    parser.core.ruler.push("pages", _fit_to_page)
    parser.add_render_rule("table_open", _open_table)
    parser.add_render_rule("table_close", _close_table)
    return parser


def _open_table(_: object, tokens: Sequence[Token], index: int, *__: object) -> str:
    count = tokens[index].meta["rows"]
    fold = f"<details><summary>Table of {count} rows</summary>" if count > LONG else ""
    return f'{fold}<div class="scroll" tabindex="0"><table>'


def _close_table(_: object, tokens: Sequence[Token], index: int, *__: object) -> str:
    return f"</table></div>{'</details>' if tokens[index].meta['rows'] > LONG else ''}"


def _fit_to_page(state: StateCore) -> None:
    """Align columns of numbers at their right, give headings of columns their scope, and drop links out of the page."""
    first = 0
    for k, token in enumerate(state.tokens):
        if token.type == "table_open":
            first = k
        elif token.type == "table_close":
            _fit_table(state.tokens[first : k + 1])
        elif token.children:
            links = [one for one in token.children if one.type == "link_open"]
            if any(not str(one.attrGet("href")).startswith("#") for one in links):
                token.children = [one for one in token.children if not one.type.startswith("link_")]


def _fit_table(tokens: Sequence[Token]) -> None:
    heads = [k for k, token in enumerate(tokens) if token.type == "th_open"]
    cells = [k for k, token in enumerate(tokens) if token.type == "td_open"]
    tokens[0].meta["rows"] = tokens[-1].meta["rows"] = len(cells) // len(heads)
    for column, head in enumerate(heads):
        own = cells[column :: len(heads)]
        tokens[head].attrSet("scope", "col")
        if own and all(NUMERIC_CELL.match(tokens[cell + 1].content) for cell in own):
            for cell in (head, *own):
                tokens[cell].attrSet("class", "number")


def _shorten_commit(commit: str) -> str:
    """A commit by twelve digits, and whether there were changes."""
    return commit[:12] + commit[40:]


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
