"""Calibration intervals: their begin and end, and the references in each.

The rotation in an interval is so small that errors of G of a percent stay linear. An interval has a few hundred references at
most and ends at gaps of either side. Each begins at a reference of its own, so residuals of different intervals do not
correlate.
"""

from __future__ import annotations

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import Mapping, Span
from gyrocal.importing.gyro_samples import GAP_SAMPLES
from gyrocal.importing.streams import BodyAttitudes
from gyrocal.recording import GyroStream, Interval, find_reference_rows

MOST_INTERVAL_TURN = np.deg2rad(720.0)  # rotation summed over an interval: an error of G of one percent is then 7 deg
INTERVAL_S = (30.0, 1800.0)
MOST_INTERVAL_REFERENCES = 150  # aimed at in an interval of the longest duration
ATTITUDE_GAP_FACTOR = 5.0  # times the usual spacing of the attitudes: a longer one is a gap


def choose_intervals(gyro: GyroStream, body: BodyAttitudes, mapping: Mapping, notes: list[str]) -> list[Indices]:
    """Choose the intervals, the stated ones or else by gaps, rotation and duration; return the rows of each's attitudes."""
    t_ref, sample_s = body.t_s, gyro.sample_s
    stop = np.append(gyro.t_s[1:], gyro.t_s[-1] + sample_s)
    gap = np.flatnonzero(stop - gyro.t_s > GAP_SAMPLES * sample_s)
    # Stretches of the gyro without a gap: from the start of a sample to the end of the last before a gap.
    starts = np.concatenate([[gyro.t_s[0]], stop[gap]])
    stops = np.concatenate([gyro.t_s[gap] + sample_s, [stop[-1]]])
    if mapping.interval is not None:
        gaps = list(zip(stops[:-1].tolist(), starts[1:].tolist(), strict=True))
        return _choose_stated_rows(t_ref, mapping.interval, mapping.spacing_s or 0.0, gaps, notes)
    if gap.size:
        notes.append(f"{gap.size} gap(s) of the gyro longer than {GAP_SAMPLES:g} samples end an interval")
    usual = float(np.median(np.diff(t_ref)))
    is_gap = np.diff(t_ref) > ATTITUDE_GAP_FACTOR * usual
    covered = [
        k for k in np.flatnonzero(is_gap).tolist() if ((starts <= t_ref[k] + 1e-9) & (stops >= t_ref[k + 1] - 1e-9)).any()
    ]
    if covered:
        longest = max(covered, key=lambda k: float(t_ref[k + 1] - t_ref[k]))
        notes.append(
            f"{len(covered)} gap(s) of the attitudes longer than {ATTITUDE_GAP_FACTOR:g} times their usual spacing end an "
            "interval although the gyro has samples, the longest from "
            f"{t_ref[longest]:.9g} to {t_ref[longest + 1]:.9g} s: the calibration does not use the motion in them; to use it, "
            "state the intervals (entry interval of a mapping file)"
        )
    rotation = np.concatenate([[0.0], np.cumsum(np.linalg.norm(gyro.rates + gyro.apriori_bias, axis=1) * (stop - gyro.t_s))])
    rotation_at = np.interp(t_ref, np.append(gyro.t_s, stop[-1]), rotation)
    span = float(np.clip(stop[-1] - gyro.t_s[0], *INTERVAL_S))
    spacing = mapping.spacing_s or max(usual, min(span, _choose_length(mapping, rotation_at, t_ref)) / MOST_INTERVAL_REFERENCES)
    stretch = np.searchsorted(starts, t_ref + 1e-9, side="right") - 1
    intervals: list[list[int]] = []
    current: list[int] = []
    for row, time in enumerate(t_ref):
        k = stretch[row]
        if k < 0 or time > stops[k] + 1e-9:
            continue
        if current:
            is_separate = stretch[current[-1]] != k or bool(is_gap[current[-1] : row].any())
            duration = time - t_ref[current[0]]
            is_long = duration > (mapping.interval_s or INTERVAL_S[1]) or (
                mapping.interval_s is None
                and rotation_at[row] - rotation_at[current[0]] > MOST_INTERVAL_TURN
                and duration > min(INTERVAL_S[0], 0.25 * (t_ref[-1] - t_ref[0]))
            )
            if is_separate or is_long or len(current) >= 4 * MOST_INTERVAL_REFERENCES:
                intervals.append(current)
                current = []
            elif time - t_ref[current[-1]] < (1 - 1e-6) * spacing:
                continue
        current.append(row)
    intervals = [rows for rows in [*intervals, current] if len(rows) >= 2]
    if not intervals:
        raise InputError("no interval has two attitudes within the gyro's time")
    notes.append(f"references at least {spacing:.4g} s apart are used, of those {usual:.4g} s apart")
    notes.append(f"{len(intervals)} interval(s) made, each with a first reference of its own")
    return [np.array(rows) for rows in intervals]


def _choose_stated_rows(
    t_ref: Array, spans: list[Span], spacing_s: float, gaps: list[tuple[float, float]], notes: list[str]
) -> list[Indices]:
    """Select the rows of the attitudes in stated intervals, and note the gyro's gaps in them."""
    inside = [gap for gap in gaps if any(span.start_s < gap[1] and gap[0] < span.stop_s for span in spans)]
    if inside:
        longest = max(stop - start for start, stop in inside)
        notes.append(
            f"{len(inside)} gap(s) of the gyro are in the stated intervals, the first from "
            f"{inside[0][0]:.9g} to {inside[0][1]:.9g} s: split the intervals there, or hold the last "
            f"rate in the calibration alone: gyrocal calibrate --max-gap {1.01 * longest:.4g}"
        )
    interval_rows = select_spaced_rows(t_ref, spans, spacing_s)
    for span, rows in zip(spans, interval_rows, strict=True):
        if len(rows) < 2:
            raise InputError(
                f"interval {span.name}: {len(rows)} attitude(s) from {span.start_s:.9g} to {span.stop_s:.9g} s since the epoch"
            )
    return interval_rows


def select_spaced_rows(t_ref: Array, spans: list[Span], spacing_s: float) -> list[Indices]:
    """Select the rows of attitudes in each interval, none nearer to the one before than the spacing."""
    interval_rows = []
    for span in spans:
        rows: list[int] = []
        for row in find_reference_rows(t_ref, span.interval).tolist():
            if not rows or t_ref[row] - t_ref[rows[-1]] >= (1 - 1e-6) * spacing_s:
                rows.append(row)
        interval_rows.append(np.array(rows, dtype=np.intp))
    return interval_rows


def _choose_length(mapping: Mapping, rotation_at: Array, t_ref: Array) -> float:
    """Choose the duration of an interval by the rotation allowed in it, s."""
    if mapping.interval_s is not None:
        return mapping.interval_s
    rate = (rotation_at[-1] - rotation_at[0]) / (t_ref[-1] - t_ref[0])
    return float(np.clip(MOST_INTERVAL_TURN / max(rate, 1e-12), *INTERVAL_S))


def build_interval(t_ref: Array, rows: Indices, rests: list[tuple[int, int]], t_s: Array, number: int) -> Interval:
    """Build the interval of some rows of the attitudes, named by its number, with the body's activity in it."""
    start, stop = float(t_ref[rows[0]]), float(t_ref[rows[-1]])
    resting = sum(max(min(stop, t_s[b - 1]) - max(start, t_s[a]), 0.0) for a, b in rests)
    activity = "rest" if resting > 0.9 * (stop - start) else "motion and rest" if resting > 0 else "motion"
    return Interval(f"part {number}", activity, start, stop)
