"""Figures as SVG: text stays text, the bytes depend on nothing but what is shown, and a page can take them in.

Inside a page a figure follows the page's light or dark colours and stacks its panels where the window is narrow. For that
a file of `svg_bytes` says where its panels are (attribute ``data-panels``, in points), unless a panel needs its neighbour's
labels; whether its colours must stay as they are (``data-fixed``: a map, whose numbers are written on its colours); and what
places in its axes stand for (``data-axes``), from which a page's script tells values.
"""

from __future__ import annotations

import colorsys
import io
import re
import zlib
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from studies.report.printable import well_formed
from studies.report.stable_ids import stable

STYLE: dict[Any, Any] = {
    "svg.hashsalt": "gyrocal",
    "svg.fonttype": "none",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
}
NO_METADATA: dict[str, None] = {"Date": None, "Creator": None, "Format": None, "Type": None}
POINTS = 72.0  # an inch
MARGIN = 2.0  # points around a panel
LIGHT, DARK = ("#ffffff", "#1b1f24"), ("#0f1419", "#e6e8eb")  # paper and ink of pages
CONTRAST = 4.5  # of a colour on the dark paper, as WCAG 2 asks of text
GREY = 0.08  # saturation below which a colour is a grey

_COLOUR = re.compile(r"#([0-9a-fA-F]{6})\b")
_FONT = re.compile(r"font-family: [^;\"]*;?\s*")
_PLACES = re.compile(r'\b(?:d|x|y)="[^"]*"')
_LONG = re.compile(r"(\d\.\d\d)\d+")  # a hundredth of a point is not seen
# Markers of one style, one after another: a scatter has thousands.
_ALIKE = re.compile(r'<use ([^>]*?)style="([^"]*)"/>(?: <use [^>]*?style="\2"/>){2,}')
_HEAD = re.compile(rb"^.*?(?=<svg)", re.DOTALL)


def svg_bytes(figure: Figure, dpi: int = 130) -> bytes:
    """A figure as SVG; what is drawn as pixels has so many an inch."""
    out = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(out, format="svg", dpi=dpi, metadata=NO_METADATA)
    marks = f' data-panels="{_places(figure)}"' if _stand_alone(figure) else ""
    marks += f' data-axes="{_scales(figure)}"'
    marks += ' data-fixed="yes"' if any(isinstance(one, QuadMesh) for axes in figure.axes for one in axes.collections) else ""
    return stable(well_formed(out.getvalue())).replace(b"<svg ", f"<svg{marks} ".encode(), 1)


def _scales(figure: Figure) -> str:
    """Left, top, right and bottom of each pair of axes in points, its limits and scales: what a place in it stands for."""
    width, height = (size * POINTS for size in figure.get_size_inches())
    out = []
    for axes in figure.axes:
        x, y = (axes.get_xscale(), axes.get_yscale())
        if {x, y} <= {"linear", "log"}:
            box = axes.get_position()
            place = (box.x0 * width, (1 - box.y1) * height, box.x1 * width, (1 - box.y0) * height)
            limits = (*axes.get_xlim(), *axes.get_ylim())
            out.append(" ".join([*(f"{one:.1f}" for one in place), *(f"{one:.6g}" for one in limits), x, y]))
    return ",".join(out)


def _stand_alone(figure: Figure) -> bool:
    """Whether there are several panels and each has its own labels."""
    axes = figure.axes
    labelled = all(
        one.xaxis.get_tick_params().get("labelbottom", True) and one.yaxis.get_tick_params().get("labelleft", True)
        for one in axes
    )
    return len(axes) > 1 and labelled


