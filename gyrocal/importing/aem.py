"""CCSDS Attitude Ephemeris Messages, versions 1 and 2 (504.0-B-1, 504.0-B-2), in KVN and XML.

Attitude types of the standard that begin with a quaternion are read; the rates after it are not used. Version 1 says the
direction (ATTITUDE_DIR) and the place of the scalar part (QUATERNION_TYPE), which version 2 has not got. What the four numbers
mean stands in `gyrocal.importing.ccsds`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing import ccsds
from gyrocal.importing.units import WEEK_S, Clock

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

AEM_REQUIRED_KEYS = ("REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "ATTITUDE_TYPE")
DIRECTED = ("ATTITUDE_DIR", "QUATERNION_TYPE")  # of version 1 alone
AEM_OPTIONAL_KEYS = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "EULER_ROT_SEQ", "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE")
SPAN = ("START_TIME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "STOP_TIME")
KNOWN = {
    "1.0": (*AEM_REQUIRED_KEYS, *AEM_OPTIONAL_KEYS, *SPAN, *DIRECTED, "RATE_FRAME"),
    "2.0": (*AEM_REQUIRED_KEYS, *AEM_OPTIONAL_KEYS, *SPAN, "ANGVEL_FRAME"),
}
TYPES = {
    "1.0": ("QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/RATE"),
    "2.0": ("QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/ANGVEL"),
}


@dataclass(frozen=True)
class Aem:
    """Attitudes of a message, all segments one after another.

    Attributes
    ----------
    clock : times
    q : (m, 4) A(q), inertial to body, scalar last
    title : the object's name
    frames : inertial frame and body frame
    """

    clock: Clock
    q: Array
    title: str
    frames: tuple[str, str]


def read_aem(path: str | os.PathLike[str]) -> Aem:
    """Read a message.

    Raises
    ------
    InputError
        It is no AEM of version 1 or 2, or holds what a recording cannot.
    """
    path = Path(path)
    version, blocks = ccsds.read(path)
    times: list[tuple[int, float]] = []
    rows: list[Array] = []
    meta: dict[str, str] = {}
    kinds: set[tuple[str, str, str, bool]] = set()
    for block in blocks:
        if block.kind == "META":
            meta = block.entries
        if block.kind != "DATA":
            continue
        kinds.add(_check_metadata(meta, version, path))
        first = meta.get("QUATERNION_TYPE", "LAST").upper() == "FIRST"
        for where, words in block.lines:
            rows.append(np.roll(ccsds.parse_numbers(words[1:5], 4, path, where), -1 if first else 0))
            try:
                times.append(ccsds.parse_time(words[0], meta["TIME_SYSTEM"]))
            except ValueError as fault:
                raise InputError(f"{path}: {where}: {fault}") from None
    if len(kinds) > 1:
        raise InputError(f"{path}: its segments have different frames or time systems; give one message for each")
    if not kinds:
        raise InputError(f"{path}: no attitudes")
    inertial, body, scale, conjugate = kinds.pop()
    clock, q = ccsds.build_attitudes(times, rows, scale, conjugate, path)
    return Aem(clock, q, meta.get("OBJECT_NAME", path.stem), (inertial, body))


def tabulate_attitudes(message: Aem) -> tuple[pd.DataFrame, dict[str, str]]:
    """The attitudes as a table, and the entries of a mapping that reads it."""
    import pandas as pd

    frame = pd.DataFrame(message.q, columns=["q1", "q2", "q3", "q4"])
    entries = {"quat": "q1,q2,q3,q4:scalar-last:body-to-inertial"}
    clock = message.clock
    if clock.scale == "UTC":
        frame["t"] = clock.whole * ccsds.NANO + np.round(clock.part * ccsds.NANO).astype(np.int64)
        return frame, entries | {"attitude_time": "t:ns"}
    frame["week"], frame["second"] = clock.whole // WEEK_S, clock.whole % WEEK_S + clock.part
    return frame, entries | {"attitude_time": "week,second:gps"}


def _check_metadata(meta: dict[str, str], version: str, path: Path) -> tuple[str, str, str, bool]:
    """Inertial frame, body frame, time scale and whether the message goes from body to inertial."""
    ccsds.check_keywords(meta, (*AEM_REQUIRED_KEYS, *DIRECTED) if version == "1.0" else AEM_REQUIRED_KEYS, path, KNOWN[version])
    kind = meta["ATTITUDE_TYPE"].upper()
    if kind not in TYPES[version]:
        raise InputError(f"{path}: attitude type {kind} is not read; read are {', '.join(TYPES[version])}")
    for name, values in zip(DIRECTED, (("A2B", "B2A"), ("FIRST", "LAST")), strict=True):
        if name in meta and meta[name].upper() not in values:
            raise InputError(f"{path}: {name} is {meta[name]}, which is neither {' nor '.join(values)}")
    inertial, body, conjugate = ccsds.identify_frames(meta, path)
    backwards = meta.get("ATTITUDE_DIR", "A2B").upper() == "B2A"
    return inertial, body, ccsds.read_scale(meta["TIME_SYSTEM"], path), conjugate != backwards
