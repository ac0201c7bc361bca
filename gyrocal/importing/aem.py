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
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing.units import GPS_EPOCH, UNIX_EPOCH, WEEK_S, Clock

if TYPE_CHECKING:
    import pandas as pd


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


class Segment(NamedTuple):
    """Attitudes of a message with one set of metadata."""

    meta: dict[str, str]
    lines: list[tuple[str, list[str]]]  # where each attitude stands, for messages, and its words: the time, then numbers


def read_aem(path: str | os.PathLike[str]) -> Aem:
    """Read a message.

    An `InputError` if it is no AEM of version 1 or 2, or holds what a recording cannot.
    """
    path = Path(path)
    version, segments = _read_segments(path)
    times, rows, kinds = list[tuple[int, float]](), list[Array](), set[tuple[str, str, str, bool]]()
    for meta, lines in segments:
        kinds.add(_check_metadata(meta, version, path))
        first = meta.get("QUATERNION_TYPE", "LAST").upper() == "FIRST"
        for where, words in lines:
            try:
                q = np.array([float(word) for word in words[1:5]])
                times.append(_parse_time(words[0], meta["TIME_SYSTEM"]))
            except ValueError as fault:
                raise InputError(f"{path}: {where}: {fault}") from None
            if q.size < 4 or not np.isfinite(q).all():
                raise InputError(f"{path}: {where}: 4 numbers are needed after the time")
            rows.append(np.roll(q, -1 if first else 0))
    if len(kinds) > 1:
        raise InputError(f"{path}: its segments have different frames or time systems; give one message for each")
    if not rows:
        raise InputError(f"{path}: no attitudes")
    inertial, body, scale, is_reversed = kinds.pop()
    whole, part = zip(*times, strict=True)
    q = np.array(rows) * ([-1.0, -1.0, -1.0, 1.0] if is_reversed else 1.0)
    clock = Clock(np.array(whole, dtype=np.int64), np.array(part), scale)
    return Aem(clock, q, meta.get("OBJECT_NAME", path.stem), (inertial, body))


def tabulate_attitudes(message: Aem) -> tuple[pd.DataFrame, dict[str, str]]:
    """Tabulate the attitudes, with the entries of a mapping that reads the table."""
    import pandas as pd

    frame, clock = pd.DataFrame(message.q, columns=["q1", "q2", "q3", "q4"]), message.clock
    entries = {"quat": "q1,q2,q3,q4:scalar-last:body-to-inertial"}
    if clock.scale == "UTC":
        frame["t"] = clock.whole * NANO + np.round(clock.part * NANO).astype(np.int64)
        return frame, entries | {"attitude_time": "t:ns"}
    frame["week"], frame["second"] = clock.whole // WEEK_S, clock.whole % WEEK_S + clock.part
    return frame, entries | {"attitude_time": "week,second:gps"}


def _check_metadata(meta: dict[str, str], version: str, path: Path) -> tuple[str, str, str, bool]:
    """Inertial frame, body frame, time scale and whether the message goes from body to inertial."""
    needed = (*AEM_REQUIRED_KEYS, *DIRECTED) if version == "1.0" else AEM_REQUIRED_KEYS
    if missing := [name for name in needed if name not in meta]:
        raise InputError(f"{path}: the metadata have no {', '.join(missing)}")
    if foreign := [name for name in meta if name not in KNOWN[version]]:  # it may change what the numbers mean
        raise InputError(f"{path}: {', '.join(foreign)}: no keyword of this version of the message; is the version right?")
    kind, system = meta["ATTITUDE_TYPE"].upper(), meta["TIME_SYSTEM"]
    if kind not in TYPES[version]:
        raise InputError(f"{path}: attitude type {kind} is not read; read are {', '.join(TYPES[version])}")
    for name, values in zip(DIRECTED, (("A2B", "B2A"), ("FIRST", "LAST")), strict=True):
        if name in meta and meta[name].upper() not in values:
            raise InputError(f"{path}: {name} is {meta[name]}, which is neither {' nor '.join(values)}")
    inertial, body, conjugate = _identify_frames(meta["REF_FRAME_A"], meta["REF_FRAME_B"], path)
    if system.upper() not in ("UTC", "GPS", "TAI"):
        raise InputError(f"{path}: time system {system} is not read; read are UTC, GPS and TAI")
    backwards = meta.get("ATTITUDE_DIR", "A2B").upper() == "B2A"
    return inertial, body, "UTC" if system.upper() == "UTC" else "GPS", conjugate != backwards


