"""Reference attitudes that were not measured: the identity in place of a lost reference, and held values.

Measured attitudes carry noise, and they follow the gyro. Two observations contradict a measurement:

* A row repeats the one before to the last digit although the gyro turned between them by many steps of the table's last digit.
  A body at rest may repeat a rounded attitude, so a repeat without a turn is kept. If the repeats are a large share of the rows
  while the gyro turns, the table is forward-filled, and its repeats at rest are left out as well: they are copies of one
  measurement.
* A row is exactly the identity although the gyro's path from the row before it, or to the row after it, is far shorter than the
  jump between them. A table may begin at the identity; then it does not jump.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array, Mask
from gyrocal.mask_runs import find_mask_runs
from gyrocal.rests import QUIET, compute_speed

WINDOW_S = 0.5  # of the scatter of the rates, for the bias
SAME_ELEMENT = 1e-12  # of quaternion elements that are the same number after a conversion
TURNED_STEPS = 4.0  # smallest turns between rows: above it a repeat is no rounding, whose cell spans √3 of them
NOISE_SIGMAS = 6.0  # of the gyro's integrated noise: added to this limit
FILLED_SHARE = 0.2  # of the rows while the gyro turns: with more repeats a table is forward-filled
JUMP_MARGIN = 10.0  # median differences between the turn of the attitudes and the gyro's path
FEWEST_ATTITUDES = 4  # that must remain


def leave_out_lost_references(
    t_s: Array, q: Array, gyro_t_s: Array, raw: Array, sample_s: float, what: str, notes: list[str]
) -> Mask:
    """Find the rows (m,) of attitudes that were measured, and note the kind of the others.

    Parameters
    ----------
    t_s, q : (m,) s and (m, 4) unit quaternions in the order of time
    gyro_t_s, raw, sample_s : (n,) begins of the samples, s, (n, k) their rates, rad/s, and their length
    what : how the rows are called
    """
    edges = np.append(gyro_t_s, gyro_t_s[-1] + sample_s)
    length = np.diff(edges)[:, None]
    path = np.interp(t_s, edges, np.append(0.0, np.cumsum(np.linalg.norm(raw, axis=1) * length[:, 0])))
    is_measured = np.ones(t_s.size, dtype=bool)

    identity = np.abs(np.abs(q[:, 3]) - 1) < SAME_ELEMENT
    is_lost = _find_jumping_runs(identity, q, path)
    if is_lost.any() and (~is_lost).sum() >= FEWEST_ATTITUDES:
        is_measured &= ~is_lost
        notes.append(
            f"{int(is_lost.sum())} {what} row(s) are the identity, to which the gyro did not turn: left out as lost, "
            f"the first at {t_s[is_lost][0]:.9g} s"
        )

    rows = np.flatnonzero(is_measured)
    rates = raw - _estimate_rest_rate(t_s[rows], q[rows], gyro_t_s, raw, sample_s)
    course = np.concatenate([np.zeros((1, raw.shape[1])), np.cumsum(rates * length, axis=0)])
    course_at_rows = np.column_stack([np.interp(t_s[rows], edges, column) for column in course.T])
    is_held = _find_held_rows(t_s[rows], q[rows], course_at_rows, float(np.std(np.diff(raw, axis=0)) / np.sqrt(2)), sample_s)
    if is_held.any() and (~is_held).sum() >= FEWEST_ATTITUDES:
        is_measured[rows[is_held]] = False
        text = f"{int(is_held.sum())} {what} row(s) repeat the one before to the last digit, although the gyro turns"
        notes.append(f"{text}: left out as held, the first at {t_s[rows[is_held]][0]:.9g} s")
        if is_held.mean() > FILLED_SHARE:
            late_s = float(np.median(np.diff(t_s)))
            notes.append(
                f"the {what} rows are forward-filled, so that their time tags are up to {late_s:.3g} s late; a table of their "
                "own with the times of the measurements has no such error"
            )
    return is_measured


def _compute_turns(q: Array) -> Array:
    """Compute the angle (m − 1,) from each row to the next, rad."""
    return np.asarray((Rotation.from_quat(q[:-1]).inv() * Rotation.from_quat(q[1:])).magnitude())


def _find_jumping_runs(identity: Mask, q: Array, path: Array) -> Mask:
    """Find the rows (m,) of runs of the identity with a jump at either end beyond the gyro's path (m,), rad."""
    out = np.zeros_like(identity)
    if not identity.any() or identity.all():
        return out
    turns, paths = _compute_turns(q), np.diff(path)
    is_measured = ~identity[1:] & ~identity[:-1]
    if not is_measured.any():
        return out
    margin = JUMP_MARGIN * float(np.median(np.abs(turns - paths)[is_measured]))
    jumps = turns > 2 * paths + margin
    for first, stop in find_mask_runs(identity):
        if (first > 0 and jumps[first - 1]) or (stop < identity.size and jumps[stop - 1]):
            out[first:stop] = True
    return out


def _estimate_rest_rate(t_s: Array, q: Array, gyro_t_s: Array, raw: Array, sample_s: float) -> Array:
    """Estimate the gyro's reading at rest (k,), rad/s, where it scatters least; zero if the attitudes turn there."""
    size = max(round(WINDOW_S / sample_s), 4)
    count = len(raw) // size
    if count < 4 or t_s.size < FEWEST_ATTITUDES:
        return np.zeros(raw.shape[1])
    parts = raw[: count * size].reshape(count, size, -1)
    scatter = np.sqrt(parts.var(axis=1).mean(axis=1))
    quiet = scatter <= QUIET * np.percentile(scatter, 5)
    rate = np.median(parts.mean(axis=1)[quiet], axis=0)
    speed = compute_speed(t_s, q, gyro_t_s)[: count * size].reshape(count, size)[quiet]
    return np.asarray(rate if np.median(speed) < 0.5 * np.linalg.norm(rate) else np.zeros_like(rate))


def _find_held_rows(t_s: Array, q: Array, course: Array, noise: float, sample_s: float) -> Mask:
    """Find the rows (m,) that repeat the one before while the gyro's course (m, k), rad, turns."""
    is_repeat = np.append(False, np.minimum(*(np.abs(q[1:] - s * q[:-1]).max(axis=1) for s in (1, -1))) < SAME_ELEMENT)
    out = np.zeros_like(is_repeat)
    if not is_repeat.any() or is_repeat[1:].all():
        return out
    turns = _compute_turns(q)
    step = float(turns[~is_repeat[1:]].min())

    def is_turn(angle: Array, elapsed_s: Array) -> Mask:
        return np.asarray(angle > TURNED_STEPS * step + NOISE_SIGMAS * noise * np.sqrt(elapsed_s * sample_s))

    for first, stop in find_mask_runs(is_repeat):
        angle_from_first = np.linalg.norm(course[first:stop] - course[first - 1], axis=1)
        out[first:stop] = is_turn(angle_from_first, t_s[first:stop] - t_s[first - 1]).any()
    # Rows while the gyro turns: held ones, and measured ones after an equally large turn.
    turning = is_turn(np.linalg.norm(np.diff(course, axis=0), axis=1), np.diff(t_s))
    measured = int((turning & ~is_repeat[1:]).sum())
    return is_repeat if out.sum() > FILLED_SHARE * (out.sum() + measured) else out
