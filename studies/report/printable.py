"""Text as a terminal and a page may have it: what is in a file must not move the cursor or break an XML document."""

import re

CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")  # and halves of what UTF-16 has as pairs


def printable(text: str) -> str:
    """A text on one line, its control characters as what stands for them in a program."""
    return CONTROL.sub(lambda found: ascii(found[0])[1:-1], " ".join(text.split()))
