"""Samples of the gyros of a table, evenly timed and in SI units.

The tag of a rate column is the start, the middle or the end of the sample over which the rate is the mean. The differences of
an accumulated angle are exact means over the time between two tags; differences across a gap are left out.
"""

from __future__ import annotations

from shlex import quote
from typing import NamedTuple

import numpy as np
import pandas as pd

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing import units
from gyrocal.importing.column_mapping import Mapping, parse_spec
from gyrocal.importing.gyro_join import JoinedGyros, join_gyros, spans_all_directions
from gyrocal.importing.table_rows import read_labels, read_numbers, read_rows, select_columns, sort_rows
from gyrocal.importing.time_base import estimate_spacing, fit_even_times, is_uneven
from gyrocal.masking.held_readings import find_held_readings

TAG_NAMES = ("seconds (time)", "rest (time)")  # of the tags of rows that are arranged by gyro
WRAPS = (2.0**16, 2.0**24, 2.0**32, 360.0, 2 * np.pi)
GAP_SAMPLES = 1.5  # samples without a gyro reading
MOST_FILLED_SAMPLES = 2  # lost in a row that are filled
MOST_LOST_SHARE = 0.01  # of the rows; more that are lost or changed are said first
MOST_LABELS = 16  # values of a column that says which gyro a row is of
WRAP_TOLERANCE = 0.02  # of a wrap: largest difference of a jump from it


class GyroRows(NamedTuple):
    """Rows of the gyro's table that hold numbers."""

    clock: units.Clock  # their time tags
    values: Array  # (n, k) numbers as they are on file
    names: tuple[str, ...]  # of the k gyros
    G: Array  # (3, k) as the mapping states it
    number: Array | None  # (n,) sample numbers; None without a column of them


class GyroSamples(NamedTuple):
    """Samples of the gyros on the gyro's clock."""

    t_s: Array  # (n,) starts, s
    rates: Array  # (n, 3) rad/s, about the gyros' own axes, or about those of the body by more gyros
    sample_s: float
    G: Array  # (3, 3) of the rates
    joined: JoinedGyros | None  # more gyros than three, whose rates are joined


def read_gyro_rows(frame: pd.DataFrame, mapping: Mapping, notes: list[str]) -> GyroRows:
    """Read the rows of the gyro's table, and arrange those of several gyros side by side."""
    names, words = parse_spec(mapping.gyro, "gyro")
    time = mapping.time
    if mapping.rows is not None:
        frame = _select_rows(frame, mapping.rows)
        notes.append(f"{len(frame)} rows of the gyro's table, those of {mapping.rows}, are read")
    if mapping.gyro_by is not None:
        if mapping.sample_number is not None:
            raise InputError("sample_number: does not go with gyro_by, whose rows are put together by their time")
        frame, names, time = _arrange_by_gyro(frame, mapping.gyro_by, time, names, notes)
    if len(words) != 1:
        raise InputError(
            f"gyro: {mapping.gyro!r} must be columns of the table and one unit; there are {', '.join(map(str, frame.columns))}"
        )
    chosen = mapping.choose_gyros(names)
    if mapping.axes is None and mapping.G is None:
        G = mapping.build_G(len(chosen))
    else:
        G = mapping.build_G(len(names))
        K = np.asarray(np.linalg.pinv(G))[chosen]
        if not spans_all_directions(K):
            raise InputError(f"gyros: {', '.join(names[place] for place in chosen)} do not measure all three directions")
        G = G if mapping.gyros is None else np.linalg.pinv(K)
    names = [names[place] for place in chosen]
    if mapping.gyro_by is not None and not (np.isfinite(read_numbers(frame, names, "gyro")).sum(axis=1) >= 3).any():
        frame = _interpolate_gyros(frame, names, mapping, notes)
    counter = [] if mapping.sample_number is None else [mapping.sample_number]
    select_columns(frame, counter, "sample_number")
    most_missing, is_table = 0 if counter else len(names) - 3, mapping.gyro_by is None
    clock, values = read_rows(
        frame, [*names, *counter], "gyro", "gyro", ("time", time), notes, is_table, most_missing, not mapping.is_counted
    )
    number = _unwrap_sample_number(values[:, -1]) if counter else None
    return GyroRows(clock, values[:, : len(names)], tuple(name.removeprefix("-") for name in names), G, number)


