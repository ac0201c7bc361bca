"""NAIF's double precision array files (DAF) as far as CK needs them: arrays with two doubles and six integers each.

A file is records of 1024 bytes. The first says how the others are to be read. Summary records form a list, three doubles (next,
previous, count) and then five doubles for each array, the last three of which are its six integers; a record of names follows
each. Addresses count doubles from 1 (NAIF, "DAF Required Reading").
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.files import replacing

Array = NDArray[np.float64]

RECORD = 1024
WORDS = RECORD // 8
SUMMARY = 5  # doubles: two, and six integers of half a double
NAME = 8 * SUMMARY
FORMATS = {b"LTL-IEEE": "<", b"BIG-IEEE": ">"}
# Bytes that a transfer as text would change: what follows FTPSTR must stand in the file as it is here.
TRANSFER = b"FTPSTR:\r:\n:\r\n:\r\x00:\x81:\x10\xce:ENDFTP"


@dataclass(frozen=True)
class Segment:
    """One array of a file.

    Attributes
    ----------
    name : of the array
    doubles : (2,) of its summary
    integers : the first four of its summary
    data : (n,) its numbers
    """

    name: str
    doubles: tuple[float, float]
    integers: tuple[int, int, int, int]
    data: Array


def read(path: str | os.PathLike[str], kind: str) -> list[Segment]:
    """The arrays of a file.

    Parameters
    ----------
    path : file
    kind : what it must hold, e.g. "CK"

    Raises
    ------
    InputError
        It is no such file, or damaged.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from None
    if content[:8] != f"DAF/{kind}".ljust(8).encode() or len(content) < RECORD:
        raise InputError(f"{path}: not a binary {kind} kernel of SPICE: it does not begin with DAF/{kind}")
    order = FORMATS.get(content[88:96])
    if order is None:
        raise InputError(f"{path}: its numbers are {content[88:96]!r}; read are {', '.join(name.decode() for name in FORMATS)}")
    nd, ni = np.frombuffer(content, f"{order}i4", 2, 8)
    record = int(np.frombuffer(content, f"{order}i4", 1, 76)[0])
    whole = content[: len(content) // 8 * 8]
    numbers = np.frombuffer(whole, f"{order}f8").astype(np.float64)
    out: list[Segment] = []
    seen = set()
    while record > 0:
        start = (record - 1) * WORDS
        if (nd, ni) != (2, 6) or record in seen or start + 2 * WORDS > numbers.size:
            raise InputError(f"{path}: its list of arrays is damaged; is the file whole?")
        seen.add(record)
        following, _, count = numbers[start : start + 3]
        for k in range(int(min(max(count, 0), WORDS // SUMMARY))):
            at = start + 3 + k * SUMMARY
            integers = np.frombuffer(whole, f"{order}i4", 6, 8 * (at + 2))
            first, last = int(integers[4]), int(integers[5])
            if not 0 < first <= last <= numbers.size:
                raise InputError(f"{path}: array {len(out) + 1} lies outside the file; is it whole?")
            name = whole[8 * (start + WORDS) + k * NAME : 8 * (start + WORDS) + (k + 1) * NAME].decode("latin-1").strip()
            head = (int(integers[0]), int(integers[1]), int(integers[2]), int(integers[3]))
            out.append(Segment(name, (float(numbers[at]), float(numbers[at + 1])), head, numbers[first - 1 : last]))
        record = int(following)
    return out


def write(path: str | os.PathLike[str], kind: str, segments: list[Segment], title: str) -> None:
    """Write a file; there is room for 25 arrays."""
    assert 0 < len(segments) <= (WORDS - 3) // SUMMARY
    address = 3 * WORDS + 1  # after the file's record, that of summaries and that of names
    summaries, names, data = [np.array([0.0, 0.0, len(segments)])], b"", []
    for one in segments:
        integers = np.array([*one.integers, address, address + one.data.size - 1], dtype="<i4")
        summaries += [np.array(one.doubles), integers.view("<f8")]
        names += one.name.encode("ascii", "replace")[:NAME].ljust(NAME)
        data.append(one.data)
        address += one.data.size
    head = f"DAF/{kind}".ljust(8).encode() + np.array([2, 6], "<i4").tobytes()
    head += title.encode("ascii", "replace")[:60].ljust(60) + np.array([2, 2, address], "<i4").tobytes() + b"LTL-IEEE"
    head = head.ljust(699, b"\x00") + TRANSFER
    numbers = np.concatenate(data).astype("<f8").tobytes()
    with replacing(path) as file:
        file.write(head.ljust(RECORD, b"\x00"))
        file.write(np.concatenate(summaries).astype("<f8").tobytes().ljust(RECORD, b"\x00"))
        file.write(names.ljust(RECORD))
        file.write(numbers.ljust(-(-len(numbers) // RECORD) * RECORD, b"\x00"))
