"""CCSDS Attitude Ephemeris Messages, versions 1 and 2 (504.0-B-1, 504.0-B-2), in their two forms: KVN, and XML (505.0-B-3).

In KVN a block stands between ``NAME_START`` and ``NAME_STOP`` and holds entries, KEYWORD = value, and lines of numbers. XML has
the same entries as elements, and every number has an element of its own. Both are read into the same blocks. Attitude types
that begin with a quaternion are read; rates are not used. Version 1 says the direction (ATTITUDE_DIR) and the place of the
scalar part (QUATERNION_TYPE), which version 2 has not got.

An attitude takes frame A to frame B: v_B = M(q) v_A with M the matrix of Wertz, the scalar part QC last. With an inertial
frame A and a spacecraft's frame B the four numbers are the A(q) of a recording as they stand; the other way about they are
its conjugate. The names tell which of the two a message has: a frame of a spacecraft begins with one of `BODY_FRAMES`, and the
other must be one that does not turn, `INERTIAL`.

This reader is our own because no kept library reads the files that people have: ``ccsds-ndm-py`` (beta, one author) refuses
AEM 1.0, the version of most of them.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing.units import GPS_EPOCH, UNIX_EPOCH, WEEK_S, Clock

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

AEM_VERSIONS = ("1.0", "2.0")
QUATERNION_KEYS = ("Q1", "Q2", "Q3", "QC")
BODY_FRAMES = ("SC_BODY", "SC BODY", "IMU_FRAME", "GYRO_", "STARTRACKER", "AST_", "BODY", "INSTRUMENT", "SENSOR_")
# Without their signs - and _. Mean and true frames of date turn by less than 1e-5 deg/h, precession and nutation together.
INERTIAL = re.compile(
    "(ICRF|GCRF)[0-9]*|EME2000|J2000|B1950|ECLIPJ2000|GALACTIC|CIRS|TEME(OFDATE|OFEPOCH)?|MCI|(MOD|MOE|TOD|TOE)(EARTH)?"
)
TAI_GPS_S = 19
NANO = 10**9
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
    """Attitudes of a message, all segments one after another."""

    clock: Clock  # times
    q: Array  # (m, 4) A(q), inertial to body, scalar last, of the norm on file
    title: str  # the object's name
    frames: tuple[str, str]  # inertial frame and body frame


def read_aem(path: str | os.PathLike[str]) -> Aem:
    """Read a message.

    An `InputError` if it is no AEM of version 1 or 2, or holds what a recording cannot.
    """
    path = Path(path)
    version, blocks = _read_blocks(path)
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
            rows.append(np.roll(parse_numbers(words[1:5], 4, path, where), -1 if first else 0))
            try:
                times.append(parse_time(words[0], meta["TIME_SYSTEM"]))
            except ValueError as fault:
                raise InputError(f"{path}: {where}: {fault}") from None
    if len(kinds) > 1:
        raise InputError(f"{path}: its segments have different frames or time systems; give one message for each")
    if not kinds:
        raise InputError(f"{path}: no attitudes")
    inertial, body, scale, conjugate = kinds.pop()
    clock, q = build_attitudes(times, rows, scale, conjugate, path)
    return Aem(clock, q, meta.get("OBJECT_NAME", path.stem), (inertial, body))


def tabulate_attitudes(message: Aem) -> tuple[pd.DataFrame, dict[str, str]]:
    """The attitudes as a table, and the entries of a mapping that reads it."""
    import pandas as pd

    frame = pd.DataFrame(message.q, columns=["q1", "q2", "q3", "q4"])
    entries = {"quat": "q1,q2,q3,q4:scalar-last:body-to-inertial"}
    clock = message.clock
    if clock.scale == "UTC":
        frame["t"] = clock.whole * NANO + np.round(clock.part * NANO).astype(np.int64)
        return frame, entries | {"attitude_time": "t:ns"}
    frame["week"], frame["second"] = clock.whole // WEEK_S, clock.whole % WEEK_S + clock.part
    return frame, entries | {"attitude_time": "week,second:gps"}


def _check_metadata(meta: dict[str, str], version: str, path: Path) -> tuple[str, str, str, bool]:
    """Inertial frame, body frame, time scale and whether the message goes from body to inertial."""
    check_keywords(meta, (*AEM_REQUIRED_KEYS, *DIRECTED) if version == "1.0" else AEM_REQUIRED_KEYS, path, KNOWN[version])
    kind = meta["ATTITUDE_TYPE"].upper()
    if kind not in TYPES[version]:
        raise InputError(f"{path}: attitude type {kind} is not read; read are {', '.join(TYPES[version])}")
    for name, values in zip(DIRECTED, (("A2B", "B2A"), ("FIRST", "LAST")), strict=True):
        if name in meta and meta[name].upper() not in values:
            raise InputError(f"{path}: {name} is {meta[name]}, which is neither {' nor '.join(values)}")
    inertial, body, conjugate = identify_frames(meta, path)
    backwards = meta.get("ATTITUDE_DIR", "A2B").upper() == "B2A"
    return inertial, body, read_scale(meta["TIME_SYSTEM"], path), conjugate != backwards


@dataclass(frozen=True)
class Block:
    """One block of a message."""

    kind: str  # META or DATA
    entries: dict[str, str] = field(default_factory=dict)  # keywords and values; of several comments the last
    lines: list[tuple[str, list[str]]] = field(default_factory=list)  # words of each line, and where it stands, for messages


def _read_blocks(path: Path) -> tuple[str, list[Block]]:
    """Read version and blocks of an AEM, in the order in which they stand."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(f"{path}: cannot be read: {fault}") from None
    version, blocks = (_parse_xml if text.lstrip().startswith("<") else _parse_kvn)(text, path)
    if version not in AEM_VERSIONS:
        raise InputError(f"{path}: AEM version {version} is not read; read is {' or '.join(AEM_VERSIONS)}")
    return version, blocks