def build_samples(rows: GyroRows, origin: int, mapping: Mapping, frame: pd.DataFrame, notes: list[str]) -> GyroSamples:
    """Build the gyro's samples: even time tags, rates of the stated unit, and more gyros than three joined.

    origin, frame: whole second from which times count, and the gyro's table
    """
    t_s = _put_on_even_times(rows, rows.clock.subtract(origin), mapping, frame, notes)
    t_s, raw = sort_rows(t_s, rows.values, "gyro", notes)
    t_s = t_s[0] + mapping.time_factor * (t_s - t_s[0])
    t_s, raw, sample_s = _convert_to_rates(t_s, raw, mapping, notes)
    factors = {"gyro's time tags are about the first one": mapping.time_factor, "rates are": mapping.rate_factor}
    notes += [f"the {what} times {factor:.9g}" for what, factor in factors.items() if factor != 1]
    raw, names = mapping.rate_factor * raw, rows.names
    if len(names) == 3:
        return GyroSamples(t_s, raw, sample_s, rows.G, None)
    joined = join_gyros(raw, np.linalg.pinv(rows.G), noise=mapping.get_relative_noise(len(names)), names=names)
    is_joined, is_complete = np.isfinite(joined.rates).all(axis=1), np.isfinite(raw).all(axis=1)
    if not is_complete.all():
        notes.append(
            f"{int((is_joined & ~is_complete).sum())} gyro row(s) in which a gyro is missing use the others; "
            f"{int((~is_joined).sum())} of fewer than three with independent axes are left out"
        )
    return GyroSamples(t_s[is_joined], joined.rates[is_joined], sample_s, np.eye(3), joined)


def _select_rows(frame: pd.DataFrame, text: str) -> pd.DataFrame:
    """Select the rows of a table in which a column has a value; text is "COLUMN:VALUE"."""
    name, _, value = text.partition(":")
    labels = read_labels(frame, name, "rows")
    chosen = frame[labels == value]
    if chosen.empty:
        known = ", ".join(labels.dropna().unique()[:MOST_LABELS])
        raise InputError(f"rows: column {name} has no {value}; it has {known}")
    return chosen


def _unwrap_sample_number(values: Array) -> Array:
    """Continue sample numbers (n,) of a counter of 8, 16, 32 or 64 bits beyond its wraps, and start them at zero."""
    step = np.diff(values)
    back = step[step < 0]
    if back.size:
        wrap = min(2.0**bits for bits in (8, 16, 32, 64) if 2.0**bits > values.max())
        step = np.where(step < -0.5 * wrap, step + wrap, step)
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        raise InputError(f"sample_number: does not grow at row {row}: {values[row - 1]:g}, then {values[row]:g}")
    return np.concatenate([[0.0], np.cumsum(step)])


def _put_on_even_times(rows: GyroRows, t_s: Array, mapping: Mapping, frame: pd.DataFrame, notes: list[str]) -> Array:
    """Put tags (n,), s, on an even time base if more than a percent are uneven, or if the mapping states number or rate.

    A change of the tags becomes the first note.
    """
    is_stated, number, rate_hz = mapping.is_counted, rows.number, mapping.rate_hz
    if t_s.size < 2 or (np.ptp(t_s) == 0 and not is_stated):
        return t_s
    tie = np.append(False, np.diff(t_s) == 0)
    same = tie & np.append(False, (np.diff(rows.values, axis=0) == 0).all(axis=1))
    if number is None and tie.any() and (same == tie).all():
        return t_s  # rows written twice, which are left out
    # Differences of an accumulated angle are divided by those of its tags; only ties of the tags prevent this.
    uneven = tie.mean() > MOST_LOST_SHARE if mapping.is_accumulated else is_uneven(t_s)
    if not is_stated and not uneven:
        return t_s
    if not is_stated:
        _refuse_several_gyros(frame, mapping, (t_s.size - 1) / np.ptp(t_s))
    fit = fit_even_times(t_s, number, None if rate_hz is None else 1 / rate_hz)
    if rate_hz is not None and (fit is None or fit.drift_s):
        places = rows.clock.rows
        step = places - places[0] if number is None else number
        usual = np.median(np.diff(step)) if number is None and step.size > 1 else 1  # above 1 with rows of other gyros between
        even = np.round(step / usual) / rate_hz
        even += np.median(t_s - even)
        text = f"do not follow the stated {rate_hz:.9g} Hz, which replaces them: moved by {_describe_moves(even - t_s)}"
        notes.insert(0, f"the gyro's time tags {text}")
        return even
    if fit is None:
        _refuse_uneven(t_s, is_stated, len(frame.columns) > 4 + (mapping.temperature is not None))
        return t_s
    text = (
        f"the gyro's time tags are put on an even time base of {1e3 * fit.sample_s:.6g} ms by a straight line through the "
        f"tags against the {'row' if number is None else 'sample'} number, as they {fit.errors}; they are moved by "
        f"{_describe_moves(t_s - fit.t_s)}"
    )
    if fit.drift_s:
        text += f"; the clock drifts from a straight line by {fit.drift_s:.3g} s, which is kept"
    notes.insert(0, text)
    return fit.t_s


