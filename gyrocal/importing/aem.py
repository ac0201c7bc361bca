"""CCSDS Attitude Ephemeris Messages, version 2 (504.0-B-2) in KVN, read and written.

An AEM takes frame A to frame B: v_B = M(q) v_A with M the matrix of Wertz, the scalar part QC last. With an inertial frame A
and a spacecraft's frame B the four numbers are the A(q) of a recording as they stand; the other way about they are its
conjugate. Which of the two a segment has is told by the names: a frame of a spacecraft begins with one of `BODY_FRAMES`.

Attitude types of the standard that begin with a quaternion are read (QUATERNION, QUATERNION/DERIVATIVE, QUATERNION/ANGVEL); the
rates after it are not used. Version 1, whose quaternions may have the scalar part first, is refused.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.files import replacing
from gyrocal.importing.units import GPS_EPOCH, UNIX_EPOCH, WEEK_S, Clock
from gyrocal.recording import Recording

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

BODY_FRAMES = ("SC_BODY", "SC BODY", "IMU_FRAME", "GYRO_FRAME", "STARTRACKER", "AST_", "BODY")
TYPES = ("QUATERNION", "QUATERNION/DERIVATIVE", "QUATERNION/ANGVEL")
NEEDED = ("REF_FRAME_A", "REF_FRAME_B", "TIME_SYSTEM", "ATTITUDE_TYPE")
TAI_GPS_S = 19
NORM = 1e-6
NANO = 10**9


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
        It is no AEM of version 2 in KVN, or holds what a recording cannot.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as fault:
        raise InputError(f"{path}: cannot be read: {fault}") from None
    first = next((line for line in lines if line.strip()), "")
    key, _, version = (part.strip() for part in first.partition("="))
    if key != "CCSDS_AEM_VERS":
        raise InputError(f"{path}: not an AEM in KVN: it does not begin with CCSDS_AEM_VERS")
    if version != "2.0":
        raise InputError(f"{path}: AEM version {version}; only 2.0 is read, whose quaternions have one order")
    times: list[tuple[int, float]] = []
    rows: list[Array] = []
    meta: dict[str, str] = {}
    kinds: set[tuple[str, str, str, bool]] = set()
    where = ""
    for number, line in enumerate(lines, 1):
        text = line.strip()
        if not text or text.startswith("COMMENT"):
            continue
        if text in ("META_START", "META_STOP", "DATA_START", "DATA_STOP"):
            where = {"META_START": "meta", "DATA_START": "data"}.get(text, "")
            if text == "META_START":
                meta = {}
            if text == "DATA_START":
                kinds.add(_checked(meta, path))
        elif where == "meta":
            name, _, value = (part.strip() for part in text.partition("="))
            meta[name] = value
        elif where == "data":
            words = text.split()
            try:
                times.append(_seconds(words[0], meta["TIME_SYSTEM"]))
                rows.append(np.array([float(word) for word in words[1:5]]))
                if rows[-1].size != 4:
                    raise ValueError("four numbers are needed after the time")
            except (ValueError, IndexError) as fault:
                raise InputError(f"{path}: line {number}: {fault}") from None
    if not rows:
        raise InputError(f"{path}: no attitudes")
    if len({(a, b, conjugate) for a, b, _, conjugate in kinds}) > 1 or len({scale for _, _, scale, _ in kinds}) > 1:
        raise InputError(f"{path}: its segments have different frames or time systems; give one message for each")
    inertial, body, scale, conjugate = kinds.pop()
    q = np.array(rows)
    norm = np.linalg.norm(q, axis=1)
    if (np.abs(norm - 1) > NORM).any():
        row = int(np.argmax(np.abs(norm - 1)))
        raise InputError(f"{path}: the quaternion of attitude {row + 1} has norm {norm[row]:.9g}, not 1")
    q = q / norm[:, None] * ([-1.0, -1.0, -1.0, 1.0] if conjugate else [1.0, 1.0, 1.0, 1.0])
    whole, part = zip(*times, strict=True)
    clock = Clock(np.array(whole, dtype=np.int64), np.array(part), scale)
    return Aem(clock, q, meta.get("OBJECT_NAME", path.stem), (inertial, body))


def table(message: Aem) -> tuple[pd.DataFrame, dict[str, str]]:
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


def _checked(meta: dict[str, str], path: Path) -> tuple[str, str, str, bool]:
    """Inertial frame, body frame, time scale and whether the message goes from body to inertial."""
    missing = [name for name in NEEDED if name not in meta]
    if missing:
        raise InputError(f"{path}: the metadata have no {', '.join(missing)}")
    kind = meta["ATTITUDE_TYPE"].upper()
    if kind not in TYPES:
        raise InputError(f"{path}: attitude type {kind} is not read; read are {', '.join(TYPES)}")
    a, b = meta["REF_FRAME_A"], meta["REF_FRAME_B"]
    bodies = [frame.upper().startswith(BODY_FRAMES) for frame in (a, b)]
    if bodies.count(True) != 1:
        raise InputError(f"{path}: of the frames {a} and {b} one must be of a spacecraft, such as SC_BODY_1, and one inertial")
    system = meta["TIME_SYSTEM"].upper()
    if system not in ("UTC", "GPS", "TAI"):
        raise InputError(f"{path}: time system {system} is not read; read are UTC, GPS and TAI")
    scale = "UTC" if system == "UTC" else "GPS"
    return (b, a, scale, True) if bodies[0] else (a, b, scale, False)


def _seconds(text: str, system: str) -> tuple[int, float]:
    """Whole seconds since the epoch of a time scale, and the rest; a date or a day of the year."""
    head, _, fraction = text.rstrip("Z").partition(".")
    form = "%Y-%m-%dT%H:%M:%S" if head.count("-") == 2 else "%Y-%jT%H:%M:%S"
    start = UNIX_EPOCH if system.upper() == "UTC" else GPS_EPOCH
    since = datetime.strptime(head, form).replace(tzinfo=start.tzinfo) - start
    whole = since // timedelta(seconds=1) - (TAI_GPS_S if system.upper() == "TAI" else 0)
    return whole, float(f"0.{fraction}") if fraction else 0.0


def write_aem(
    recording: Recording,
    path: str | os.PathLike[str],
    *,
    object_name: str = "UNKNOWN",
    object_id: str = "UNKNOWN",
    frame: str = "ICRF",
    originator: str = "GYROCAL",
    created: datetime | None = None,
) -> None:
    """Write the reference attitudes, a segment for each interval.

    Parameters
    ----------
    recording : its time scale must be UTC or GPS
    path : file
    object_name, object_id : of the spacecraft
    frame : the inertial one, REF_FRAME_A
    originator : who made it
    created : when; now by default

    Raises
    ------
    InputError
        The recording's times have no date.
    """
    scale = recording.time_scale.upper()
    if scale not in ("UTC", "GPS"):
        raise InputError(f"an AEM needs dates in UTC or GPS time; the recording's time scale is {recording.time_scale!r}")
    epoch = datetime.fromisoformat(recording.epoch).replace(tzinfo=None)
    attitudes = recording.attitudes
    title = " ".join(recording.title.split())
    lines = ["CCSDS_AEM_VERS = 2.0", f"COMMENT written by gyrocal {metadata.version('gyrocal')}: {title}"]
    lines += [f"CREATION_DATE = {created or datetime.now(UTC):%Y-%m-%dT%H:%M:%S}", f"ORIGINATOR = {originator}", ""]
    for interval in recording.intervals:
        rows = np.flatnonzero((attitudes.t_s >= interval.start_s - 1e-6) & (attitudes.t_s <= interval.stop_s + 1e-6))
        stamps = [_stamp(epoch, float(t)) for t in attitudes.t_s[rows]]
        lines += ["META_START", f"OBJECT_NAME = {object_name}", f"OBJECT_ID = {object_id}"]
        lines += [f"REF_FRAME_A = {frame}", "REF_FRAME_B = SC_BODY_1", f"TIME_SYSTEM = {scale}"]
        lines += [f"START_TIME = {stamps[0]}", f"STOP_TIME = {stamps[-1]}", "ATTITUDE_TYPE = QUATERNION", "META_STOP"]
        lines += ["DATA_START"]
        for stamp, q in zip(stamps, attitudes.quaternions[rows], strict=True):
            lines.append(" ".join([stamp, *(f"{value:.17g}" for value in q)]))
        lines += ["DATA_STOP", ""]
    with replacing(path) as file:
        file.write("\n".join(lines).encode())


def _stamp(epoch: datetime, t_s: float) -> str:
    """A time with nanoseconds."""
    nanoseconds = round(t_s * NANO) + epoch.microsecond * 1000
    return f"{epoch.replace(microsecond=0) + timedelta(seconds=nanoseconds // NANO):%Y-%m-%dT%H:%M:%S}.{nanoseconds % NANO:09d}"
