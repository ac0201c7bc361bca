"""Spacecraft clocks: SCLK kernels of type 1, the text files of SPICE that say when a clock showed what.

A clock's ticks are counted from the start of its first partition. Between two rows of coefficients (ticks, seconds, rate) the
time in seconds past J2000 is seconds + rate (ticks' − ticks) / n, n ticks being one count of the clock's first field. The
seconds are TT or TDB by SCLK01_TIME_SYSTEM (NAIF, "SCLK Required Reading").

TDB − TT = K sin E with E = M + e sin M, M linear in time: the constants are those of NAIF's leap second kernels.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.errors import InputError
from gyrocal.files import replacing
from gyrocal.importing.units import Clock

Array = NDArray[np.float64]

TDB, TT = 1, 2  # as SCLK01_TIME_SYSTEM
# J2000 is 2000-01-01T12:00:00 TT; GPS time is TT − 51.184 s and counts from 1980-01-06, 7300.5 days before.
GPS_AT_J2000 = Decimal(7300 * 86400 + 43200) - Decimal("51.184")
K, ECCENTRICITY, M0, M1 = 1.657e-3, 1.671e-2, 6.239996, 1.99096871e-7
LONGEST = 2**53  # ticks that a double counts exactly


@dataclass(frozen=True)
class SpacecraftClock:
    """A clock of type 1.

    Attributes
    ----------
    system : `TDB` or `TT`
    per_count : ticks of one count of the first field
    rows : (ticks, s past J2000, s a count) of each piece, in the order of ticks; exact
    """

    system: int
    per_count: int
    rows: tuple[tuple[Decimal, Decimal, Decimal], ...]

    def gps(self, ticks: Array) -> Clock:
        """GPS time at (n,) ticks.

        Raises
        ------
        InputError
            Ticks are before the clock's first coefficients.
        """
        starts = np.array([float(row[0]) for row in self.rows])
        at = np.searchsorted(starts, ticks, side="right") - 1
        if (at < 0).any():
            raise InputError(f"SCLK: {int((at < 0).sum())} times lie before the clock's first coefficients")
        whole, part = np.empty(ticks.size, dtype=np.int64), np.empty(ticks.size)
        for k, (tick, since, rate) in enumerate(self.rows):
            rows = np.flatnonzero(at == k)
            base = since + GPS_AT_J2000
            floor = int(base.to_integral_value("ROUND_FLOOR"))
            elapsed = (ticks[rows] - float(tick)) / self.per_count * float(rate)
            seconds = float(base - floor) + elapsed
            if self.system == TDB:
                seconds = seconds - tdb_minus_tt(float(since) + elapsed)
            down = np.floor(seconds)
            whole[rows], part[rows] = floor + down.astype(np.int64), seconds - down
        return Clock(whole, part, "GPS")


def tdb_minus_tt(since: Array | float) -> Array:
    """TDB − TT, s, at seconds past J2000; in which of the two the time is does not matter."""
    M = M0 + M1 * np.asarray(since)
    return np.asarray(K * np.sin(M + ECCENTRICITY * np.sin(M)))


def read_sclk(path: str | os.PathLike[str], spacecraft: int) -> SpacecraftClock:
    """The clock of a spacecraft, given by its NAIF number, e.g. −82.

    Raises
    ------
    InputError
        The kernel has no such clock, or one of another type.
    """
    path = Path(path)
    found = _assignments(path)
    number = abs(spacecraft)
    if f"SCLK_DATA_TYPE_{number}" not in found:
        there = [name.rpartition("_")[2] for name in found if name.startswith("SCLK_DATA_TYPE_")]
        raise InputError(f"{path}: no clock of spacecraft {spacecraft}; there are those of {', '.join(there) or 'none'}")

    def numbers(name: str) -> list[Decimal]:
        try:
            return [Decimal(word.upper().replace("D", "E")) for word in found[f"{name}_{number}"]]
        except KeyError:
            raise InputError(f"{path}: no {name}_{number}") from None
        except InvalidOperation:
            raise InputError(f"{path}: {name}_{number} does not hold numbers only") from None

    if numbers("SCLK_DATA_TYPE") != [1]:
        raise InputError(f"{path}: the clock is not of type 1")
    moduli, values = numbers("SCLK01_MODULI"), numbers("SCLK01_COEFFICIENTS")
    system = int(numbers("SCLK01_TIME_SYSTEM")[0]) if f"SCLK01_TIME_SYSTEM_{number}" in found else TDB
    if system not in (TDB, TT) or not values or len(values) % 3 or not all(one == int(one) and one > 0 for one in moduli):
        raise InputError(f"{path}: time system, moduli or coefficients of the clock cannot be")
    per_count = math.prod(int(one) for one in moduli[1:])
    rows = tuple(zip(values[0::3], values[1::3], values[2::3], strict=True))
    if any(b[0] <= a[0] for a, b in pairwise(rows)):
        raise InputError(f"{path}: the clock's coefficients are not in the order of its ticks")
    return SpacecraftClock(system, per_count, rows)


def _assignments(path: Path) -> dict[str, list[str]]:
    """Names of a text kernel and the words that each holds."""
    try:
        text = path.read_text(encoding="latin-1")
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from None
    data, inside = [], False
    for line in text.splitlines():
        if line.strip() in ("\\begindata", "\\begintext"):
            inside = line.strip() == "\\begindata"
        elif inside:
            data.append(line)
    out: dict[str, list[str]] = {}
    for name, sign, several, one in re.findall(r"([^\s=+]+)\s*(\+?=)\s*(?:\(([^)]*)\)|('[^']*'|\S+))", "\n".join(data)):
        words = re.findall(r"'[^']*'|[^\s,]+", several or one)
        out[name] = [*(out.get(name, []) if sign == "+=" else []), *words]
    return out


def write_sclk(path: str | os.PathLike[str], spacecraft: int, tt_s: Decimal, per_second: int, title: str) -> None:
    """Write the clock that counts seconds of TT, and parts of them, from one moment.

    Parameters
    ----------
    path : file
    spacecraft : NAIF number, negative
    tt_s : the moment, s of TT past J2000
    per_second : ticks of a second
    title : of the clock
    """
    n = abs(spacecraft)
    text = f"""KPL/SCLK

{" ".join(title.split())[:60]}: seconds of TT from the moment of the coefficients, in {per_second} parts.

\\begindata

SCLK_KERNEL_ID             = ( @2000-JAN-01/12:00 )
SCLK_DATA_TYPE_{n}        = ( 1 )
SCLK01_TIME_SYSTEM_{n}    = ( {TT} )
SCLK01_N_FIELDS_{n}       = ( 2 )
SCLK01_MODULI_{n}         = ( {LONGEST // per_second} {per_second} )
SCLK01_OFFSETS_{n}        = ( 0 0 )
SCLK01_OUTPUT_DELIM_{n}   = ( 1 )
SCLK_PARTITION_START_{n}  = ( 0 )
SCLK_PARTITION_END_{n}    = ( {LONGEST} )
SCLK01_COEFFICIENTS_{n}   = ( 0 {tt_s:f} 1 )

\\begintext
"""
    with replacing(path) as file:
        file.write(text.encode("ascii", "replace"))
