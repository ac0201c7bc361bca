"""Figures as SVG: text stays text, and the bytes depend on nothing but the content.

Matplotlib names clip paths, markers and hatches by a hash of the exact floats, the last bits of which differ between machines.
Here each is named by its own text, whose numbers are rounded to the file's digits.
"""

from __future__ import annotations

import hashlib
import io
import re
from typing import TYPE_CHECKING, Any

from studies.report.printable import make_well_formed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SVG_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "gyrocal",
    "svg.fonttype": "none",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
}
NO_METADATA: dict[str, None] = {"Date": None, "Creator": None, "Format": None, "Type": None}

# A marker, or a clip path or hatch from its name to its end; and places of such names.
DEFINED = re.compile(rb'<path id="(m[0-9a-f]{10})".*?/>|<(clipPath|pattern)[^>]* id="([a-z][0-9a-f]{10})".*?</\2>', re.DOTALL)
NAMED = re.compile(rb'(id="|#)([a-z][0-9a-f]{10})(?=["\')])')
COORDINATE_ATTRIBUTES = re.compile(rb'\b(?:d|x|y)="[^"]*"')
EXCESS_DECIMALS = re.compile(rb"(\.\d)\d+")  # a tenth of a point is not seen


def render_svg(figure: Figure) -> bytes:
    """Render a figure as SVG."""
    out = io.BytesIO()
    import matplotlib as mpl

    with mpl.rc_context(SVG_STYLE):
        figure.savefig(out, format="svg", dpi=130, metadata=NO_METADATA)
    return name_by_content(make_well_formed(out.getvalue()))


def name_by_content(svg: bytes) -> bytes:
    """Rename the elements of an SVG, so that names do not depend on the last bits of floats."""
    names = {}
    for match in DEFINED.finditer(svg):
        name = match[1] or match[3]
        names[name] = name[:1] + hashlib.sha256(match[0].replace(name, b"")).hexdigest()[:10].encode()
    return NAMED.sub(lambda match: match[1] + names.get(match[2], match[2]), svg)


def shorten_svg(svg: bytes) -> bytes:
    """Shorten an SVG for a page: coordinates to a tenth of a point, without line breaks."""
    return re.sub(rb"\s*\n\s*", b" ", COORDINATE_ATTRIBUTES.sub(lambda match: EXCESS_DECIMALS.sub(rb"\1", match[0]), svg))
