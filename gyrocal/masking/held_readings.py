"""Readings of a gyro that are no measurements: one value held to the last digit where a gyro would show its noise.

Firmware sets rates below a threshold to zero, or holds the last reading at rest, on all axes together or on each. A gyro whose
step of the numbers is larger than its noise repeats a reading as well, so repeats alone prove nothing. Such a gyro comes to the
repeated value by the neighbouring steps; firmware jumps to it, and leaves the steps beside the value empty. A value is held if
stretches repeat it, hardly a reading is within a few steps of it, and the readings beside the stretches jump to it by more than
they change by themselves, or there are so many stretches that none of them can have missed the steps by chance.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.mask_runs import find_mask_runs

FEWEST_REPEATS = 10  # readings of one value in a stretch that is looked at
EMPTY_STEPS = 6.0  # steps of the numbers beside a held value that are empty
MOST_NEAR_SHARE = 0.5  # readings on these steps, of the stretches: one that is measured has them at both ends
JUMP_CHANGES = 1.5  # changes from one reading to the next; a ramp that begins at rest makes a first step of one at most
MANY_STRETCHES = 20
MOST_VALUES = 64  # of long stretches; more are rows filled with the reading before
REST_SHARE = 0.1  # of the RMS reading: no larger reading is one at rest
MOST_OTHER_SHARE = 0.25  # of the long stretches that repeat larger readings: then the gyro is quieter than a step
SAME_STEP = 1e-9  # of the largest reading: a smaller difference is rounding


def find_held_readings(t_s: Array, raw: Array) -> tuple[Mask, list[str]]:
    """Find rows (n,) of readings (n, k) in which one is held, and a sentence for each value."""
    held, said = np.zeros(len(raw), dtype=bool), list[str]()
    steps = np.array([_find_step(x) for x in raw.T])
    for axes in (list(range(raw.shape[1])), *([k] for k in range(raw.shape[1]))):
        for value, rows in _list_held_values(np.where(held[:, None], np.nan, raw)[:, axes], steps[axes]):
            held |= rows
            runs = find_mask_runs(rows)
            longest = max(t_s[stop - 1] - t_s[first] for first, stop in runs)
            which = "all axes" if len(axes) > 1 else f"axis {axes[0] + 1}"
            said.append(
                f"rates read exactly {', '.join(f'{x:.6g}' for x in value)} on {which} in {int(rows.sum())} of {len(raw)} "
                f"samples, in {len(runs)} stretches of up to {longest:.3g} s: the firmware holds this value at rest. It is no "
                "measurement of a rate or of a bias, and these samples are left out"
            )
    return held, said


def _find_step(x: Array) -> float:
    """Smallest difference of two readings."""
    x = np.unique(x[np.isfinite(x)])
    steps = np.diff(x)
    steps = steps[steps > SAME_STEP * np.abs(x).max(initial=0.0)]
    return float(steps.min(initial=np.inf))


def _list_held_values(x: Array, steps: Array) -> Iterator[tuple[Array, Mask]]:
    """The held values of readings (n, k) of which all are held together, each with its rows."""
    repeats = find_mask_runs(np.append(False, (x[1:] == x[:-1]).all(axis=1)))
    long = [(first - 1, stop) for first, stop in repeats if stop - first >= FEWEST_REPEATS - 1]
    found = x[[first for first, _ in long]]
    at_rest = np.abs(found).max(axis=1, initial=0.0) <= REST_SHARE * np.sqrt(np.nanmean(np.square(x)))
    values = np.unique(found[at_rest], axis=0)
    if not 0 < len(values) <= MOST_VALUES or (~at_rest).mean() >= MOST_OTHER_SHARE:
        return
    for value in values:
        rows = (x == value).all(axis=1)
        own = [(first, stop) for first, stop in long if rows[first]]
        near = ~rows & (np.abs(x - value) <= EMPTY_STEPS * steps).all(axis=1)
        if rows.mean() > 1 - 1 / FEWEST_REPEATS or near.sum() >= MOST_NEAR_SHARE * len(own):
            continue
        ends = [(first - 1, first - 2) for first, _ in own if first > 1]
        ends += [(stop, stop + 1) for _, stop in own if stop + 1 < len(x)]
        beside, beyond = np.array(ends, dtype=int).reshape(-1, 2).T
        jumps, changes = (np.abs(x[beside] - other).max(axis=1) for other in (value, x[beyond]))
        if len(own) >= MANY_STRETCHES or (ends and np.nanmedian(jumps) > JUMP_CHANGES * np.nanmedian(changes)):
            yield value, rows