def _parse_kvn(text: str, path: Path) -> tuple[str, list[Block]]:
    lines = text.splitlines()
    first = next((line for line in lines if line.strip()), "")
    key, _, version = (part.strip() for part in first.partition("="))
    if key != "CCSDS_AEM_VERS":
        raise InputError(f"{path}: not an AEM: it begins neither with CCSDS_AEM_VERS nor as XML")
    blocks: list[Block] = []
    open_blocks: list[Block] = []
    for number, line in enumerate(lines, 1):
        words = line.strip()
        if words.endswith("_START") and " " not in words:
            open_blocks.append(Block(words.removesuffix("_START")))
            blocks.append(open_blocks[-1])
        elif words.endswith("_STOP") and " " not in words:
            if not open_blocks or open_blocks.pop().kind != words.removesuffix("_STOP"):
                raise InputError(f"{path}: line {number}: {words} ends no block")
        elif not words or words.startswith("COMMENT") or not open_blocks:
            continue
        elif "=" in words:
            name, _, value = (part.strip() for part in words.partition("="))
            open_blocks[-1].entries[name] = value
        else:
            open_blocks[-1].lines.append((f"line {number}", words.split()))
    if open_blocks:
        raise InputError(f"{path}: {open_blocks[-1].kind}_START without {open_blocks[-1].kind}_STOP: is the file whole?")
    return version, blocks


def _parse_xml(text: str, path: Path) -> tuple[str, list[Block]]:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as fault:
        raise InputError(f"{path}: not XML: {fault}") from None
    if _name(root) != "aem":
        raise InputError(f"{path}: not an AEM: its XML begins with <{_name(root)}>")
    blocks = []
    for segment in root.iter():
        if _name(segment) != "segment":
            continue
        for part in segment:
            if _name(part) == "metadata":
                leaves = [one for one in part if not len(one) and _name(one) != "COMMENT"]
                blocks.append(Block("META", {_name(one): " ".join((one.text or "").split()) for one in leaves}))
                if "QUATERNION_TYPE" in blocks[-1].entries:  # of lines; here the elements have names
                    blocks[-1].entries["QUATERNION_TYPE"] = "LAST"
            else:
                states = [state for state in part if _name(state) == "attitudeState"]
                blocks.append(Block("DATA", {}, [_parse_state(k, state) for k, state in enumerate(states, 1)]))
    return root.get("version", "unknown"), blocks


