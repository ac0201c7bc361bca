"""SPICE's C-kernels (CK) with their spacecraft clock (SCLK): attitudes of types 1, 2 and 3 read, type 3 written.

NAIF's toolkit, through ``spiceypy``, reads both. Its pointing matrix takes components in the reference frame to those in the
instrument's, v_instrument = C v_reference: C = A(q). Its quaternions have the scalar part first and stand for rotations of
vectors, where A(q) is that of frames: SPICE's numbers for A's (q₁, q₂, q₃, q₄) are (q₄, −q₁, −q₂, −q₃).

A process has one pool of kernels: they are loaded into it and unloaded again. Unloading a clock drops values that were put into
the pool by hand (``pdpool``), as every ``unload`` of a text kernel does.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.errors import InputError
from gyrocal.files import open_replacement
from gyrocal.importing import ccsds
from gyrocal.importing.aem import Aem
from gyrocal.importing.units import GPS_EPOCH, Clock, count_leap_seconds
from gyrocal.recording import Recording, find_reference_rows

Array = NDArray[np.float64]

LAST_INERTIAL_FRAME = 21  # SPICE's inertial frames have the numbers 1 to 21
CONJUGATE = np.array([1.0, -1.0, -1.0, -1.0])
TICKS = (10**9, 10**6, 10**3)  # a second; the finest that a double still counts is written
MOST_EXACT_TICKS = 2**53  # ticks that a double counts exactly
# J2000 is 2000-01-01T12:00:00 TT; GPS time is TT − 51.184 s and counts from 1980-01-06, 7300.5 days before.
GPS_AT_J2000 = Decimal(7300 * 86400 + 43200) - Decimal("51.184")
# TDB − TT by the constants of NAIF's leap second kernels; the leap seconds themselves are not needed.
TDB = ["DELTET/DELTA_T_A = 32.184", "DELTET/K = 1.657D-3", "DELTET/EB = 1.671D-2", "DELTET/M = ( 6.239996D0 1.99096871D-7 )"]


@contextmanager
def _open_toolkit(what: str, *kernels: str | os.PathLike[str]) -> Iterator[Any]:
    """Give NAIF's toolkit with some kernels loaded, and unload them afterwards.

    Parameters
    ----------
    what : with which a message begins
    kernels : in the order in which they are loaded
    """
    try:
        import spiceypy
    except ImportError:
        raise InputError(f'{what}: spiceypy is needed for SPICE kernels: pip install "gyrocal[spice]"') from None
    loaded: list[str] = []
    try:
        for path in map(str, kernels):
            spiceypy.furnsh(path)
            loaded.append(path)
        if not spiceypy.expool("DELTET/K"):
            spiceypy.lmpool(TDB)
        yield spiceypy
    except (spiceypy.exceptions.SpiceyError, spiceypy.exceptions.NotFoundError) as fault:
        words = " ".join(str(getattr(fault, "long", "") or fault).split())
        raise InputError(f"{what}: SPICE: {words}") from None
    finally:
        for path in reversed(loaded):
            spiceypy.unload(path)


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
    path = Path(path)
    with _open_toolkit(f"{path}, {sclk}", sclk, path) as spice:
        if spice.getfat(str(path)) != ("DAF", "CK"):
            raise InputError(f"{path}: not a binary C-kernel of SPICE")
        there = sorted(spice.ckobj(str(path)))
        if instrument is None and len(there) == 1:
            instrument = int(there[0])
        if instrument is None or instrument not in there:
            which = f"no instrument {instrument}" if instrument is not None else "several instruments"
            raise InputError(f"{path}: {which}; there are {', '.join(map(str, there))}")
        ticks, frame = _read_tags(spice, path, instrument)
        number = int(instrument / 1000) if spacecraft is None else spacecraft
        C = np.array([spice.ckgp(instrument, tick, 0.0, frame)[0] for tick in ticks])
        clock = _convert_to_gps(spice, spice.sct2e(number, ticks))
    return Aem(clock, attitude.quaternion_from_matrix(C), f"spacecraft {number}", (frame, str(instrument)))


def _read_tags(spice: Any, path: Path, instrument: int) -> tuple[Array, str]:
    """Encoded spacecraft clock (m,) of an instrument's attitudes, and the inertial frame that they are in.

    A segment's numbers lie one kind after another. Types 1 and 3: n quaternions (with rates 7 numbers each), n times. Type 2: n
    turns of 8 numbers, n starts, n stops (NAIF, "CK Required Reading").
    """
    handle = spice.kinfo(str(path))[2]
    tags, frames = [], set()
    spice.dafbfs(handle)
    while spice.daffna():
        summary = spice.dafgs(5)
        owner, frame, kind, rates, first, last = (int(value) for value in spice.dafus(summary, 2, 6)[1])
        if owner != instrument:
            continue
        frames.add(frame)
        if kind not in (1, 2, 3):
            raise InputError(f"{path}: segment {spice.dafgn()!r} is of type {kind}; read are 1, 2 and 3")
        count = spice.cknr02(handle, summary) if kind == 2 else int(spice.dafgda(handle, last, last)[0])
        size, times = (8, 2 * count) if kind == 2 else (7 if rates else 4, count)
        begin = first + count * size
        tags.append(spice.dafgda(handle, begin, begin + times - 1))
    if len(frames) > 1 or not 1 <= min(frames) <= LAST_INERTIAL_FRAME:
        raise InputError(f"{path}: the reference frame is {', '.join(map(str, sorted(frames)))}; one inertial frame is needed")
    return np.unique(np.concatenate(tags)), spice.frmnam(frames.pop())


def _convert_to_gps(spice: Any, tdb_s: Array) -> Clock:
    """GPS time at (n,) seconds of TDB past J2000, which are doubles: they resolve 1e-7 s."""
    tt_s = np.array([spice.unitim(one, "TDB", "TDT") for one in tdb_s])
    floor = np.floor(tt_s)
    part = tt_s - floor + float(GPS_AT_J2000 % 1)
    carry = np.floor(part)
    return Clock((floor + carry).astype(np.int64) + int(GPS_AT_J2000), part - carry, "GPS")


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
    if spacecraft >= 0 or not 1 <= frame <= LAST_INERTIAL_FRAME:
        raise InputError(
            f"CK: instrument {instrument} must be -1000 or less, and frame {frame} an inertial one, 1 to {LAST_INERTIAL_FRAME}"
        )
    scale, epoch = ccsds.require_dates(recording, "a CK")
    t_s = recording.attitudes.t_s
    first = int(np.floor(t_s[0]))
    per_second = next((n for n in TICKS if (t_s[-1] - first) * n < MOST_EXACT_TICKS), 1)
    ticks = np.round((t_s - first) * per_second)
    if (np.diff(ticks) <= 0).any():
        raise InputError("CK: two attitudes lie within one tick of the clock")
    since = (
        Decimal((epoch - GPS_EPOCH) // timedelta(microseconds=1)) / 10**6
    )  # of GPS time, or of UTC as if without leap seconds
    gps = since + first + (count_leap_seconds(epoch) if scale == "UTC" else 0)
    q = np.ascontiguousarray(np.roll(recording.attitudes.quaternions, 1, axis=1) * CONJUGATE)
    starts = np.unique(ticks[_find_interval_starts(recording)])
    with tempfile.TemporaryDirectory() as folder, _open_toolkit("CK") as spice:
        made = Path(folder) / "made.bc"  # SPICE writes no file that is there already
        handle = spice.ckopn(str(made), " ".join(recording.title.encode("ascii", "replace").decode().split())[:60], 0)
        numbers = (ticks.size, ticks, q, np.zeros((ticks.size, 3)), starts.size, starts)
        spice.ckw03(handle, ticks[0], ticks[-1], instrument, spice.frmnam(frame), False, "references", *numbers)
        spice.ckcls(handle)
        content = made.read_bytes()
    _write_clock(sclk, spacecraft, gps - GPS_AT_J2000, per_second, recording.title)
    with open_replacement(path) as file:
        file.write(content)


def _find_interval_starts(recording: Recording) -> NDArray[np.intp]:
    """First references of the intervals; of two that share one there is nothing between them to leave out."""
    rows = [find_reference_rows(recording.attitudes.t_s, one) for one in recording.intervals]
    return np.array([rows[0][0], *(b[0] for a, b in pairwise(rows) if b[0] != a[-1])])


def _write_clock(path: str | os.PathLike[str], spacecraft: int, tt_s: Decimal, per_second: int, title: str) -> None:
    """Write the clock that counts seconds of TT, and parts of them, from one moment.

    Parameters
    ----------
    spacecraft : NAIF number, negative
    tt_s : the moment, s of TT past J2000
    per_second : ticks of a second
    """
    n = abs(spacecraft)
    text = f"""KPL/SCLK

{" ".join(title.split())[:60]}: seconds of TT from the moment of the coefficients, in {per_second} parts.

\\begindata

SCLK_KERNEL_ID             = ( @2000-JAN-01/12:00 )
SCLK_DATA_TYPE_{n}        = ( 1 )
SCLK01_TIME_SYSTEM_{n}    = ( 2 )
SCLK01_N_FIELDS_{n}       = ( 2 )
SCLK01_MODULI_{n}         = ( {MOST_EXACT_TICKS // per_second} {per_second} )
SCLK01_OFFSETS_{n}        = ( 0 0 )
SCLK01_OUTPUT_DELIM_{n}   = ( 1 )
SCLK_PARTITION_START_{n}  = ( 0 )
SCLK_PARTITION_END_{n}    = ( {MOST_EXACT_TICKS} )
SCLK01_COEFFICIENTS_{n}   = ( 0 {tt_s:f} 1 )

\\begintext
"""
    with open_replacement(path) as file:
        file.write(text.encode("ascii", "replace"))
