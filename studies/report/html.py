"""Pieces of an HTML page that needs no network."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from html import escape

import pandas as pd
from matplotlib.figure import Figure

from studies.report.diagnosis_figures import svg

STYLE = """
body { font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1b1f24; margin: 0; background: #fff; }
main { max-width: 1120px; margin: 0 auto; padding: 24px 32px 64px; }
h1 { font-size: 24px; margin: 0 0 4px; }
h2 { font-size: 19px; margin: 40px 0 8px; border-bottom: 1px solid #d0d7de; }
h3 { font-size: 16px; margin: 20px 0 4px; }
p, li, dd { max-width: 90ch; }
p { margin: 6px 0 10px; }
.answer { border-left: 6px solid #0072b2; background: #f3f7fa; padding: 14px 20px; margin: 16px 0; }
.answer.gap { border-color: #d55e00; background: #fdf6f1; }
.answer .verdict { font-size: 19px; font-weight: 600; margin: 0 0 6px; }
figure { margin: 12px 0 4px; }
figure img { width: 100%; height: auto; display: block; }
figcaption, .quiet { color: #57606a; }
figcaption { font-size: 14px; }
table { border-collapse: collapse; font-size: 14px; margin: 8px 0; }
th, td { padding: 3px 12px 3px 0; border-bottom: 1px solid #e4e8ec; text-align: left; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
tr.strong td { font-weight: 600; }
dt { font-weight: 600; }
dd { margin: 0 0 6px 0; }
code { font: 0.92em ui-monospace, "DejaVu Sans Mono", monospace; background: #f0f2f4; padding: 0 3px; border-radius: 3px; }
@media print { main { padding: 0; } h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
"""


@dataclass(frozen=True)
class Picture:
    """A figure of the page.

    Attributes
    ----------
    name : of its anchor
    draw : makes it
    alt : what it shows, for those who do not see it
    caption : how to read it
    """

    name: str
    draw: Callable[[], Figure]
    alt: str
    caption: str


def document(title: str, parts: Iterable[str]) -> str:
    """A whole page of parts; empty ones are left out."""
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n'
        f"<body><main>\n<h1>{escape(title)}</h1>\n" + "\n".join(part for part in parts if part) + "\n</main></body></html>\n"
    )


def h2(text: str) -> str:
    """A heading."""
    return f"\n<h2>{escape(text)}</h2>\n"


def p(text: str, kind: str = "") -> str:
    """A paragraph of a class."""
    return f"<p{f' class={kind}' if kind else ''}>{escape(text)}</p>\n"


def shown(picture: Picture) -> str:
    """A figure."""
    data = base64.b64encode(svg(picture.draw())).decode("ascii")
    return (
        f'<figure id="{escape(picture.name)}"><img src="data:image/svg+xml;base64,{data}" alt="{escape(picture.alt)}">'
        f"<figcaption>{escape(picture.caption)}</figcaption></figure>\n"
    )


def table(table: pd.DataFrame, strong: pd.Series, numbers: list[str]) -> str:
    """A table of texts, some rows of it strong, some columns of it numbers."""
    kinds = [" class=number" if column in numbers else "" for column in table.columns]
    head = "".join(f"<th{kind}>{escape(str(column))}</th>" for column, kind in zip(table.columns, kinds, strict=True))
    rows = []
    for bold, row in zip(strong, table.itertuples(index=False), strict=True):
        cells = "".join(f"<td{kind}>{escape(str(value))}</td>" for value, kind in zip(row, kinds, strict=True))
        rows.append(f"<tr{' class=strong' if bold else ''}>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>\n"
