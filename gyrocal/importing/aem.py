"""CCSDS Attitude Ephemeris Messages, versions 1 and 2 (504.0-B-1, 504.0-B-2), in their two forms: KVN, and XML (505.0-B-3).

In KVN a block stands between ``NAME_START`` and ``NAME_STOP`` and holds entries, KEYWORD = value, and lines of numbers. XML has
the same entries as elements, and every number has an element of its own. Both are read into the same blocks. Attitude types
that begin with a quaternion are read; rates are not used. Only version 1 states the direction (ATTITUDE_DIR) and the place of
the scalar part (QUATERNION_TYPE).

An attitude takes frame A to frame B: v_B = M(q) v_A with M the matrix of Wertz, the scalar part QC last. With an inertial
frame A and a spacecraft's frame B the four numbers are the A(q) of a recording as they stand; with the frames exchanged they
are its conjugate. The names show the order: the frame of a spacecraft begins with one of `BODY_FRAMES`, and the other must be
inertial, see `INERTIAL_FRAMES`.

No maintained library reads the common files: ``ccsds-ndm-py`` (beta, one author) refuses AEM 1.0, the version of most of them.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing.units import NANO, WEEK_S, Clock, convert_to_second

if TYPE_CHECKING:
    import pandas as pd


AEM_VERSIONS = ("1.0", "2.0")
QUATERNION_KEYS = ("Q1", "Q2", "Q3", "QC")
BODY_FRAMES = ("SC_BODY", "SC BODY", "IMU_FRAME", "GYRO_", "STARTRACKER", "AST_", "BODY", "INSTRUMENT", "SENSOR_")
# Without their signs - and _. Mean and true frames of date turn by less than 1e-5 deg/h, precession and nutation together.
INERTIAL_FRAMES = re.compile(
    "(ICRF|GCRF)[0-9]*|EME2000|J2000|B1950|ECLIPJ2000|GALACTIC|CIRS|TEME(OFDATE|OFEPOCH)?|MCI|(MOD|MOE|TOD|TOE)(EARTH)?"
)
TAI_GPS_S = 19
AEM_REQUIRED_KEYS = ("REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "ATTITUDE_TYPE")
DIRECTION_KEYS = ("ATTITUDE_DIR", "QUATERNION_TYPE")  # of version 1 alone
AEM_OPTIONAL_KEYS = ("OBJECT_NAME", "OBJECT_ID", "CENTER_NAME", "EULER_ROT_SEQ", "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE")
SPAN_KEYS = ("START_TIME", "USEABLE_START_TIME", "USEABLE_STOP_TIME", "STOP_TIME")
KNOWN_KEYS = {
    "1.0": (*AEM_REQUIRED_KEYS, *AEM_OPTIONAL_KEYS, *SPAN_KEYS, *DIRECTION_KEYS, "RATE_FRAME"),
    "2.0": (*AEM_REQUIRED_KEYS, *AEM_OPTIONAL_KEYS, *SPAN_KEYS, "ANGVEL_FRAME"),
}
ATTITUDE_TYPES = {
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
    lines: list[tuple[str, list[str]]]  # place of each attitude in the file, for messages, and its words: time, then numbers


class SegmentFrames(NamedTuple):
    """Frames and time scale of a segment, which all segments of a message must share."""

    inertial: str
    body: str
    scale: str  # "UTC" or "GPS"
    is_body_to_inertial: bool


def read_aem(path: str | os.PathLike[str]) -> Aem:
    """Read the attitudes of a message.

    An `InputError` if it is no AEM of version 1 or 2, or if a recording cannot represent its frames or times.
    """
    path = Path(path)
    version, segments = _read_segments(path)
    times, rows, frames = list[tuple[int, float]](), list[Array](), set[SegmentFrames]()
    for meta, lines in segments:
        frames.add(_check_metadata(meta, version, path))
        is_scalar_first = meta.get("QUATERNION_TYPE", "LAST").upper() == "FIRST"
        for where, words in lines:
            try:
                q = np.array([float(word) for word in words[1:5]])
                times.append(_parse_time(words[0], meta["TIME_SYSTEM"]))
            except ValueError as fault:
                raise InputError(f"{path}: {where}: {fault}") from None
            if q.size < 4 or not np.isfinite(q).all():
                raise InputError(f"{path}: {where}: 4 numbers are needed after the time")
            rows.append(np.roll(q, -1 if is_scalar_first else 0))
    if len(frames) > 1:
        raise InputError(f"{path}: its segments have different frames or time systems; give one message for each")
    if not rows:
        raise InputError(f"{path}: no attitudes")
    shared = frames.pop()
    whole, part = zip(*times, strict=True)
    q = np.array(rows) * ([-1.0, -1.0, -1.0, 1.0] if shared.is_body_to_inertial else 1.0)
    clock = Clock(np.array(whole, dtype=np.int64), np.array(part), shared.scale)
    return Aem(clock, q, segments[-1].meta.get("OBJECT_NAME", path.stem), (shared.inertial, shared.body))


def tabulate_attitudes(message: Aem) -> tuple[pd.DataFrame, dict[str, str]]:
    """Build a table of the attitudes, and the entries of a mapping that reads it."""
    import pandas as pd

    frame, clock = pd.DataFrame(message.q, columns=["q1", "q2", "q3", "q4"]), message.clock
    entries = {"quat": "q1,q2,q3,q4:scalar-last:body-to-inertial"}
    if clock.scale == "UTC":
        frame["t"] = clock.whole * NANO + np.round(clock.part * NANO).astype(np.int64)
        return frame, entries | {"attitude_time": "t:ns"}
    frame["week"], frame["second"] = clock.whole // WEEK_S, clock.whole % WEEK_S + clock.part
    return frame, entries | {"attitude_time": "week,second:gps"}


def _check_metadata(meta: dict[str, str], version: str, path: Path) -> SegmentFrames:
    """Refuse metadata that a recording cannot represent, and return the frames and the time scale."""
    needed = (*AEM_REQUIRED_KEYS, *DIRECTION_KEYS) if version == "1.0" else AEM_REQUIRED_KEYS
    if missing := [name for name in needed if name not in meta]:
        raise InputError(f"{path}: the metadata have no {', '.join(missing)}")
    if foreign := [name for name in meta if name not in KNOWN_KEYS[version]]:  # it may change what the numbers mean
        raise InputError(f"{path}: {', '.join(foreign)}: no keyword of this version of the message; is the version right?")
    kind, system = meta["ATTITUDE_TYPE"].upper(), meta["TIME_SYSTEM"]
    if kind not in ATTITUDE_TYPES[version]:
        raise InputError(f"{path}: attitude type {kind} is not read; read are {', '.join(ATTITUDE_TYPES[version])}")
    for name, values in zip(DIRECTION_KEYS, (("A2B", "B2A"), ("FIRST", "LAST")), strict=True):
        if name in meta and meta[name].upper() not in values:
            raise InputError(f"{path}: {name} is {meta[name]}, which is neither {' nor '.join(values)}")
    inertial, body, conjugate = _identify_frames(meta["REF_FRAME_A"], meta["REF_FRAME_B"], path)
    if system.upper() not in ("UTC", "GPS", "TAI"):
        raise InputError(f"{path}: time system {system} is not read; read are UTC, GPS and TAI")
    backwards = meta.get("ATTITUDE_DIR", "A2B").upper() == "B2A"
    return SegmentFrames(inertial, body, "UTC" if system.upper() == "UTC" else "GPS", conjugate != backwards)


def _read_segments(path: Path) -> tuple[str, list[Segment]]:
    """Read the version and the segments of a message, in the order of the file."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(f"{path}: cannot be read: {fault}") from None
    version, segments = (_parse_xml if text.lstrip().startswith("<") else _parse_kvn)(text, path)
    if version not in AEM_VERSIONS:
        raise InputError(f"{path}: AEM version {version} is not read; read is {' or '.join(AEM_VERSIONS)}")
    return version, segments


