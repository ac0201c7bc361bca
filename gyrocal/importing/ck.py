"""SPICE's C-kernels (CK) with their spacecraft clock (SCLK): attitudes of types 1, 2 and 3.

NAIF's toolkit, through ``spiceypy``, reads both. Its pointing matrix takes components in the reference frame to those in the
instrument's, v_instrument = C v_reference: C = A(q).

A process has one pool of kernels: they are loaded into it and unloaded again. Unloading a clock drops values that were put into
the pool by hand (``pdpool``), as every ``unload`` of a text kernel does.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from gyrocal import attitude
from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing.aem import Aem
from gyrocal.importing.units import Clock

LAST_INERTIAL_FRAME = 21  # SPICE's inertial frames have the numbers 1 to 21
# J2000 is 2000-01-01T12:00:00 TT; GPS time is TT − 51.184 s and counts from 1980-01-06, 7300.5 days before.
GPS_AT_J2000 = Decimal(7300 * 86400 + 43200) - Decimal("51.184")
# TDB − TT by the constants of NAIF's leap second kernels; the leap seconds themselves are not needed.
TDB = ["DELTET/DELTA_T_A = 32.184", "DELTET/K = 1.657D-3", "DELTET/EB = 1.671D-2", "DELTET/M = ( 6.239996D0 1.99096871D-7 )"]


@contextmanager
def _open_toolkit(what: str, *kernels: str | os.PathLike[str]) -> Iterator[Any]:
    """Yield NAIF's toolkit with some kernels loaded, and unload them afterwards."""
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
    """Read the attitudes of an instrument with times in GPS time.

    An `InputError` if one of the two cannot be used.

    Parameters
    ----------
    path, sclk : CK, and the kernel of the spacecraft's clock
    instrument : NAIF number; that of the CK if there is only one
    spacecraft : whose clock it is; instrument / 1000 by default, as for SPICE
    """
    path = Path(path)
    with _open_toolkit(f"{path}, {sclk}", sclk, path) as spice:
        if spice.getfat(str(path)) != ("DAF", "CK"):
            raise InputError(f"{path}: not a binary C-kernel of SPICE")
        instruments = sorted(spice.ckobj(str(path)))
        if instrument is None and len(instruments) == 1:
            instrument = int(instruments[0])
        if instrument is None or instrument not in instruments:
            problem = f"no instrument {instrument}" if instrument is not None else "several instruments"
            raise InputError(f"{path}: {problem}; there are {', '.join(map(str, instruments))}")
        ticks, frame = _read_tags(spice, path, instrument)
        number = int(instrument / 1000) if spacecraft is None else spacecraft
        C = np.array([spice.ckgp(instrument, tick, 0.0, frame)[0] for tick in ticks])
        if not np.isfinite(C).all():
            raise InputError(f"{path}: it is damaged: an attitude of instrument {instrument} is not finite")
        clock = _convert_to_gps(spice, spice.sct2e(number, ticks))
    return Aem(clock, attitude.quaternion_from_matrix(C), f"spacecraft {number}", (frame, str(instrument)))


def _read_tags(spice: Any, path: Path, instrument: int) -> tuple[Array, str]:
    """Read the encoded spacecraft clock (m,) of an instrument's attitudes, and their inertial frame.

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
        count = spice.cknr02(handle, summary) if kind == 2 else float(spice.dafgda(handle, last, last)[0])
        if not 1 <= count <= last - first:
            raise InputError(
                f"{path}: segment {spice.dafgn()!r} is damaged: it states {count:g} attitudes and has no room for them"
            )
        size, times = (8, 2 * int(count)) if kind == 2 else (7 if rates else 4, int(count))
        begin = first + int(count) * size
        tags.append(spice.dafgda(handle, begin, begin + times - 1))
    if len(frames) > 1 or not 1 <= min(frames) <= LAST_INERTIAL_FRAME:
        raise InputError(f"{path}: the reference frame is {', '.join(map(str, sorted(frames)))}; one inertial frame is needed")
    return np.unique(np.concatenate(tags)), spice.frmnam(frames.pop())


def _convert_to_gps(spice: Any, tdb_s: Array) -> Clock:
    """Convert (n,) seconds of TDB past J2000, which as doubles resolve 1e-7 s, to GPS time."""
    tt_s = np.array([spice.unitim(second, "TDB", "TDT") for second in tdb_s])
    floor = np.floor(tt_s)
    part = tt_s - floor + float(GPS_AT_J2000 % 1)
    carry = np.floor(part)
    return Clock((floor + carry).astype(np.int64) + int(GPS_AT_J2000), part - carry, "GPS")
