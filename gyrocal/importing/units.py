"""Units and time tags of other people's files, as rad/s and seconds from an epoch.

A gyro's column with a unit of angle is an accumulated angle, with a unit of angle per time a rate. Counts are either, by the
unit of their LSB.

GPS time runs without leap seconds from 1980-01-06; UTC, and with it unix time, is behind by those inserted since then.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.angle_units import ANGLE_UNITS, RATE_UNITS
from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.mask_runs import find_mask_runs

if TYPE_CHECKING:
    import pandas as pd


PER_SAMPLE = "/sample"  # end of the unit of increments of angle over one sample
INCREMENT_UNITS = {unit + PER_SAMPLE: size for unit, size in ANGLE_UNITS.items()}
COUNTS_UNIT = "counts"
TIME_UNITS = {"s": 0, "ms": 3, "us": 6, "ns": 9, "unix": 0, "gps": 0}  # decimal places of a second
SCALED_UNIT = re.compile(r"([1-9][0-9]{0,8})(s|ms|us|ns)")  # such as the 100us of a counter of 10 kHz
SCALES = {"unix": "UTC", "gps": "GPS"}  # of clocks that count from a known start
TIME_WORDS = ("s", "ms", "us", "ns", "unix", "iso", "gps", "week")
NANO = 10**9

UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
SECONDS_A_DAY = 86400
TIME_OF_DAY = r"\s*\d{1,2}:\d{2}:\d{2}([.,]\d*)?\s*"
REGISTERS = (2**16, 2**24, 2**32)  # counts at which a register of time tags wraps
WRAP_SHARE = 0.99  # of the range: a smaller step back is no wrap, but may be a gap within a day or a week
LEAST_CARRY_STEPS = 5  # usual steps: tags with a smaller error are late or exchanged
WEEK_S = 604800
UNIX_RANGE_S = (631152000, 4102444800)  # 1990 to 2100: numbers in between are read as unix time
# Months from whose first day UTC is one more second behind GPS time; announced by the IERS in its Bulletin C.
LEAP_MONTHS = (
    "1981-07", "1982-07", "1983-07", "1985-07", "1988-01", "1990-01", "1991-01", "1992-07", "1993-07",
    "1994-07", "1996-01", "1997-07", "1999-01", "2006-01", "2009-01", "2012-07", "2015-07", "2017-01",
)  # fmt: skip


@dataclass(frozen=True)
class Clock:
    """Time tags of a table."""

    whole: NDArray[np.int64]  # (n,) whole seconds, exact
    part: Array  # (n,) fraction of a second, s
    scale: str  # "UTC" for unix time and ISO 8601, "GPS", or "" for seconds from an unknown start
    note: str = ""  # how tags of a counter were continued, a sentence; empty if they were not
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (n,) their rows in the table

    def select_rows(self, chosen: NDArray[np.intp]) -> Clock:
        """Select the tags of some rows."""
        return replace(self, whole=self.whole[chosen], part=self.part[chosen], rows=self.rows[chosen])

    def subtract(self, second: int) -> Array:
        """Compute the tags (n,) in s since a whole second."""
        return np.asarray((self.whole - second) + self.part)


def count_leap_seconds(utc: datetime) -> int:
    """Count GPS time minus UTC, s, at a time in UTC."""
    return sum(utc >= datetime.fromisoformat(f"{month}-01T00:00:00+00:00") for month in LEAP_MONTHS)


def convert_to_date(second: int, scale: str) -> datetime:
    """Convert a whole second of a clock to a date, whose tzinfo is UTC for every scale."""
    return {"UTC": UNIX_EPOCH, "GPS": GPS_EPOCH}[scale] + timedelta(seconds=second)


def parse_date(text: str) -> datetime:
    """Parse an ISO 8601 date to one with tzinfo UTC; without an offset from UTC it is of the clock's own scale."""
    date = datetime.fromisoformat(text)
    return date.astimezone(UTC) if date.tzinfo else date.replace(tzinfo=UTC)


def convert_to_second(date: datetime, scale: str) -> int:
    """Convert a date to the whole second of a clock in which it is."""
    return (date - {"UTC": UNIX_EPOCH, "GPS": GPS_EPOCH}[scale]) // timedelta(seconds=1)


def convert_to_utc(clock: Clock) -> Clock:
    """Convert GPS tags to UTC; UTC tags are unchanged."""
    if clock.scale == "UTC":
        return clock
    shift = round((GPS_EPOCH - UNIX_EPOCH).total_seconds())
    behind = count_leap_seconds(convert_to_date(int(clock.whole[0]), "GPS"))
    return replace(clock, whole=clock.whole + shift - behind, scale="UTC")


