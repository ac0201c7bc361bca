"""Removal of control characters: text from a file must not move a terminal's cursor or break an XML document."""

import re

CONTROL_CHARACTERS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")  # and surrogates
IN_XML = bytes(code if code >= 0x20 or code in b"\t\n\r" else ord("?") for code in range(256))


def make_printable(text: str) -> str:
    """Make a text of one line, with its control characters as escape sequences."""
    return CONTROL_CHARACTERS.sub(lambda match: ascii(match[0])[1:-1], " ".join(text.split()))


def make_well_formed(xml: bytes) -> bytes:
    """Replace the characters of UTF-8 text that XML does not allow by question marks."""
    return xml.translate(IN_XML)
