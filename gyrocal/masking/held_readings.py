"""Readings of a gyro that are no measurements: one value held to the last digit without the gyro's noise.

Firmware sets rates below a threshold to zero, or holds the last reading at rest, on all axes together or on each. A gyro whose
step of the numbers is larger than its noise also repeats a reading, so repeats alone prove nothing. Such a gyro reaches the
repeated value through the neighbouring steps; firmware jumps to it, and the steps beside the value are empty. A value is held
if stretches repeat it, few readings are within a few steps of it, and the jumps to it are larger than the usual changes of the
readings, or there are so many stretches that all of them cannot skip the steps by chance.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.mask_runs import find_mask_runs

FEWEST_REPEATS = 10  # readings of one value in a long stretch
EMPTY_STEPS = 6.0  # steps of the numbers beside a held value that are empty
MOST_NEAR_SHARE = 0.5  # readings on these steps per stretch: a measured stretch has them at both ends
JUMP_CHANGES = 1.5  # usual changes of a reading; a ramp that begins at rest makes a first step of one at most
MANY_STRETCHES = 20
MOST_VALUES = 64  # of long stretches; with more, rows are filled with the reading before
REST_SHARE = 0.1  # of the RMS reading: largest reading at rest
MOST_OTHER_SHARE = 0.25  # of the long stretches, repeating larger readings: above it the gyro's noise is below a step
SAME_STEP = 1e-9  # of the largest reading: a smaller difference is rounding


def find_held_readings(t_s: Array, raw: Array) -> tuple[Mask, list[str]]:
    """Find the rows (n,) of readings (n, k) in which a reading is held, and write a note for each held value."""
    is_held, notes = np.zeros(len(raw), dtype=bool), list[str]()
    steps = np.array([_find_step(x) for x in raw.T])
    for axes in (list(range(raw.shape[1])), *([k] for k in range(raw.shape[1]))):
        for value, rows in _list_held_values(np.where(is_held[:, None], np.nan, raw)[:, axes], steps[axes]):
            is_held |= rows
            runs = find_mask_runs(rows)
            longest = max(t_s[stop - 1] - t_s[first] for first, stop in runs)
            which = "all axes" if len(axes) > 1 else f"axis {axes[0] + 1}"
            notes.append(
                f"rates read exactly {', '.join(f'{x:.6g}' for x in value)} on {which} in {int(rows.sum())} of {len(raw)} "
                f"samples, in {len(runs)} stretches of up to {longest:.3g} s: the firmware holds this value at rest. It is no "
                "measurement of a rate or of a bias, and these samples are left out"
            )
    return is_held, notes


def _find_step(x: Array) -> float:
    """Find the smallest difference of two readings (n,); infinite without one."""
    x = np.unique(x[np.isfinite(x)])
    steps = np.diff(x)
    steps = steps[steps > SAME_STEP * np.abs(x).max(initial=0.0)]
    return float(steps.min(initial=np.inf))


def _list_held_values(x: Array, steps: Array) -> Iterator[tuple[Array, Mask]]:
    """List the held values (k,) of readings (n, k), held on all k axes together, each with its rows (n,)."""
    repeats = find_mask_runs(np.append(False, (x[1:] == x[:-1]).all(axis=1)))
    long = [(first - 1, stop) for first, stop in repeats if stop - first >= FEWEST_REPEATS - 1]
    repeated = x[[first for first, _ in long]]
    at_rest = np.abs(repeated).max(axis=1, initial=0.0) <= REST_SHARE * np.sqrt(np.nanmean(np.square(x)))
    values = np.unique(repeated[at_rest], axis=0)
    if not 0 < len(values) <= MOST_VALUES or (~at_rest).mean() >= MOST_OTHER_SHARE:
        return
    for value in values:
        rows = (x == value).all(axis=1)
        stretches = [(first, stop) for first, stop in long if rows[first]]
        nearby = ~rows & (np.abs(x - value) <= EMPTY_STEPS * steps).all(axis=1)
        if rows.mean() > 1 - 1 / FEWEST_REPEATS or nearby.sum() >= MOST_NEAR_SHARE * len(stretches):
            continue
        ends = [(first - 1, first - 2) for first, _ in stretches if first > 1]
        ends += [(stop, stop + 1) for _, stop in stretches if stop + 1 < len(x)]
        neighbour, beyond = np.array(ends, dtype=int).reshape(-1, 2).T
        jumps, changes = (np.abs(x[neighbour] - reference).max(axis=1) for reference in (value, x[beyond]))
        if len(stretches) >= MANY_STRETCHES or (ends and np.nanmedian(jumps) > JUMP_CHANGES * np.nanmedian(changes)):
            yield value, rows
