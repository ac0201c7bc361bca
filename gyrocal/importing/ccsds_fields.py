"""What the entries and lines of CCSDS attitude messages mean: frames, times and quaternions.

An attitude takes frame A to frame B: v_B = M(q) v_A with M the matrix of Wertz, the scalar part QC last. With an inertial
frame A and a spacecraft's frame B the four numbers are the A(q) of a recording as they stand; the other way about they are
its conjugate. The names tell which of the two a message has: a frame of a spacecraft begins with one of `BODY_FRAMES`, and the
other must be one that does not turn, `INERTIAL`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.importing.units import GPS_EPOCH, UNIX_EPOCH, Clock, date_of
from gyrocal.recording import Recording
from gyrocal.recording.trackers import need_one_sensor

Array = NDArray[np.float64]

BODY_FRAMES = ("SC_BODY", "SC BODY", "IMU_FRAME", "GYRO_", "STARTRACKER", "AST_", "BODY", "INSTRUMENT", "SENSOR_")
BODY = "SC_BODY_1"
# Without their signs - and _. Mean and true frames of date turn by less than 1e-4 deg/h, precession and nutation together.
INERTIAL = re.compile(
    "(ICRF|GCRF)[0-9]*|EME2000|J2000|B1950|ECLIPJ2000|GALACTIC|CIRS|TEME(OFDATE|OFEPOCH)?|MCI|(MOD|MOE|TOD|TOE)(EARTH)?"
)
TAI_GPS_S = 19
NORM = 1e-3  # of numbers with four digits, as the standard's own examples have them
NANO = 10**9


def frames(entries: dict[str, str], path: Path) -> tuple[str, str, bool]:
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


def expect(entries: dict[str, str], needed: tuple[str, ...], path: Path, known: tuple[str, ...] = ()) -> None:
    """Refuse metadata without a keyword, or with one that is not known: it may change what the numbers mean."""
    missing = [name for name in needed if name not in entries]
    if missing:
        raise InputError(f"{path}: the metadata have no {', '.join(missing)}")
    foreign = [name for name in entries if name not in known]
    if known and foreign:
        raise InputError(f"{path}: {', '.join(foreign)}: no keyword of this version of the message; is the version right?")


def scale_of(system: str, path: Path) -> str:
    """The time scale of a clock for a TIME_SYSTEM."""
    if system.upper() not in ("UTC", "GPS", "TAI"):
        raise InputError(f"{path}: time system {system} is not read; read are UTC, GPS and TAI")
    return "UTC" if system.upper() == "UTC" else "GPS"


def seconds(text: str, system: str) -> tuple[int, float]:
    """Whole seconds since the epoch of a time scale, and the rest; a `ValueError` if it is no date or day of the year."""
    head, _, fraction = text.rstrip("Z").partition(".")
    form = "%Y-%m-%dT%H:%M:%S" if head.count("-") == 2 else "%Y-%jT%H:%M:%S"
    start = UNIX_EPOCH if system.upper() == "UTC" else GPS_EPOCH
    since = datetime.strptime(head, form).replace(tzinfo=start.tzinfo) - start
    whole = since // timedelta(seconds=1) - (TAI_GPS_S if system.upper() == "TAI" else 0)
    return whole, float(f"0.{fraction}") if fraction else 0.0


def four(words: Sequence[str]) -> Array:
    """A quaternion's numbers; a `ValueError` if they are not four."""
    values = np.array([float(word) for word in words])
    if values.size != 4:
        raise ValueError("four numbers are needed after the time")
    return values


def attitudes(
    times: list[tuple[int, float]], rows: list[Array], scale: str, conjugate: bool, path: Path
) -> tuple[Clock, Array]:
    """A clock and A(q) (m, 4), inertial to body, scalar last."""
    if not rows:
        raise InputError(f"{path}: no attitudes")
    q = np.array(rows)
    norm = np.linalg.norm(q, axis=1)
    bad = np.flatnonzero(~(np.abs(norm - 1) <= NORM))
    if bad.size:
        raise InputError(f"{path}: the quaternion of attitude {bad[0] + 1} has norm {norm[bad[0]]:.9g}, not 1")
    q = q / norm[:, None] * ([-1.0, -1.0, -1.0, 1.0] if conjugate else [1.0, 1.0, 1.0, 1.0])
    whole, part = zip(*times, strict=True)
    return Clock(np.array(whole, dtype=np.int64), np.array(part), scale), q


def dated(recording: Recording, what: str) -> tuple[str, datetime]:
    """Time scale and epoch of a recording whose times have a date."""
    need_one_sensor(recording.attitudes)
    scale = recording.time_scale.upper()
    if scale not in ("UTC", "GPS"):
        raise InputError(f"{what} needs dates in UTC or GPS time; the recording's time scale is {recording.time_scale!r}")
    return scale, date_of(recording.epoch)


def stamp(epoch: datetime, t_s: float) -> str:
    """A time with nanoseconds."""
    nanoseconds = round(t_s * NANO) + epoch.microsecond * 1000
    return f"{epoch.replace(microsecond=0) + timedelta(seconds=nanoseconds // NANO):%Y-%m-%dT%H:%M:%S}.{nanoseconds % NANO:09d}"


def digits(values: Sequence[float] | Array) -> list[str]:
    """Numbers with all their digits."""
    return [f"{float(value):.17g}" for value in values]
