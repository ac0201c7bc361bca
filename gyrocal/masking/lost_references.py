"""Reference attitudes that were not measured: zeros, the identity in place of a lost reference, and held values.

Measured attitudes carry noise, and they follow the gyro. Two observations contradict a measurement:

* A row repeats the one before to the last digit although the gyro turned between them by many steps of the table's last digit.
  A body at rest may repeat a rounded attitude, so a repeat without a turn is kept. If the repeats make up a good share of the
  rows while the gyro turns, the table is forward-filled, and its repeats at rest are left out as well: they are copies of one
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
SAME = 1e-12  # of quaternion elements that are the same number after a conversion
TURNED_STEPS = 4.0  # least turns between two rows, from which on a repeat is no rounding: a cell of rounding spans √3 of them
NOISE_SIGMAS = 6.0  # of the gyro's integrated noise, for the same
FILLED_SHARE = 0.2  # of the rows while the gyro turns: from this share of repeats on, a table is forward-filled
JUMP_MARGIN = 10.0  # median differences between the turn of the attitudes and the gyro's path
FEWEST_ATTITUDES = 4  # that must be left


def leave_out_lost_references(
    t_s: Array, q: Array, gyro_t_s: Array, raw: Array, sample_s: float, what: str, said: list[str]
) -> Mask:
    """Find the rows (m,) of attitudes that were measured, and say of which kind the others are.

    Parameters
    ----------
    t_s, q : (m,) s and (m, 4) unit quaternions in the order of time
    gyro_t_s, raw, sample_s : (n,) begins of the samples, s, (n, k) their rates, rad/s, and their length
    what : how the rows are called
    """
    edges = np.append(gyro_t_s, gyro_t_s[-1] + sample_s)
    length = np.diff(edges)[:, None]
    path = np.interp(t_s, edges, np.append(0.0, np.cumsum(np.linalg.norm(raw, axis=1) * length[:, 0])))
    keep = np.ones(t_s.size, dtype=bool)

    identity = np.abs(np.abs(q[:, 3]) - 1) < SAME
    lost = _find_jumping_runs(identity, q, path)
    if lost.any() and (~lost).sum() >= FEWEST_ATTITUDES:
        keep &= ~lost
        said.append(
            f"{int(lost.sum())} {what} row(s) are the identity, to which the gyro did not turn: left out as lost, "
            f"the first at {t_s[lost][0]:.9g} s"
        )

    rows = np.flatnonzero(keep)
    turned = raw - _estimate_rest_rate(t_s[rows], q[rows], gyro_t_s, raw, sample_s)
    course = np.concatenate([np.zeros((1, raw.shape[1])), np.cumsum(turned * length, axis=0)])
    at = np.column_stack([np.interp(t_s[rows], edges, column) for column in course.T])
    held = _find_held_rows(t_s[rows], q[rows], at, float(np.std(np.diff(raw, axis=0)) / np.sqrt(2)), sample_s)
    if held.any() and (~held).sum() >= FEWEST_ATTITUDES:
        keep[rows[held]] = False
        text = f"{int(held.sum())} {what} row(s) repeat the one before to the last digit, although the gyro turns"
        said.append(f"{text}: left out as held, the first at {t_s[rows[held]][0]:.9g} s")
        if held.mean() > FILLED_SHARE:
            late_s = float(np.median(np.diff(t_s)))
            said.append(
                f"the {what} rows are forward-filled, so that their time tags are up to {late_s:.3g} s late; a table of their "
                "own with the times of the measurements has no such error"
            )
    return keep


def _compute_turns(q: Array) -> Array:
    """(m − 1,) angle from each row to the next, rad."""
    return np.asarray((Rotation.from_quat(q[:-1]).inv() * Rotation.from_quat(q[1:])).magnitude())


def _find_jumping_runs(identity: Mask, q: Array, path: Array) -> Mask:
    """Runs of the identity (m,) with a jump at either end beyond the gyro's path (m,)."""
    out = np.zeros_like(identity)
    if not identity.any() or identity.all():
        return out
    turns, paths = _compute_turns(q), np.diff(path)
    others = ~identity[1:] & ~identity[:-1]
    if not others.any():
        return out
    margin = JUMP_MARGIN * float(np.median(np.abs(turns - paths)[others]))
    jumps = turns > 2 * paths + margin
    for first, stop in find_mask_runs(identity):
        if (first > 0 and jumps[first - 1]) or (stop < identity.size and jumps[stop - 1]):
            out[first:stop] = True
    return out


def _estimate_rest_rate(t_s: Array, q: Array, gyro_t_s: Array, raw: Array, sample_s: float) -> Array:
    """The gyro's reading at rest (k,), from where it scatters least; zero if the attitudes turn there, as of an even spin."""
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


def _find_held_rows(t_s: Array, q: Array, at: Array, noise: float, sample_s: float) -> Mask:
    """Rows (m,) that repeat the one before while the gyro's course `at` (m, k), rad, turns."""
    same = np.append(False, np.minimum(*(np.abs(q[1:] - s * q[:-1]).max(axis=1) for s in (1, -1))) < SAME)
    out = np.zeros_like(same)
    if not same.any() or same[1:].all():
        return out
    turns = _compute_turns(q)
    step = float(turns[~same[1:]].min())

    def is_turn(angle: Array, elapsed_s: Array) -> Mask:
        return np.asarray(angle > TURNED_STEPS * step + NOISE_SIGMAS * noise * np.sqrt(elapsed_s * sample_s))

    for first, stop in find_mask_runs(same):
        away = np.linalg.norm(at[first:stop] - at[first - 1], axis=1)
        out[first:stop] = is_turn(away, t_s[first:stop] - t_s[first - 1]).any()
    # Rows while the gyro turns: held ones, and measured ones to which it turned as far.
    turning = is_turn(np.linalg.norm(np.diff(at, axis=0), axis=1), np.diff(t_s))
    measured = int((turning & ~same[1:]).sum())
    return same if out.sum() > FILLED_SHARE * (out.sum() + measured) else out