def _describe_moves(moves: Array) -> str:
    """Describe the RMS and the largest change of time tags (n,), s."""
    return f"{np.sqrt(np.mean(moves**2)):.3g} s (RMS), {np.abs(moves).max():.3g} s at most"


def _refuse_uneven(t_s: Array, is_stated: bool, has_more_columns: bool) -> None:
    """Refuse tags that follow no line, unless nearly all rows are at least half a sample after the row before."""
    close = np.diff(t_s) < 0.5 * float(np.median(np.diff(t_s)[np.diff(t_s) > 0]))
    if not is_stated and close.mean() <= MOST_LOST_SHARE:
        return
    rate_hz = 1 / max(estimate_spacing(t_s, np.arange(t_s.size, dtype=np.float64)), np.finfo(float).tiny)
    remedy = "is the sample number that of these rows?" if is_stated else f"state the samples a second: --rate {rate_hz:.5g}"
    if not is_stated and has_more_columns:
        remedy += ", or a column that counts the samples, --sample-number COLUMN"
    raise InputError(
        f"time: {int(close.sum())} of {t_s.size} gyro rows have the tag of the row before or one within half a sample "
        f"of it, and the tags do not follow the number of the row; {remedy}"
    )


def _refuse_several_gyros(frame: pd.DataFrame, mapping: Mapping, rate_hz: float) -> None:
    """Refuse rows of several gyros in one table: a column of few values, each with even time tags of its own."""
    if mapping.rows is not None or mapping.gyro_by is not None:
        return
    tags, unit = parse_spec(mapping.time, "time")
    used = {*tags, mapping.temperature, *(name.removeprefix("-") for name in parse_spec(mapping.gyro, "gyro")[0])}
    for name in frame.columns:
        if name in used or not 2 <= frame[name].nunique() <= MOST_LABELS:
            continue
        parts = [units.build_clock(part[tags], unit[0]) for _, part in frame.groupby(name)]
        times = [clock.subtract(int(clock.whole[0])) for clock in parts]
        if all(t.size > 2 and (np.diff(t) > 0).all() and not is_uneven(t) for t in times):
            values = list(read_labels(frame, str(name), "rows").dropna().unique())
            raise InputError(
                f"time: each value of column {name} ({', '.join(values)}) has time tags of its own: choose the rows of one "
                f"gyro, e.g. --rows {quote(f'{name}:{values[0]}')}; if it numbers samples of one gyro, state "
                f"their rate: --rate {rate_hz:.4g}"
            )


