"""Names inside an SVG that do not depend on the last bits of floats.

Matplotlib names clip paths, markers and hatches by a hash of the exact floats, the last bits of which differ between machines.
Here each is named by what is written of it, its numbers rounded to the file's digits. Of two figures in one page, what has the
same name still is the same.
"""

import hashlib
import re

# A marker, or a clip path or hatch from its name to its end; and where such names stand.
DEFINED = re.compile(rb'<path id="(m[0-9a-f]{10})".*?/>|<(clipPath|pattern)[^>]* id="([a-z][0-9a-f]{10})".*?</\2>', re.DOTALL)
NAMED = re.compile(rb'(id="|#)([a-z][0-9a-f]{10})(?=["\')])')


def stable(svg: bytes) -> bytes:
    """The same SVG with such names."""
    names = {}
    for found in DEFINED.finditer(svg):
        name = found[1] or found[3]
        names[name] = name[:1] + hashlib.sha256(found[0].replace(name, b"")).hexdigest()[:10].encode()
    return NAMED.sub(lambda found: found[1] + names.get(found[2], found[2]), svg)
