"""Pieces of a page in HTML that needs no network: text, tables that scroll in themselves, figures with their text as text.

One template for everything that is reported as a page: light and dark, for a narrow window as for a wide one, for a
keyboard, for a screen reader and for paper.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape

import pandas as pd
from matplotlib.figure import Figure

from studies.report import svg
from studies.report.made import Made
from studies.report.units import heading as column_heading

STYLE = """
:root { --paper: #ffffff; --ink: #1b1f24; --quiet: #57606a; --line: #d0d7de; --soft: #f3f6f9; --link: #0550ae;
  --good: #1a7f37; --bad: #b3261e; --open: #8a5a00; color-scheme: light dark; }
@media screen and (prefers-color-scheme: dark) { :root { --paper: #0f1419; --ink: #e6e8eb; --quiet: #a3adb8;
  --line: #39424d; --soft: #1a2129; --link: #79b8ff; --good: #4ac26b; --bad: #ff8a80; --open: #e3b341; } }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; margin: 0;
  color: var(--ink); background: var(--paper); }
header, main, footer, nav { max-width: 1120px; margin: 0 auto; padding: 0 28px; }
header { padding-top: 24px; } main { padding-bottom: 48px; }
a { color: var(--link); }
.sr { position: absolute; width: 1px; height: 1px; overflow: hidden; clip-path: inset(50%); }
.skip { position: absolute; left: -999px; } .skip:focus { left: 8px; top: 8px; background: var(--paper); padding: 8px; }
h1 { font-size: 26px; line-height: 1.25; margin: 0 0 6px; }
h2 { font-size: 20px; margin: 44px 0 8px; border-bottom: 1px solid var(--line); }
h3 { font-size: 17px; margin: 26px 0 4px; } h4 { font-size: 15px; margin: 18px 0 2px; }
p, li, dd { max-width: 90ch; overflow-wrap: anywhere; }
p { margin: 6px 0 10px; }
nav ul { columns: 3 16em; padding-left: 18px; margin: 8px 0; font-size: 15px; }
.answer { border-left: 6px solid var(--good); background: var(--soft); padding: 14px 20px; margin: 16px 0; }
.answer.gap { border-color: var(--bad); } .answer.open { border-color: var(--open); }
.answer .verdict { font-size: 19px; font-weight: 600; margin: 0 0 6px; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(260px, 1fr)); gap: 0 28px; }
.word { font-weight: 600; white-space: nowrap; } .word.good { color: var(--good); } .word.bad { color: var(--bad); }
.word.open { color: var(--open); }
figure { margin: 14px 0 6px; }
figcaption, .quiet { color: var(--quiet); }
figcaption, .made { font-size: 14px; }
.made { color: var(--quiet); overflow-wrap: anywhere; margin: 2px 0 14px; }
.drawing { overflow-x: auto; }
.drawing svg { display: block; width: 100%; height: auto; fill: var(--ink); font-family: "DejaVu Sans", Verdana, sans-serif; }
.drawing svg * { stroke-linejoin: round; stroke-linecap: butt; }
.drawing svg.fixed { background: #ffffff; fill: #000000; }
@media screen and (prefers-color-scheme: dark) { .drawing svg.fixed { filter: invert(0.93) hue-rotate(180deg); } }
.zooms svg.whole { cursor: zoom-in; margin: 0 auto; }
.zoom { font: inherit; font-size: 14px; color: var(--link); background: var(--soft); border: 1px solid var(--line);
  border-radius: 4px; padding: 2px 10px; margin: 4px 0; cursor: pointer; }
.pieces { display: none; }
.value { position: fixed; pointer-events: none; background: var(--ink); color: var(--paper); padding: 1px 6px;
  font-size: 13px; }
.value[hidden] { display: none; }
.bar svg { display: block; width: 100%; max-width: 640px; height: auto; margin-top: 8px; }
.scroll { overflow-x: auto; position: relative; max-width: 100%; margin: 8px 0; }
table { border-collapse: collapse; font-size: 14px; }
caption { text-align: left; color: var(--quiet); padding: 2px 0; }
th, td { padding: 3px 14px 3px 0; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; min-width: 3em; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.strong td { font-weight: 600; }
dt { font-weight: 600; } dd { margin: 0 0 6px 0; }
details { margin: 10px 0; } summary { cursor: pointer; font-weight: 600; }
code { font: 0.92em ui-monospace, "DejaVu Sans Mono", monospace; background: var(--soft); padding: 0 3px; border-radius: 3px; }
footer { border-top: 1px solid var(--line); color: var(--quiet); font-size: 14px; padding-top: 10px; padding-bottom: 28px;
  overflow-wrap: anywhere; }
:focus-visible { outline: 3px solid var(--link); outline-offset: 2px; }
@media screen and (max-width: 700px) {
  header, main, footer, nav { padding-left: 16px; padding-right: 16px; }
  .drawing svg.whole { min-width: 640px; }
  .stacks { overflow: hidden; position: relative; }
  .stacks svg.whole { position: absolute; width: 0; height: 0; min-width: 0; }
  .pieces { display: grid; gap: 10px; } .zoom { display: none; }
  td:not(.number) { min-width: 8em; } td.long { min-width: 20em; }
}
@media print { header, main, footer, nav { max-width: none; padding: 0; } nav, .skip, .zoom { display: none; }
  h2, h3 { break-after: avoid; } figure, tr { break-inside: avoid; } .scroll, .drawing { overflow: visible; } }
"""

# Shows what a place in a figure stands for, of a marker nearby or of the pointer, and enlarges one panel of several by a click
# on it or by a button, until the next click or Escape; a page is whole without it.
SCRIPT = """
(() => {
  const out = document.createElement('output'); out.className = 'value'; out.hidden = true; document.body.append(out);
  const at = (v, a, b, lo, hi, scale) => { const s = (v - a) / (b - a);
    return scale === 'log' ? lo * Math.pow(hi / lo, s) : lo + s * (hi - lo); };
  document.querySelectorAll('svg.whole[data-axes]').forEach(svg => {
    const axes = svg.dataset.axes.split(',').map(one => one.split(' ').map((v, k) => k < 8 ? parseFloat(v) : v));
    const marks = [...svg.querySelectorAll('use[x][y]')].map(u => ['x', 'y'].map(k => parseFloat(u.getAttribute(k))));
    svg.addEventListener('pointerleave', () => { out.hidden = true; });
    svg.addEventListener('pointermove', event => {
      const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      const own = axes.find(a => p.x > a[0] && p.x < a[2] && p.y > a[1] && p.y < a[3]);
      out.hidden = !own; if (!own) return;
      const within = (m, k) => m[k] > own[k] + 0.5 && m[k] < own[k + 2] - 0.5;
      const inside = marks.filter(m => within(m, 0) && within(m, 1));
      let place = [p.x, p.y], least = 8;
      inside.forEach(m => { const d = Math.hypot(m[0] - p.x, m[1] - p.y); if (d < least) { least = d; place = m; } });
      const x = at(place[0], own[0], own[2], own[4], own[5], own[8]), y = at(place[1], own[3], own[1], own[6], own[7], own[9]);
      out.textContent = `${x.toPrecision(4)}; ${y.toPrecision(4)}`;
      out.style.left = `${event.clientX + 12}px`; out.style.top = `${event.clientY + 12}px`;
    });
    const box = svg.closest('.stacks'); if (!box) return;
    const pieces = [...box.querySelectorAll('svg.piece')].map(p => p.getAttribute('viewBox'));
    const holds = (v, x, y) => { const [l, t, w, h] = v.split(' ').map(Number);
      return x > l && x < l + w && y > t && y < t + h; };
    const panels = pieces.filter(v => axes.some(a => holds(v, (a[0] + a[2]) / 2, (a[1] + a[3]) / 2)));
    const all = svg.getAttribute('viewBox'), wide = svg.style.maxWidth, button = document.createElement('button');
    let shown = -1;
    const show = k => { shown = k; svg.setAttribute('viewBox', k < 0 ? all : panels[k]);
      svg.style.maxWidth = k < 0 ? wide : `${3 * parseFloat(panels[k].split(' ')[2])}px`;
      svg.style.cursor = k < 0 ? '' : 'zoom-out';
      button.textContent = k < 0 ? 'Enlarge a panel' : k + 1 < panels.length ? 'Next panel' : 'Whole figure'; };
    button.type = 'button'; button.className = 'zoom'; box.classList.add('zooms'); box.append(button); show(-1);
    button.addEventListener('click', () => show(shown + 1 < panels.length ? shown + 1 : -1));
    box.addEventListener('keydown', event => { if (event.key === 'Escape') show(-1); });
    svg.addEventListener('click', event => { if (shown >= 0) return show(-1);
      const p = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
      show(panels.findIndex(v => holds(v, p.x, p.y))); });
  });
})();
"""
LONG = 40  # characters of a cell, which is not made narrow in a narrow window


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


def document(title: str, parts: Iterable[str], made: Made | None = None, contents: bool = False, short: str = "") -> str:
    """A whole page under a title, empty parts left out.

    Parameters
    ----------
    title : in words; the page's heading
    parts : of its body, in order
    made : what the footer says of how it came about
    contents : whether a list of the sections comes before them, after what precedes the first
    short : the title of the window; the heading by default
    """
    body = "\n".join(part for part in parts if part)
    if contents:
        first = body.find("<h2")
        body = f"{body[:first]}{_contents(body)}{body[first:]}"
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    script = f"<script>{SCRIPT}</script>\n" if "data-axes=" in body else ""
    foot = f"<footer>{made.line()}</footer>\n" if made else ""
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}<title>{escape(short or title)}</title>'
        f"<style>{STYLE}{svg.palette(body)}</style></head>\n"
        f'<body>\n<a class="skip" href="#content">To the content</a>\n<header><h1>{escape(title)}</h1></header>\n'
        f'<main id="content">\n{body}\n</main>\n{foot}{script}</body></html>\n'
    )


def _contents(body: str) -> str:
    """Links to the sections."""
    found = re.findall(r'<h2 id="([^"]+)">(.*?)</h2>', body)
    items = "".join(f'<li><a href="#{name}">{text}</a></li>' for name, text in found)
    return f'<nav aria-label="Sections"><ul>{items}</ul></nav>\n'


def slug(text: str) -> str:
    """A text as the name of an anchor."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


def heading(text: str, level: int = 2) -> str:
    """The heading of a section, which is its anchor too."""
    return f'\n<h{level} id="{slug(text)}">{escape(text)}</h{level}>\n'


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph, of a kind in the style."""
    return f"<p{f' class={kind}' if kind else ''}>{escape(text)}</p>\n"


def bullets(texts: Iterable[str]) -> str:
    """A list of sentences; nothing of none."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f"<ul>{items}</ul>\n" if items else ""


def folded(summary: str, body: str) -> str:
    """What is shown when it is asked for."""
    return f"<details><summary>{escape(summary)}</summary>\n{body}</details>\n"


def shown(picture: Picture) -> str:
    """A figure with its caption."""
    return figure(picture.name, svg.svg_bytes(picture.draw()), picture.alt, picture.caption)


def figure(name: str, data: bytes, alt: str, caption: str) -> str:
    """A figure in SVG with its caption."""
    drawing = svg.inline(data, slug(name), escape(alt))
    return f'<figure id="{escape(name)}">{drawing}<figcaption>{escape(caption)}</figcaption></figure>\n'


def table_of(
    table: pd.DataFrame,
    strong: Sequence[bool] | pd.Series | None = None,
    numbers: Sequence[str] = (),
    caption: str = "",
    label: str = "",
) -> str:
    """A table of texts that scrolls in itself.

    Parameters
    ----------
    table : its cells, as texts
    strong : lines in bold
    numbers : columns that end at their right
    caption : what is in it
    label : the same for a screen reader, where a heading says so already
    """
    bold = [False] * len(table) if strong is None else strong
    kinds = [" class=number" if column in numbers else "" for column in table.columns]
    heads = [escape(column_heading(str(column))) for column in table.columns]
    head = "".join(f"<th scope=col{kind}>{text}</th>" for text, kind in zip(heads, kinds, strict=True))
    rows = []
    for one, row in zip(bold, table.itertuples(index=False), strict=True):
        cells = "".join(_cell(value, kind) for value, kind in zip(row, kinds, strict=True))
        rows.append(f"<tr{' class=strong' if one else ''}>{cells}</tr>")
    name = escape(caption or label or f"Table: {', '.join(map(str, table.columns[:3]))}")
    above = f"<caption>{escape(caption)}</caption>" if caption else ""
    return (
        f'<div class="scroll" tabindex="0" role="group" aria-label="{name}"><table>{above}<thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>\n"
    )


class Html(str):
    """A cell that is HTML already."""


def _cell(value: object, kind: str) -> str:
    text = str(value)
    return f"<td{kind or (' class=long' if len(text) > LONG else '')}>{text if isinstance(value, Html) else escape(text)}</td>"