def _name(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def _parse_state(number: int, state: ET.Element) -> tuple[str, list[str]]:
    """One attitude of an AEM in XML as the words of a line in KVN; elements are found by their names, whatever their order."""
    found = {_name(one): (one.text or "").strip() for one in state.iter()}
    return f"attitude {number}", [found[name] for name in ("EPOCH", *QUATERNION_KEYS) if name in found]


def identify_frames(entries: dict[str, str], path: Path) -> tuple[str, str, bool]:
    """Inertial frame, body frame, and whether the message goes from body to inertial."""
    a, b = entries["REF_FRAME_A"], entries["REF_FRAME_B"]
    bodies = [frame.upper().startswith(BODY_FRAMES) for frame in (a, b)]
    if bodies.count(True) != 1:
        raise InputError(f"{path}: of the frames {a} and {b} one must be of a spacecraft, such as SC_BODY_1, and one inertial")
    inertial, body = (b, a) if bodies[0] else (a, b)
    if not INERTIAL.fullmatch(re.sub("[-_ ]", "", inertial.upper())):
        raise InputError(
            f"{path}: the frame {inertial} turns, or is not known: give attitudes against ICRF, EME2000 or another inertial "
            "frame; if it is one of these under another name, write that name into the file"
        )
    return inertial, body, bodies[0]


def check_keywords(entries: dict[str, str], needed: tuple[str, ...], path: Path, known: tuple[str, ...] = ()) -> None:
    """Refuse metadata without a keyword, or with one that is not known: it may change what the numbers mean."""
    missing = [name for name in needed if name not in entries]
    if missing:
        raise InputError(f"{path}: the metadata have no {', '.join(missing)}")
    foreign = [name for name in entries if name not in known]
    if known and foreign:
        raise InputError(f"{path}: {', '.join(foreign)}: no keyword of this version of the message; is the version right?")


def read_scale(system: str, path: Path) -> str:
    """The time scale of a clock for a TIME_SYSTEM."""
    if system.upper() not in ("UTC", "GPS", "TAI"):
        raise InputError(f"{path}: time system {system} is not read; read are UTC, GPS and TAI")
    return "UTC" if system.upper() == "UTC" else "GPS"


def parse_time(text: str, system: str) -> tuple[int, float]:
    """Whole seconds since the epoch of a time scale, and the rest; a `ValueError` if it is no date or day of the year."""
    head, _, fraction = text.rstrip("Z").partition(".")
    form = "%Y-%m-%dT%H:%M:%S" if head.count("-") == 2 else "%Y-%jT%H:%M:%S"
    start = UNIX_EPOCH if system.upper() == "UTC" else GPS_EPOCH
    since = datetime.strptime(head, form).replace(tzinfo=start.tzinfo) - start
    whole = since // timedelta(seconds=1) - (TAI_GPS_S if system.upper() == "TAI" else 0)
    return whole, float(f"0.{fraction}") if fraction else 0.0


def parse_numbers(words: Sequence[str], count: int, path: Path, where: str) -> Array:
    """The numbers of a line after its time, of which so many are needed."""
    try:
        values = np.array([float(word) for word in words])
    except ValueError as fault:
        raise InputError(f"{path}: {where}: {fault}") from None
    if values.size < count or not np.isfinite(values).all():
        raise InputError(f"{path}: {where}: {count} numbers are needed after the time")
    return values


def build_attitudes(
    times: list[tuple[int, float]], rows: list[Array], scale: str, conjugate: bool, path: Path
) -> tuple[Clock, Array]:
    """A clock and A(q) (m, 4), inertial to body, scalar last."""
    if not rows:
        raise InputError(f"{path}: no attitudes")
    q = np.array(rows)
    q *= [-1.0, -1.0, -1.0, 1.0] if conjugate else [1.0, 1.0, 1.0, 1.0]
    whole, part = zip(*times, strict=True)
    return Clock(np.array(whole, dtype=np.int64), np.array(part), scale), q