def _places(figure: Figure) -> str:
    """Left, top, width and height of the title, the legend and each panel, in points."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [one.get_window_extent(renderer) for one in (*figure.texts, *figure.legends)]
    boxes += [box for axes in figure.axes if (box := axes.get_tightbbox(renderer)) is not None]
    scale, height = POINTS / figure.dpi, figure.get_figheight() * POINTS
    places = []
    for box in boxes:
        left, top = box.x0 * scale - MARGIN, height - box.y1 * scale - MARGIN
        places.append(f"{left:.1f} {top:.1f} {box.width * scale + 2 * MARGIN:.1f} {box.height * scale + 2 * MARGIN:.1f}")
    return ",".join(places)


def inline(data: bytes, name: str, label: str) -> str:
    """A figure as a piece of a page.

    Parameters
    ----------
    data : SVG, of `svg_bytes` or of a file
    name : its own in the page, of which the names of its parts are made
    label : what it shows, for those who do not see it; escaped
    """
    text = _HEAD.sub(b"", data, count=1).decode()
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<style[^>]*>.*?</style>", "", text, flags=re.DOTALL)
    panels, fixed = re.search(r'data-panels="([^"]*)"', text[:4000]), 'data-fixed="yes"' in text[:4000]
    used = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
    start = f"i{zlib.crc32(name.encode()) % 36**4}"  # of the names of its parts: short, since there are thousands
    own = {one or other: f"{start}-{k}" for k, (one, other) in enumerate(sorted(used))}
    text = re.sub(r'\bid="([^"]+)"', lambda found: f'id="{own[found[1]]}"' if found[1] in own else "", text)
    text = re.sub(r'(?:xlink:)?href="#([^"]+)"', lambda found: f'href="#{own[found[1]]}"', text)
    text = re.sub(r"url\(#([^)]+)\)", lambda found: f"url(#{own[found[1]]})", text).replace("xlink:href", "href")
    text = re.sub(r"\s*\n\s*", " ", _FONT.sub("", text)).replace(" >", ">")
    text = _PLACES.sub(lambda found: _LONG.sub(r"\1", found[0]), text)
    text = _ALIKE.sub(_together, text)
    body = text if fixed else _COLOUR.sub(lambda found: f"var(--c-{found[1].lower()})", text)
    box, axes = re.search(r'viewBox="([^"]+)"', body), re.search(r'data-axes="([^"]*)"', text[:4000])
    size = box[1] if box else "0 0 100 100"
    inner = body[body.index(">") + 1 : body.rindex("</svg>")]
    kept = " fixed" if fixed else ""
    width = float(size.split()[2])
    scales = f' data-axes="{axes[1]}"' if axes and axes[1] else ""
    look = f'viewBox="{size}"{scales} style="max-width:{width * 1.5:.0f}px"'
    whole = f'<svg class="whole{kept}" role="img" aria-label="{label}" {look}>'
    if not panels:
        return f'<div class="drawing" tabindex="0" role="group" aria-label="{label}">{whole}{inner}</svg></div>'
    pieces = "".join(
        f'<svg class="piece{kept}" viewBox="{place}" aria-hidden="true"><use href="#{name}-all"/></svg>'
        for place in panels[1].split(",")
    )
    return f'<div class="drawing stacks">{whole}<g id="{name}-all">{inner}</g></svg><div class="pieces">{pieces}</div></div>'


def _together(found: re.Match[str]) -> str:
    """Markers of one style in a group, which has the style."""
    style = found[2]
    return f'<g style="{style}">' + found[0].replace(f' style="{style}"', "").replace("> <use", "><use") + "</g>"


def palette(page: str) -> str:
    """The page's colours of figures as CSS variables, light and dark."""
    found = sorted(set(re.findall(r"var\(--c-([0-9a-f]{6})\)", page)))
    light = "".join(f"--c-{one}:#{one};" for one in found)
    dark = "".join(f"--c-{one}:{at_night('#' + one)};" for one in found)
    return f":root{{{light}}} @media screen and (prefers-color-scheme: dark){{:root{{{dark}}}}}"


def at_night(colour: str) -> str:
    """The partner of a colour on dark paper: greys go from ink to paper, others become light enough to stand out."""
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    if max(red, green, blue) - min(red, green, blue) < GREY:
        ends = [[int(one[k : k + 2], 16) / 255 for k in (1, 3, 5)] for one in (DARK[1], DARK[0])]
        return _hex(tuple(low + (high - low) * lightness for low, high in zip(*ends, strict=True)))
    while contrast(_hex((red, green, blue)), DARK[0]) < CONTRAST:
        lightness = min(lightness + 0.02, 1.0)
        red, green, blue = colorsys.hls_to_rgb(hue, lightness, saturation)
    return _hex((red, green, blue))


def _hex(rgb: tuple[float, ...]) -> str:
    return "#" + "".join(f"{round(255 * min(max(one, 0.0), 1.0)):02x}" for one in rgb)


def contrast(one: str, other: str) -> float:
    """Contrast ratio of two colours, (L1 + 0.05)/(L2 + 0.05) with the relative luminances L of WCAG 2.2."""

    def luminance(colour: str) -> float:
        linear = []
        for k in (1, 3, 5):
            value = int(colour[k : k + 2], 16) / 255
            linear.append(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4)
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)
