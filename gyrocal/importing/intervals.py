"""Calibration intervals of references: where they begin and end, and which references they keep.

Intervals are as long as the turn that errors of a percent in G still leave linear, hold a few hundred references at most, and
end at gaps of either side. Each begins at a reference of its own, so that residuals of different intervals do not correlate.
"""

from __future__ import annotations

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import Mapping, Span
from gyrocal.importing.gyro_samples import GAP_SAMPLES
from gyrocal.importing.streams import BodyAttitudes
from gyrocal.recording import GyroStream, Interval, find_reference_rows

MOST_INTERVAL_TURN = np.deg2rad(720.0)  # of an interval, summed: one percent of G is then 7 deg
INTERVAL_S = (30.0, 1800.0)
MOST_INTERVAL_REFERENCES = 150  # of an interval, at most
ATTITUDE_GAP_FACTOR = 5.0  # times the usual spacing without an attitude


def choose_intervals(gyro: GyroStream, joined: BodyAttitudes, mapping: Mapping, said: list[str]) -> list[Indices]:
    """Rows of the attitudes of each interval."""
    t_ref, sample_s = joined.t_s, gyro.sample_s
    stop = np.append(gyro.t_s[1:], gyro.t_s[-1] + sample_s)
    gap = np.flatnonzero(stop - gyro.t_s > GAP_SAMPLES * sample_s)
    if mapping.interval is not None:
        inside = [
            k for k in gap if any(one.start_s < stop[k] and gyro.t_s[k] + sample_s < one.stop_s for one in mapping.interval)
        ]
        if inside:
            longest = float((stop - gyro.t_s)[inside].max()) - sample_s
            said.append(
                f"{len(inside)} gap(s) of the gyro are in the stated intervals, the first from "
                f"{gyro.t_s[inside[0]] + sample_s:.9g} to {stop[inside[0]]:.9g} s: split the intervals there, or hold the last "
                f"rate in the calibration alone: gyrocal calibrate --max-gap {1.01 * longest:.4g}"
            )
        chosen = select_rows(t_ref, mapping.interval, mapping.spacing_s or 0.0)
        for one, rows in zip(mapping.interval, chosen, strict=True):
            if len(rows) < 2:
                raise InputError(
                    f"interval {one.name}: {len(rows)} attitude(s) from {one.start_s:.9g} to {one.stop_s:.9g} s since the epoch"
                )
        return chosen
    # Stretches of the gyro without a gap: from the start of a sample to the end of the last before a gap.
    starts = np.concatenate([[gyro.t_s[0]], stop[gap]])
    stops = np.concatenate([gyro.t_s[gap] + sample_s, [stop[-1]]])
    if gap.size:
        said.append(f"{gap.size} gap(s) of the gyro longer than {GAP_SAMPLES:g} samples end an interval")
    usual = float(np.median(np.diff(t_ref)))
    holes = np.diff(t_ref) > ATTITUDE_GAP_FACTOR * usual
    covered = [
        k for k in np.flatnonzero(holes).tolist() if ((starts <= t_ref[k] + 1e-9) & (stops >= t_ref[k + 1] - 1e-9)).any()
    ]
    if covered:
        longest = max(covered, key=lambda k: float(t_ref[k + 1] - t_ref[k]))
        said.append(
            f"{len(covered)} gap(s) of the attitudes longer than {ATTITUDE_GAP_FACTOR:g} times their usual spacing end an "
            "interval although the gyro has samples, the longest from "
            f"{t_ref[longest]:.9g} to {t_ref[longest + 1]:.9g} s: the calibration does not use the motion in them; to use it, "
            "state the intervals (entry interval of a mapping file)"
        )
    turned = np.concatenate([[0.0], np.cumsum(np.linalg.norm(gyro.rates + gyro.apriori_bias, axis=1) * (stop - gyro.t_s))])
    turn_at = np.interp(t_ref, np.append(gyro.t_s, stop[-1]), turned)
    span = float(np.clip(stop[-1] - gyro.t_s[0], *INTERVAL_S))
    least = mapping.spacing_s or max(usual, min(span, _choose_length(mapping, turn_at, t_ref)) / MOST_INTERVAL_REFERENCES)
    found: list[list[int]] = []
    stretch = np.searchsorted(starts, t_ref + 1e-9, side="right") - 1
    now: list[int] = []
    for row, time in enumerate(t_ref):
        k = stretch[row]
        if k < 0 or time > stops[k] + 1e-9:
            continue
        if now:
            apart = stretch[now[-1]] != k or bool(holes[now[-1] : row].any())
            long = time - t_ref[now[0]] > (mapping.interval_s or INTERVAL_S[1]) or (
                mapping.interval_s is None
                and turn_at[row] - turn_at[now[0]] > MOST_INTERVAL_TURN
                and time - t_ref[now[0]] > min(INTERVAL_S[0], 0.25 * (t_ref[-1] - t_ref[0]))
            )
            if apart or long or len(now) >= 4 * MOST_INTERVAL_REFERENCES:
                found.append(now)
                now = []
            elif time - t_ref[now[-1]] < (1 - 1e-6) * least:
                continue
        now.append(row)
    found = [rows for rows in [*found, now] if len(rows) >= 2]
    if not found:
        raise InputError("no interval has two attitudes within the gyro's time")
    said.append(f"references at least {least:.4g} s apart are used, of those {usual:.4g} s apart")
    said.append(f"{len(found)} interval(s) made, each with a first reference of its own")
    return [np.array(rows) for rows in found]


def select_rows(t_ref: Array, spans: list[Span], spacing_s: float) -> list[Indices]:
    """Rows of attitudes in each of some intervals, none nearer to the one before than the spacing."""
    chosen = []
    for span in spans:
        kept: list[int] = []
        for row in find_reference_rows(t_ref, span.interval).tolist():
            if not kept or t_ref[row] - t_ref[kept[-1]] >= (1 - 1e-6) * spacing_s:
                kept.append(row)
        chosen.append(np.array(kept, dtype=np.intp))
    return chosen


def _choose_length(mapping: Mapping, turn_at: Array, t_ref: Array) -> float:
    """Length of an interval by the turn allowed in it, s."""
    if mapping.interval_s is not None:
        return mapping.interval_s
    rate = (turn_at[-1] - turn_at[0]) / (t_ref[-1] - t_ref[0])
    return float(np.clip(MOST_INTERVAL_TURN / max(rate, 1e-12), *INTERVAL_S))


def name_interval(t_ref: Array, rows: Indices, still: list[tuple[int, int]], t_s: Array, number: int) -> Interval:
    """The interval of some rows of the attitudes, named by its number and by what the body does in it."""
    start, stop = float(t_ref[rows[0]]), float(t_ref[rows[-1]])
    resting = sum(max(min(stop, t_s[b - 1]) - max(start, t_s[a]), 0.0) for a, b in still)
    activity = "rest" if resting > 0.9 * (stop - start) else "motion and rest" if resting > 0 else "motion"
    return Interval(f"part {number}", activity, start, stop)