def _read_segments(path: Path) -> tuple[str, list[Segment]]:
    """Read version and segments of a message, in the order in which they stand."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(f"{path}: cannot be read: {fault}") from None
    version, segments = (_parse_xml if text.lstrip().startswith("<") else _parse_kvn)(text, path)
    if version not in AEM_VERSIONS:
        raise InputError(f"{path}: AEM version {version} is not read; read is {' or '.join(AEM_VERSIONS)}")
    return version, segments


def _parse_kvn(text: str, path: Path) -> tuple[str, list[Segment]]:
    lines = text.splitlines()
    key, version = _split_entry(next((line for line in lines if line.strip()), ""))
    if key != "CCSDS_AEM_VERS":
        raise InputError(f"{path}: not an AEM: it begins neither with CCSDS_AEM_VERS nor as XML")
    segments, meta = list[Segment](), dict[str, str]()
    open_blocks: list[tuple[str, Segment]] = []
    for number, line in enumerate(lines, 1):
        words = line.strip()
        if words.endswith("_START") and " " not in words:
            kind, block = words.removesuffix("_START"), Segment({}, [])
            open_blocks.append((kind, block))
            if kind == "META":
                meta = block.meta
            elif kind == "DATA":
                segments.append(Segment(meta, block.lines))
        elif words.endswith("_STOP") and " " not in words:
            if not open_blocks or open_blocks.pop()[0] != words.removesuffix("_STOP"):
                raise InputError(f"{path}: line {number}: {words} ends no block")
        elif not words or words.startswith("COMMENT") or not open_blocks:
            continue
        elif "=" in words:
            name, value = _split_entry(words)
            open_blocks[-1][1].meta[name] = value
        else:
            open_blocks[-1][1].lines.append((f"line {number}", words.split()))
    if open_blocks:
        kind = open_blocks[-1][0]
        raise InputError(f"{path}: {kind}_START without {kind}_STOP: is the file whole?")
    return version, segments


def _split_entry(line: str) -> tuple[str, str]:
    name, _, value = line.partition("=")
    return name.strip(), value.strip()


def _parse_xml(text: str, path: Path) -> tuple[str, list[Segment]]:
    try:
        root = ET.fromstring(text)
    except ET.ParseError as fault:
        raise InputError(f"{path}: not XML: {fault}") from None
    if _name(root) != "aem":
        raise InputError(f"{path}: not an AEM: its XML begins with <{_name(root)}>")
    segments, meta = list[Segment](), dict[str, str]()
    for part in (part for segment in root.iter() if _name(segment) == "segment" for part in segment):
        if _name(part) == "metadata":
            leaves = [one for one in part if not len(one) and _name(one) != "COMMENT"]
            meta = {_name(leave): " ".join((leave.text or "").split()) for leave in leaves}
            if "QUATERNION_TYPE" in meta:  # of lines; here the elements have names
                meta["QUATERNION_TYPE"] = "LAST"
        else:
            states = [state for state in part if _name(state) == "attitudeState"]
            segments.append(Segment(meta, [_parse_state(k, state) for k, state in enumerate(states, 1)]))
    return root.get("version", "unknown"), segments


def _name(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def _parse_state(number: int, state: ET.Element) -> tuple[str, list[str]]:
    """One attitude of an AEM in XML as the words of a line in KVN; elements are found by their names, whatever their order."""
    found = {_name(one): (one.text or "").strip() for one in state.iter()}
    return f"attitude {number}", [found[name] for name in ("EPOCH", *QUATERNION_KEYS) if name in found]


def _identify_frames(a: str, b: str, path: Path) -> tuple[str, str, bool]:
    """Inertial frame, body frame, and whether the message goes from body to inertial."""
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


def _parse_time(text: str, system: str) -> tuple[int, float]:
    """Whole seconds since the epoch of a time scale, and the rest; a `ValueError` if it is no date or day of the year."""
    head, _, fraction = text.rstrip("Z").partition(".")
    form = "%Y-%m-%dT%H:%M:%S" if head.count("-") == 2 else "%Y-%jT%H:%M:%S"
    start = UNIX_EPOCH if system.upper() == "UTC" else GPS_EPOCH
    since = datetime.strptime(head, form).replace(tzinfo=start.tzinfo) - start
    whole = since // timedelta(seconds=1) - (TAI_GPS_S if system.upper() == "TAI" else 0)
    return whole, float(f"0.{fraction}") if fraction else 0.0