def build_clock(columns: pd.DataFrame, unit: str) -> Clock:
    """Build the time tags of one column, or of several: numbers are added, a date and a time of day are joined.

    unit: one, or one for each column as in "s+ns"; "iso" of dates; "gps" of two columns is "week+gps"
    """
    name = ", ".join(map(str, columns.columns))
    if unit == "iso":
        return _parse_dates(columns, name)
    values = [_read_numeric(columns.iloc[:, k], name) for k in range(columns.shape[1])]
    units = unit.split("+") if unit != "gps" or len(values) == 1 else ["week", "gps"]
    for word in units:
        if word not in TIME_WORDS and SCALED_UNIT.fullmatch(word) is None:
            raise InputError(f"time: unit {word} of {name} is not known; known are {', '.join(TIME_WORDS)}, 100us")
    if len(units) != len(values) or "iso" in units:
        raise InputError(f"time: {len(values)} column(s) {name}, but unit {unit}; give one for each, as in secs,nsecs:s+ns")
    scale = next((SCALES[word] for word in units if word in SCALES), "")
    if len(values) > 1 or units == ["week"]:
        nanoseconds = [_count_nanoseconds(column, word, name) for column, word in zip(values, units, strict=True)]
        values, units = [np.sum(nanoseconds, axis=0)], ["ns"]
    tags, note = continue_tags(values[0], units[0])
    factor = SCALED_UNIT.fullmatch(units[0])
    if factor is not None:
        tags = np.multiply(tags, int(factor[1]))
    clock = _split_seconds(tags, TIME_UNITS[factor[2] if factor else units[0]], scale)
    counts_days = factor is not None and factor[2] == "s"  # from 1900 in spreadsheets, which is unix time of 2090
    is_unix = not scale and not counts_days and UNIX_RANGE_S[0] <= clock.whole[0] <= UNIX_RANGE_S[1]
    return replace(clock, scale="UTC" if is_unix else scale, note=note)


def _count_nanoseconds(values: NDArray[np.generic], unit: str, name: str) -> NDArray[np.int64]:
    """Convert tags of a unit to whole nanoseconds (n,); integers stay exact."""
    factor = SCALED_UNIT.fullmatch(unit)
    size = WEEK_S * NANO if unit == "week" else NANO // 10 ** TIME_UNITS[factor[2] if factor else unit]
    size *= int(factor[1]) if factor else 1
    if float(np.abs(values.astype(float)).max()) * size >= 2.0**62:
        raise InputError(f"time: column {name} has values beyond 146 years")
    whole = np.floor(values).astype(np.int64)
    return np.asarray(whole * size + np.round((values - whole) * size).astype(np.int64))


def continue_tags(values: NDArray[np.generic], unit: str) -> tuple[NDArray[np.generic], str]:
    """Continue tags (n,) of a counter that wraps, or that counts up one part late or early, and describe the correction.

    A register, or the seconds of a day or of a week, go back by nearly their range and stay there. If one part of a clock, such
    as its seconds, is counted up late, tags are too early by one unit of that part, for less than this unit. The order of the
    rows and their usual step show both.
    """
    is_whole = np.issubdtype(values.dtype, np.integer)
    tags = values.astype(np.int64 if is_whole else np.float64)
    steps = np.diff(tags)
    back = steps < 0
    usual = float(np.median(steps)) if back.any() else 0.0
    if not usual > 0:
        return values, ""
    factor = SCALED_UNIT.fullmatch(unit)
    second = 10 ** TIME_UNITS[factor[2]] / int(factor[1]) if factor else 10 ** TIME_UNITS[unit]
    cycles = [round(cycle_s * second) for cycle_s in (SECONDS_A_DAY, WEEK_S)]
    for part in (*(REGISTERS if is_whole else ()), *cycles):
        turns = -np.round(steps / part).astype(np.int64)
        if turns.any() and tags.min() >= 0 and tags.max() < part and (np.abs(steps[turns != 0]) > WRAP_SHARE * part).all():
            place = f"2^{part.bit_length() - 1}" if part in REGISTERS else f"{round(part / second)} s"
            return tags + part * np.append(0, np.cumsum(turns)), f"wrap {turns.sum()} time(s) at {place} and go on"
    jump = usual - float(np.median(steps[back]))
    part = min((*cycles, 10 ** round(np.log10(jump))), key=lambda size: abs(size - jump))
    # 1 at a step back by one unit of the part, -1 at a step up by one.
    carry = np.select([np.abs(steps - usual + part) <= 2 * usual, np.abs(steps - usual - part) <= 2 * usual], [1, -1])
    if part < LEAST_CARRY_STEPS * usual or ((carry == 1) != back).any():
        return values, ""
    corrections = []
    for direction in (1, -1):  # late or early; the first rows may be off
        shift = np.append(0, np.cumsum(carry)) + direction * (carry[carry != 0][0] == -direction)
        runs = find_mask_runs(shift == direction)
        if np.isin(shift, (0, direction)).all() and all(tags[stop - 1] - tags[start] < part for start, stop in runs):
            error = f"too {'early' if direction > 0 else 'late'} by {part:g} {unit}"
            text = f"are {error} in {len(runs)} stretch(es) and are moved by that"
            corrections.append((np.count_nonzero(shift), tags + part * shift, text))
    return min(corrections, key=lambda correction: correction[0])[1:] if corrections else (values, "")


