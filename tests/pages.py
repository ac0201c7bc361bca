"""What every page must be: whole, labelled, without a network, and readable in a narrow window and in the dark."""

import json
import re
import shutil
import subprocess
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

from studies.report import svg
from studies.report.html import STYLE

VOID = {"meta", "br", "hr", "img", "link", "input"}
OUTSIDE = ("http:", "https:", "//", "file:")
BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
SPILT = 2  # pixels by which a page may be wider than its window


class Page(HTMLParser):
    """Elements, ids, links and headings of a page; closes what it opens."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.resources, self.headings, self.figures = [], [], [], [], [], {}
        self.labels, self.tables, self.landmarks, self.text = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        if "id" in attributes:
            self.ids.append(attributes["id"])
        self.resources += [value for name, value in attrs if name in ("src", "data", "srcset", "poster", "xlink:href")]
        if "href" in attributes:
            (self.resources if tag == "image" else self.links).append(attributes["href"])
        if re.fullmatch(r"h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag == "figure":
            self.figures[attributes["id"]] = None
        if tag == "svg" and attributes.get("role") == "img":
            self.labels.append(attributes.get("aria-label", ""))
            if self.figures:
                self.figures[next(reversed(self.figures))] = attributes.get("aria-label", "")
        if tag in ("main", "header", "footer", "nav"):
            self.landmarks.append(tag)
        if tag == "th":
            self.tables.append("scope" in attributes)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text.append(data)

    @property
    def words(self):
        """All that can be read, figures included."""
        return " ".join(" ".join(self.text).split())


def checked(text, most_bytes=2_000_000):
    """The page, if it is as every page must be."""
    page = Page(text)
    assert page.open == []
    assert text.startswith('<!doctype html>\n<html lang="en">')
    assert page.landmarks.count("main") == page.landmarks.count("header") == 1
    assert len(page.ids) == len(set(page.ids)), [one for one in page.ids if page.ids.count(one) > 1][:5]
    assert set(page.links) - {f"#{name}" for name in page.ids} == set()
    assert {one[:40] for one in page.resources if not one.startswith(("data:image/png", "#"))} == set()
    assert not re.search(r"url\((?!#|&quot;#)", text)
    assert not any(f'"{one}' in text for one in OUTSIDE)
    assert page.headings[0] == 1
    assert page.headings.count(1) == 1
    assert all(b - a <= 1 for a, b in zip(page.headings, page.headings[1:], strict=False))
    assert all(page.labels)
    assert all(page.tables)
    assert len(text.encode()) < most_bytes
    assert "nan" not in page.words.lower().replace("natanson", "").split()
    return page


def colours(dark):
    """The style's own colours by name."""
    light, night = re.search(r":root \{(.*?)\}.*?:root \{(.*?)\}", STYLE, flags=re.DOTALL).groups()
    return dict(re.findall(r"--(\w+): (#[0-9a-f]{6})", night if dark else light))


def least_contrast(text, dark):
    """The least contrast of a figure's colour, greys aside, with the paper."""
    names = re.findall(r"--c-([0-9a-f]{6}):(#[0-9a-f]{6})", text)
    half = len(names) // 2
    chosen = names[half:] if dark else names[:half]
    paper = colours(dark)["paper"]
    found = [svg.contrast(shown, paper) for name, shown in chosen if len({name[:2], name[2:4], name[4:]}) > 1]
    return min(found, default=99.0)


def in_a_browser(text, folder, widths=(390, 1280)):
    """What a browser makes of a page in windows of these widths: how far it spills over, and its least text."""
    (folder / "page.html").write_text(text)
    frames = "".join(f'<iframe width="{width}" height="800" src="page.html"></iframe>' for width in widths)
    script = """
    addEventListener('load', () => { const out = [...document.querySelectorAll('iframe')].map(f => {
      const d = f.contentDocument, w = f.contentWindow, root = d.documentElement;
      const seen = [...d.querySelectorAll('.whole, .piece')].filter(e => e.getBoundingClientRect().width > 5);
      const sizes = seen.flatMap(e => [...e.querySelectorAll('text')].map(t => parseFloat(w.getComputedStyle(t).fontSize)
        * e.getBoundingClientRect().width / e.viewBox.baseVal.width));
      return {spill: root.scrollWidth - root.clientWidth, least: Math.min(99, ...sizes), pieces:
        seen.filter(e => e.classList.contains('piece')).length, height: root.scrollHeight}; });
      document.body.innerHTML = '<pre id=out>' + JSON.stringify(out) + '</pre>'; });
    """
    (folder / "host.html").write_text(f"<!doctype html><body>{frames}<script>{script}</script></body>")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--virtual-time-budget=4000"]
    profile = f"--user-data-dir={folder / 'profile'}"
    host = (Path(folder) / "host.html").as_uri()
    done = subprocess.run(
        [BROWSER, *options, profile, "--dump-dom", host], capture_output=True, text=True, check=True, timeout=60
    )
    return dict(
        zip(widths, json.loads(unescape(re.search(r'<pre id="out">(.*?)</pre>', done.stdout, re.DOTALL)[1])), strict=True)
    )