def _arrange_by_gyro(
    frame: pd.DataFrame, by: str, time: str, names: list[str], notes: list[str]
) -> tuple[pd.DataFrame, list[str], str]:
    """Arrange rows of several gyros as one row for each time, with a column for each gyro in the order of appearance.

    Returns this table, the gyros, and the mapping's text of its tags.
    """
    labels = read_labels(frame, by, "gyro_by")
    if len(names) != 1:
        raise InputError(f"gyro: with gyro_by = {by!r} one column is wanted, not {len(names)}")
    order, parts, scale = list(labels.dropna().unique()), list[pd.DataFrame](), ""
    for gyro in order:  # each gyro's tags go on by themselves
        clock, values = read_rows(frame[labels == gyro], names, "gyro", f"gyro {gyro}", ("time", time), notes)
        scale = clock.scale
        parts.append(pd.DataFrame({"gyro": gyro, "whole": clock.whole, "part": clock.part, "value": values[:, 0]}))
    rows = pd.concat(parts)
    if labels.isna().any():
        notes.append(f"{int(labels.isna().sum())} gyro row(s) without a gyro in {by} are left out")
    if twice := int(rows.duplicated(["gyro", "whole", "part"]).sum()):
        notes.append(f"{twice} gyro row(s) of a time that another one of that gyro has are left out")
    table = rows.pivot_table(index=["whole", "part"], columns="gyro", values="value", aggfunc="first")[order]
    table = table.set_axis(order, axis=1).reset_index(names=[*TAG_NAMES])
    unit = {"UTC": "unix+s", "GPS": "gps+s", "": "s+s"}[scale]
    return table, order, f"{','.join(TAG_NAMES)}:{unit}"


def _interpolate_gyros(frame: pd.DataFrame, names: list[str], mapping: Mapping, notes: list[str]) -> pd.DataFrame:
    """Interpolate accumulated angles of gyros with tags of their own at the first gyro's tags.

    The interpolation is linear, which is exact for the mean rate between two tags.
    """
    if not mapping.is_accumulated:
        raise InputError("gyro: the gyros have time tags of their own; only accumulated angles can be taken to common ones")
    whole_s, part_s = (frame[tag].to_numpy() for tag in TAG_NAMES)
    seconds = (whole_s - whole_s.min()) + part_s
    columns = {name: frame[name].to_numpy(dtype=np.float64) for name in names}
    rows = {name: np.flatnonzero(np.isfinite(values)) for name, values in columns.items()}
    begin, end = max(seconds[row[0]] for row in rows.values()), min(seconds[row[-1]] for row in rows.values())
    common = rows[names[0]]
    common = common[(seconds[common] >= begin) & (seconds[common] <= end)]
    table = frame.loc[common, [*TAG_NAMES]].reset_index(drop=True)
    for name, values in columns.items():
        angle = values[rows[name]]
        steps = _unwrap_steps(np.diff(angle)[:, None], mapping.wrap, [])
        angle = angle[0] + np.concatenate([[0.0], np.cumsum(steps[:, 0])])
        table[name] = np.interp(seconds[common], seconds[rows[name]], angle)
    notes.append(f"each gyro has its own time tags: the angles of all are interpolated at those of {names[0]}")
    return table


def _convert_to_rates(t_s: Array, raw: Array, mapping: Mapping, notes: list[str]) -> tuple[Array, Array, float]:
    """Convert rows in the order of time to samples; return their starts (n,) s, rates (n, k) rad/s and length, s."""
    factor, accumulated = mapping.gyro_factor
    spacing = np.diff(t_s)
    sample_s = float(np.median(spacing))
    if accumulated:
        # The number of wraps and the motion in a gap are unknown: no sample begins at the last tag before a gap.
        kept = spacing <= GAP_SAMPLES * sample_s
        rates = factor * _unwrap_steps(np.diff(raw, axis=0)[kept], mapping.wrap, notes) / spacing[kept, None]
        if not kept.all():
            notes.append(f"{int((~kept).sum())} differences over gaps longer than {GAP_SAMPLES:g} samples are left out")
        notes.append("rates are differences of accumulated angles")
        return t_s[:-1][kept], rates, sample_s
    if mapping.wrap is not None:
        raw = _undo_overflows(raw, mapping.wrap, notes)
    if mapping.gyro_unit.endswith(units.PER_SAMPLE):
        # An increment is the angle of one sample; dividing it by the spacing of its tags would turn a late tag into a rate.
        raw = raw / sample_s
    is_close = np.append(False, spacing < 0.5 * sample_s)
    is_held, held_notes = find_held_readings(t_s[~is_close], raw[~is_close])
    notes += held_notes
    filled_t_s, filled = _fill_lost_samples(t_s[~is_close][~is_held], raw[~is_close][~is_held], sample_s, notes)
    notes.append(f"a gyro time tag is the {mapping.tag} of its sample")
    if is_close.any():
        notes.append(
            f"{int(is_close.sum())} gyro row(s) closer than half a sample to the one before are left out, the first at "
            f"{t_s[is_close][0]:.9g} s"
        )
    return filled_t_s - {"start": 0.0, "middle": 0.5, "end": 1.0}[mapping.tag] * sample_s, factor * filled, sample_s


