"""What every page must be: whole, labelled, without a network, and readable in a narrow window and in the dark."""

import json
import re
import shutil
import subprocess
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

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
        self.resources += [value for name, value in attrs if name in ("src", "data", "srcset", "poster")]
        if "href" in attributes:
            self.links.append(attributes["href"])
        if re.fullmatch(r"h[1-6]", tag):
            self.headings.append(int(tag[1]))
        if tag == "figure":
            self.figures[attributes["id"]] = None
        if tag == "img":
            self.labels.append(attributes.get("alt", ""))
            self.figures[next(reversed(self.figures))] = attributes.get("alt", "")
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
    assert {one[:40] for one in page.resources if not one.startswith("data:image/svg+xml;base64,")} == set()
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


LOOK = """
addEventListener('load', () => { const out = [...document.querySelectorAll('iframe')].map(f => {
  const d = f.contentDocument, w = f.contentWindow, root = d.documentElement, style = e => w.getComputedStyle(e);
  const figures = [...d.querySelectorAll('img')].map(e => e.naturalWidth);
  const rgb = text => { const v = text.match(/[\\d.]+/g).map(Number); return v.length < 4 ? [...v, 1] : v; };
  const light = v => [0, 1, 2].map(k => v[k] / 255).map(x => x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4)
    .reduce((sum, x, k) => sum + x * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = e => { for (; e; e = e.parentElement) { const v = rgb(style(e).backgroundColor); if (v[3] > 0.5) return v; }
    return [255, 255, 255, 1]; };
  const ratio = (a, b) => { const [low, high] = [light(a), light(b)].sort((x, y) => x - y);
    return (high + 0.05) / (low + 0.05); };
  const own = e => [...e.childNodes].some(n => n.nodeType === 3 && n.data.trim()) && !e.closest('script, style, title');
  const shown = e => e.getClientRects().length > 0 && style(e).visibility === 'visible' && style(e).opacity > 0;
  const said = [...d.querySelectorAll('body *')].filter(e => own(e) && shown(e))
    .map(e => [ratio(rgb(style(e).color), behind(e)), e.textContent.slice(0, 40)]).sort((a, b) => a[0] - b[0])[0];
  const controls = [...d.querySelectorAll('a[href], button, summary')];
  const cut = Math.max(0, ...[...d.querySelectorAll('.scroll')].map(e => e.scrollWidth - e.clientWidth));
  const answer = {cut, spill: root.scrollWidth - root.clientWidth, height: root.scrollHeight, figures, contrast: said[0],
    faint: said[1], dark: light(behind(d.body)) < 0.1, unreachable: controls.filter(e => e.tabIndex < 0).map(e => e.outerHTML)};
  return answer; });
  document.body.innerHTML = '<pre id=out>' + JSON.stringify(out).replaceAll('<', '&lt;') + '</pre>'; });
"""


def browsed(pages, folder, dark=False, widths=(390, 1280)):
    """What a browser makes of pages by (name, width): how far each spills over, its least contrast, what its script does.

    Pages are texts by name, or names of those that are in the folder.
    """
    keys = [(name, width) for name in pages for width in widths]
    for name, text in pages.items() if isinstance(pages, dict) else ():
        (folder / f"{name}.html").write_text(text)
    frames = "".join(f'<iframe width="{width}" height="800" src="{name}.html"></iframe>' for name, width in keys)
    (folder / "host.html").write_text(f"<!doctype html><body>{frames}<script>{LOOK}</script></body>")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--virtual-time-budget=4000"]
    options += [f"--user-data-dir={folder / 'profile'}", f"--blink-settings=preferredColorScheme={0 if dark else 1}"]
    host = (Path(folder) / "host.html").as_uri()
    done = subprocess.run([BROWSER, *options, "--dump-dom", host], capture_output=True, text=True, check=True, timeout=60)
    answers = json.loads(unescape(re.search(r'<pre id="out">(.*?)</pre>', done.stdout, re.DOTALL)[1]))
    return dict(zip(keys, answers, strict=True))
