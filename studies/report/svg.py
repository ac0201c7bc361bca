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
    """A figure as SVG."""
    out = io.BytesIO()
    import matplotlib as mpl

    with mpl.rc_context(SVG_STYLE):
        figure.savefig(out, format="svg", dpi=130, metadata=NO_METADATA)
    return name_by_content(make_well_formed(out.getvalue()))


def name_by_content(svg: bytes) -> bytes:
    """The same SVG with names that do not depend on the last bits of floats."""
    names = {}
    for found in DEFINED.finditer(svg):
        name = found[1] or found[3]
        names[name] = name[:1] + hashlib.sha256(found[0].replace(name, b"")).hexdigest()[:10].encode()
    return NAMED.sub(lambda found: found[1] + names.get(found[2], found[2]), svg)


def shorten_svg(svg: bytes) -> bytes:
    """The same SVG for a page: places to a tenth of a point, without line breaks."""
    return re.sub(rb"\s*\n\s*", b" ", COORDINATE_ATTRIBUTES.sub(lambda found: EXCESS_DECIMALS.sub(rb"\1", found[0]), svg))