def _fill_lost_samples(t_s: Array, raw: Array, sample_s: float, notes: list[str]) -> tuple[Array, Array]:
    """Interpolate the rates (n, k) of one or two lost samples between their neighbours; a longer gap stays."""
    spacing = np.diff(t_s)
    lost = np.where(spacing > GAP_SAMPLES * sample_s, np.round(spacing / sample_s) - 1, 0).astype(int)
    holes = np.flatnonzero((lost >= 1) & (lost <= MOST_FILLED_SAMPLES))
    if not holes.size:
        return t_s, raw
    added = np.concatenate([t_s[k] + spacing[k] * np.arange(1, lost[k] + 1) / (lost[k] + 1) for k in holes])
    rates = np.column_stack([np.interp(added, t_s, raw[:, axis]) for axis in range(raw.shape[1])])
    order = np.argsort(np.concatenate([t_s, added]), kind="stable")
    notes.append(
        f"{added.size} gyro sample(s) are lost, at most {MOST_FILLED_SAMPLES} in a row, and filled by interpolation of the "
        f"rates, the first at {added[0]:.9g} s"
    )
    return np.concatenate([t_s, added])[order], np.concatenate([raw, rates])[order]


def _unwrap_steps(step: Array, wrap: float | None, notes: list[str]) -> Array:
    """Remove the jumps of differences (n, k) of an accumulated angle at its wrap, which is estimated if it is None."""
    if wrap is None:
        typical = max(float(np.nanmedian(np.abs(step))), np.finfo(float).tiny)
        jump = np.abs(step) > 20 * typical
        if not jump.any():
            return step
        # A jump minus the mean of its neighbouring steps is the wrap at any rate.
        padded = np.pad(np.where(jump, np.nan, step), ((1, 1), (0, 0)), constant_values=np.nan)
        neighbours = np.array([padded[:-2][jump], padded[2:][jump]])
        jumps = np.abs(step[jump] - np.nansum(neighbours, axis=0) / np.maximum(np.isfinite(neighbours).sum(axis=0), 1))
        deviations = [float(np.abs(jumps / size - 1).max()) for size in WRAPS]
        if min(deviations) > WRAP_TOLERANCE:
            middle, spread = float(np.median(jumps)), float(np.ptp(jumps))
            rounded = next(value for digits in range(1, 18) if abs((value := float(f"{middle:.{digits}g}")) - middle) <= spread)
            raise InputError(
                f"gyro: the accumulated angle jumps by {middle:.6g}; if it wraps there, say where: --wrap {rounded:.15g}"
            )
        wrap = WRAPS[int(np.argmin(deviations))]
        notes.append(f"the accumulated angle wraps at {wrap:.9g}, as {jumps.size} jumps of it say")
    return step - wrap * np.round(step / wrap)


def _undo_overflows(raw: Array, full_range: float, notes: list[str]) -> Array:
    """Undo the jumps of rates (n, k) by their full range where their numbers overflow."""
    out = raw.copy()
    for k, x in enumerate(raw.T):
        turns = np.nan_to_num(np.round(np.diff(x) / full_range))
        if not turns.any():
            continue
        level = -np.append(0.0, np.cumsum(turns))
        # The level of the first row is unknown: that with the smallest mean square of the rates is taken.
        level -= min(np.unique(level), key=lambda base: float(np.nanmean(np.square(x + full_range * (level - base)))))
        out[:, k] += full_range * level
        notes.append(
            f"the readings of gyro {k + 1} jump {np.count_nonzero(turns)} time(s) by their full range of {full_range:.9g} "
            f"between two samples, as numbers that overflow: {np.count_nonzero(level)} rows are moved by it"
        )
    return out