def _parse_dates(columns: pd.DataFrame, name: str) -> Clock:
    """Parse time tags of ISO 8601: a date with its time, times of day, or both in two columns."""
    import pandas as pd

    texts = [columns.iloc[:, k].astype(str).str.strip() for k in range(columns.shape[1])]
    of_day = [bool(text.str.fullmatch(TIME_OF_DAY).all()) for text in texts]
    if of_day == [True]:
        return _parse_times_of_day(texts[0])
    if len(texts) > 1:
        if sorted(of_day) != [False, True]:
            raise InputError(f"time: {name} are not one column of dates and one of times of day, as iso joins them")
        # ISO 8601 has two digits of an hour; a comma may stand for the point.
        hours = texts[of_day.index(True)].str.replace(",", ".").str.zfill(8)
        texts[0] = texts[of_day.index(False)] + "T" + hours.where(hours.str.find(":") != 1, "0" + hours)
    try:
        stamps = pd.to_datetime(texts[0], utc=True, format="ISO8601").astype("datetime64[ns, UTC]")
    except (ValueError, TypeError) as fault:
        words = " ".join(str(fault).split()).split(". You might")[0]  # without advice on arguments that an import does not have
        raise InputError(f"time: column {name} is not ISO 8601: {words}") from None
    ticks, note = continue_tags(stamps.astype("int64").to_numpy(), "ns")
    return replace(_split_seconds(ticks, 9, "UTC"), note=note)


def _parse_times_of_day(column: pd.Series) -> Clock:
    """Parse times of day without a date; a step back by more than half a day is midnight."""
    parts = column.str.split(":", expand=True)
    minutes = (parts[0].astype(int) * 60 + parts[1].astype(int)).to_numpy()
    seconds = parts[2].str.replace(",", ".").astype(float).to_numpy(dtype=np.float64)
    whole = minutes * 60 + np.floor(seconds).astype(np.int64)
    days = np.concatenate([[0], np.cumsum(np.round(np.diff(whole) / SECONDS_A_DAY) * -1)]).astype(np.int64)
    return Clock(whole + SECONDS_A_DAY * days, np.asarray(seconds - np.floor(seconds)), "")


def describe_first_word(column: pd.Series) -> str:
    """Describe the first entry of a column that is no number, with its row."""
    import pandas as pd

    values = pd.to_numeric(column.astype(str), errors="coerce")  # as text: an integer of 400 digits is no float
    words = column[~np.isfinite(values) & column.notna()]
    return f"{str(words.iloc[0])!r} in row {words.index[0]}" if len(words) else str(column.dtype)


def is_numeric(column: pd.Series) -> bool:
    """Whether a column holds numbers."""
    return column.dtype.kind in "iuf"


def _read_numeric(column: pd.Series, name: str) -> NDArray[np.generic]:
    """Read a column of time tags as finite numbers (n,) below 2^63."""
    if not is_numeric(column):
        raise InputError(f"time: column {name} holds {describe_first_word(column)}, not numbers; dates are iso")
    values: NDArray[np.generic] = column.to_numpy()
    size = np.abs(values.astype(float))
    if not np.isfinite(size).all():
        raise InputError(f"time: column {name}, row {int(np.argmax(~np.isfinite(size)))}: not a finite number")
    if size.max() >= 2.0**63:
        raise InputError(f"time: column {name} has values beyond 2^63")
    return values


def _split_seconds(values: NDArray[np.generic], places: int, scale: str) -> Clock:
    """Split tags into whole seconds and the rest; integers, which nanoseconds of unix time need, stay exact."""
    if np.issubdtype(values.dtype, np.integer):
        unit = 10**places
        whole = values.astype(np.int64) // unit
        return Clock(whole, (values.astype(np.int64) - whole * unit) / unit, scale)
    seconds = values.astype(np.float64) / 10**places
    floor = np.floor(seconds)
    return Clock(floor.astype(np.int64), seconds - floor, scale)


def compute_gyro_factor(unit: str, lsb: str | None) -> tuple[float, bool]:
    """Compute the factor from a column's unit to rad/s or rad, and whether the column is an accumulated angle."""
    known = RATE_UNITS | ANGLE_UNITS
    if unit == COUNTS_UNIT:
        if lsb is None:
            raise InputError("gyro: counts need the size of one, e.g. --lsb '0.0175 deg/s', or '5e-9 rad' of accumulated angle")
        number, _, of = lsb.strip().partition(" ")
        of = of.strip()
        try:
            value = float(number)
        except ValueError:
            value = np.nan
        if not np.isfinite(value) or of not in known:
            raise InputError(f"lsb: {lsb!r} is not a number and a unit, as in '5e-9 rad'; units are {', '.join(known)}")
        return value * known[of], of in ANGLE_UNITS
    if lsb is not None:
        raise InputError(f"lsb: goes with counts, not with {unit}")
    known |= INCREMENT_UNITS
    if unit not in known:
        raise InputError(f"gyro: unit {unit} is not known; known are {', '.join((*known, COUNTS_UNIT))}")
    return known[unit], unit in ANGLE_UNITS


def format_degrees(values: Array) -> str:
    """Format angles, rad, in degrees with four digits each."""
    return ", ".join(f"{value:.4g}" for value in np.rad2deg(values))