def _parse_kvn(text: str, path: Path) -> tuple[str, list[Segment]]:
    """Read the version and the segments of a message in the form KEYWORD = value."""
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
    """Read the version and the segments of a message in XML."""
    try:
        root = ET.fromstring(text)
    except ET.ParseError as fault:
        raise InputError(f"{path}: not XML: {fault}") from None
    if _get_local_name(root) != "aem":
        raise InputError(f"{path}: not an AEM: its XML begins with <{_get_local_name(root)}>")
    segments, meta = list[Segment](), dict[str, str]()
    for part in (part for segment in root.iter() if _get_local_name(segment) == "segment" for part in segment):
        if _get_local_name(part) == "metadata":
            leaves = [element for element in part if not len(element) and _get_local_name(element) != "COMMENT"]
            meta = {_get_local_name(leaf): " ".join((leaf.text or "").split()) for leaf in leaves}
            if "QUATERNION_TYPE" in meta:  # the order in a line; elements are found by name instead
                meta["QUATERNION_TYPE"] = "LAST"
        else:
            states = [state for state in part if _get_local_name(state) == "attitudeState"]
            segments.append(Segment(meta, [_parse_state(k, state) for k, state in enumerate(states, 1)]))
    return root.get("version", "unknown"), segments


def _get_local_name(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def _parse_state(number: int, state: ET.Element) -> tuple[str, list[str]]:
    """Read one attitude in XML as a place and the words of a line in KVN; elements are found by name, in any order."""
    texts = {_get_local_name(element): (element.text or "").strip() for element in state.iter()}
    return f"attitude {number}", [texts[name] for name in ("EPOCH", *QUATERNION_KEYS) if name in texts]


def _identify_frames(a: str, b: str, path: Path) -> tuple[str, str, bool]:
    """Return inertial frame, body frame, and whether A is the body frame, of the frames A and B."""
    bodies = [frame.upper().startswith(BODY_FRAMES) for frame in (a, b)]
    if bodies.count(True) != 1:
        raise InputError(f"{path}: of the frames {a} and {b} one must be of a spacecraft, such as SC_BODY_1, and one inertial")
    inertial, body = (b, a) if bodies[0] else (a, b)
    if not INERTIAL_FRAMES.fullmatch(re.sub("[-_ ]", "", inertial.upper())):
        raise InputError(
            f"{path}: the frame {inertial} turns, or is not known: give attitudes against ICRF, EME2000 or another inertial "
            "frame; if it is one of these under another name, write that name into the file"
        )
    return inertial, body, bodies[0]


def _parse_time(text: str, system: str) -> tuple[int, float]:
    """Return whole seconds since the epoch of a time scale, and the rest; a `ValueError` if it is no date."""
    head, _, fraction = text.rstrip("Z").partition(".")
    form = "%Y-%m-%dT%H:%M:%S" if head.count("-") == 2 else "%Y-%jT%H:%M:%S"
    whole = convert_to_second(datetime.strptime(head, form).replace(tzinfo=UTC), "UTC" if system.upper() == "UTC" else "GPS")
    whole -= TAI_GPS_S if system.upper() == "TAI" else 0
    return whole, float(f"0.{fraction}") if fraction else 0.0
