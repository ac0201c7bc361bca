"""SPICE's C-kernels (CK) with their spacecraft clock (SCLK): attitudes of types 1, 2 and 3 read, type 3 written.

A record's quaternion has the scalar part first, and its matrix takes components in the reference frame to those in the
instrument's: v_instrument = C v_reference. SPICE makes the matrix of a quaternion that of the rotation of vectors; A(q) here is
that of the rotation of frames. So C = A(q) for A's (q₁, q₂, q₃, q₄) where SPICE's numbers are (q₄, −q₁, −q₂, −q₃).

A segment's numbers lie one kind after another (NAIF, "CK Required Reading"), directories of every hundredth time among them:

    type 1   n quaternions (with rates: 7 numbers) · n times · directory · n
    type 2   n × (quaternion, rate, seconds a tick) · n starts · n stops · directory
    type 3   as type 1 up to the directory · m starts of interpolation intervals · their directory · m · n

Type 2 turns at a constant rate ω in the reference frame: C(t) = C(start) exp(−[ω×](t − start)).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from datetime import UTC, timedelta
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.errors import InputError
from gyrocal.importing import ccsds_fields as fields
from gyrocal.importing import daf
from gyrocal.importing.aem import Aem, rows_of
from gyrocal.importing.sclk import GPS_AT_J2000, LONGEST, read_sclk, write_sclk
from gyrocal.importing.units import GPS_EPOCH, leap_seconds
from gyrocal.recording import Recording

Array = NDArray[np.float64]

INERTIAL = {1: "J2000", 17: "ECLIPJ2000", 13: "GALACTIC"}
BUILT_IN = 21  # SPICE's inertial frames have the numbers 1 to 21
DIRECTORY = 100
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
TICKS = (10**9, 10**6, 10**3)  # a second; the finest that a double still counts is written


@dataclass(frozen=True)
class Pointing:
    """Attitudes of one instrument.

    Attributes
    ----------
    ticks : (m,) encoded spacecraft clock
    q : (m, 4) A(q), inertial to instrument, scalar last
    instrument, frame : NAIF numbers
    """

    ticks: Array
    q: Array
    instrument: int
    frame: int


def read_pointing(path: str | os.PathLike[str], instrument: int | None = None) -> Pointing:
    """The attitudes of one instrument, of all its segments.

    Parameters
    ----------
    path : CK
    instrument : NAIF number; that of the file if there is only one

    Raises
    ------
    InputError
        It is no CK, or its attitudes cannot be read.
    """
    path = Path(path)
    segments = daf.read(path, "CK")
    there = sorted({one.integers[0] for one in segments})
    if instrument is None and len(there) == 1:
        instrument = there[0]
    chosen = [one for one in segments if one.integers[0] == instrument]
    if instrument is None or not chosen:
        which = f"no instrument {instrument}" if instrument is not None else "several instruments"
        raise InputError(f"{path}: {which}; there are {', '.join(map(str, there)) or 'none'}")
    frames = {one.integers[1] for one in chosen}
    if len(frames) > 1 or not 1 <= min(frames) <= BUILT_IN:
        raise InputError(f"{path}: the reference frame is {', '.join(map(str, sorted(frames)))}; one inertial frame is needed")
    read = [_segment(one, path) for one in chosen]
    ticks, q = np.concatenate([t for t, _ in read]), np.concatenate([q for _, q in read])
    norm = np.linalg.norm(q, axis=1)
    bad = np.flatnonzero(~(np.abs(norm - 1) <= fields.NORM))
    if bad.size:
        raise InputError(f"{path}: quaternion {bad[0] + 1} has norm {norm[bad[0]]:.9g}, not 1")
    order = np.argsort(ticks, kind="stable")
    scalar_last = np.roll(q / norm[:, None] * CONJUGATE, -1, axis=1)
    return Pointing(ticks[order], scalar_last[order], instrument, frames.pop())


def _segment(segment: daf.Segment, path: Path) -> tuple[Array, Array]:
    """Ticks (n,) and SPICE quaternions (n, 4) of a segment."""
    kind, rates, data = segment.integers[2], segment.integers[3], segment.data
    if kind == 2:
        return _constant_rates(data, path)
    if kind not in (1, 3):
        raise InputError(f"{path}: segment {segment.name!r} is of type {kind}; read are 1, 2 and 3")
    size, n = 7 if rates else 4, int(data[-1])
    starts = int(data[-2]) if kind == 3 else 0
    expected = n * (size + 1) + _listed(n) + (starts + _listed(starts) + 2 if kind == 3 else 1)
    if n < 1 or expected != data.size:
        raise InputError(f"{path}: segment {segment.name!r} has {data.size} numbers, not the {expected} of {n} attitudes")
    return data[n * size : n * (size + 1)], data[: n * size].reshape(n, size)[:, :4]


def _constant_rates(data: Array, path: Path) -> tuple[Array, Array]:
    """Both ends of each interval of type 2; an end that is the next start is left out."""
    n = (DIRECTORY * data.size + DIRECTORY) // (DIRECTORY * 10 + 1)
    if n < 1 or 10 * n + _listed(n) != data.size:
        raise InputError(f"{path}: a segment of type 2 has {data.size} numbers, which no number of intervals has")
    records, starts, stops = data[: 8 * n].reshape(n, 8), data[8 * n : 9 * n], data[9 * n : 10 * n]
    angle = records[:, 4:7] * (records[:, 7] * (stops - starts))[:, None]
    # SPICE's quaternions multiply as their matrices do, and turn vectors: as scipy's rotations.
    ends = np.roll((_rotation(records[:, :4]) * Rotation.from_rotvec(-angle)).as_quat(), 1, axis=1)
    last = np.append(stops[:-1] < starts[1:], True) & (stops > starts)
    return np.concatenate([starts, stops[last]]), np.concatenate([records[:, :4], ends[last]])


def _rotation(q: Array) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1, axis=1))


def _listed(n: int) -> int:
    """Length of the directory of n times."""
    return max(n - 1, 0) // DIRECTORY


def read_ck(
    path: str | os.PathLike[str], sclk: str | os.PathLike[str], instrument: int | None = None, spacecraft: int | None = None
) -> Aem:
    """Attitudes with times in GPS time.

    Parameters
    ----------
    path, sclk : CK, and the kernel of the spacecraft's clock
    instrument : NAIF number; that of the CK if there is only one
    spacecraft : whose clock it is; instrument / 1000 by default, as for SPICE

    Raises
    ------
    InputError
        One of the two cannot be used.
    """
    pointing = read_pointing(path, instrument)
    number = int(pointing.instrument / 1000) if spacecraft is None else spacecraft
    clock = read_sclk(sclk, number)
    frame = INERTIAL.get(pointing.frame, f"frame {pointing.frame}")
    return Aem(clock.gps(pointing.ticks), pointing.q, f"spacecraft {number}", (frame, str(pointing.instrument)))


def write_ck(
    recording: Recording,
    path: str | os.PathLike[str],
    sclk: str | os.PathLike[str],
    *,
    instrument: int = -999000,
    frame: int = 1,
) -> None:
    """Write the reference attitudes as a segment of type 3, and the clock that its times are of.

    Parameters
    ----------
    recording : its time scale must be UTC or GPS
    path, sclk : CK and SCLK
    instrument : NAIF number; the clock is that of spacecraft instrument / 1000
    frame : the inertial one, 1 for J2000

    Raises
    ------
    InputError
        The recording's times have no date, or a number is not one that SPICE takes.
    """
    spacecraft = int(instrument / 1000)
    if spacecraft >= 0 or not 1 <= frame <= BUILT_IN:
        raise InputError(
            f"CK: instrument {instrument} must be -1000 or less, and frame {frame} an inertial one, 1 to {BUILT_IN}"
        )
    scale, epoch = fields.dated(recording, "a CK")
    t_s = recording.attitudes.t_s
    first = int(np.floor(t_s[0]))
    per_second = next((n for n in TICKS if (t_s[-1] - first) * n < LONGEST), 1)
    ticks = np.round((t_s - first) * per_second)
    if (np.diff(ticks) <= 0).any():
        raise InputError("CK: two attitudes lie within one tick of the clock")
    at = epoch.replace(tzinfo=UTC)
    since = Decimal((at - GPS_EPOCH) // timedelta(microseconds=1)) / 10**6  # of GPS time, or of UTC as if without leap seconds
    gps = since + first + (leap_seconds(at) if scale == "UTC" else 0)
    write_sclk(sclk, spacecraft, gps - GPS_AT_J2000, per_second, recording.title)
    q = np.roll(recording.attitudes.quaternions, 1, axis=1) * CONJUGATE
    starts = np.unique(ticks[_starts(recording)])
    data = [q.ravel(), ticks, _directory(ticks), starts, _directory(starts), np.array([starts.size, ticks.size])]
    head = (instrument, frame, 3, 0)
    segment = daf.Segment("references", (float(ticks[0]), float(ticks[-1])), head, np.concatenate(data))
    daf.write(path, "CK", [segment], recording.title)


def _starts(recording: Recording) -> NDArray[np.intp]:
    """First references of the intervals; of two that share one there is nothing between them to leave out."""
    rows = [rows_of(recording, one) for one in recording.intervals]
    return np.array([rows[0][0], *(b[0] for a, b in pairwise(rows) if b[0] != a[-1])])


def _directory(times: Array) -> Array:
    return times[DIRECTORY - 1 : _listed(times.size) * DIRECTORY : DIRECTORY]
