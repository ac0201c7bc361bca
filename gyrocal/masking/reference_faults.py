"""Reference attitudes that freeze or jump, by the innovations that a gyro propagates from one to the next.

A camera that swaps markers is off in single frames, or from one frame on. In the innovations (`gyrocal.innovations`) a group of
false references leaves and returns, and the reference after it fits the one before it. A jump that stays is one innovation far
beyond those around it. Errors of the gyro may look alike where references are far apart: there an innovation sums the errors of
many samples. So a jump that stays counts only where references are about as dense as samples. In both cases the jump has to be
larger than the turn of the body from one reference to the next, which is the most that a late or repeated frame makes, or point
elsewhere; and the turn of the gyro itself has to go on evenly.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array, Mask
from gyrocal.innovations import Innovations, compute_misses
from gyrocal.mask_runs import find_mask_runs
from gyrocal.masking.mask import MaskedStretch
from gyrocal.recording import Recording

FEWEST_REPEATS = 2  # repeats in a row; one may be a tag that was read twice
FREEZE_TURN_SIGMAS = 8.0  # sigmas of an innovation that the body turns during them
GROUP_SIGMAS = 12.0  # of an innovation at which a group begins, beyond noise of any tails that sensors have
LONGEST_GROUP = 3  # references
RETURNED_CHI2 = 25.0  # χ² of three axes over the whole group, which noise exceeds once in 10⁵
RETURNED_SHARE = 0.1  # of the begin that may be left over a group, by errors of the gyro's calibration
WANDER_STEPS = 20  # steps over which references and gyro wander apart
WANDERS = 2.0  # of that, median: the sigma of the references covers smaller jumps that stay, and a cut costs a start attitude
DENSE_SAMPLES = 3.5  # gyro samples from one reference to the next, up to which a jump that stays counts
AROUND = 5  # steps before and after that are looked at
ISOLATION = 5.0  # times most of the innovations around
MOST_AROUND = 0.7  # quantile of them
UNEVEN_STEP = 1.5  # usual spacings; over a longer time errors of the gyro add up
EVEN_SHARE = 0.5  # of the innovation, by which the gyro's own turn may differ from those beside it
LATE_QUANTILE = 0.95  # of the times from one reference to the next: by so much one may be late
ACROSS = 0.5  # share of an innovation across the turn of the body, which no error of the time tags makes
MOST_LOST = 0.05  # of the references, above which they are no exceptions


def find_frozen(recording: Recording, seen: Innovations) -> list[MaskedStretch]:
    """Find runs of references that agree to the last digit while the gyro turns."""
    t_s, q = recording.attitudes.t_s, recording.attitudes.quaternions
    out = []
    for low, high in find_mask_runs((q[seen.first] == q[seen.second]).all(axis=1)):
        turned = float(np.linalg.norm(np.cumsum(seen.turned[low:high], axis=0), axis=1).max())
        if high - low >= FEWEST_REPEATS and turned > FREEZE_TURN_SIGMAS * float(seen.sigma[low:high].max()):
            last = float(t_s[seen.second[high - 1]])
            out.append(MaskedStretch("frozen", None, float(t_s[seen.second[low]]), last + float(seen.duration_s[high - 1])))
    return out


def find_jumps(recording: Recording, seen: Innovations) -> list[MaskedStretch]:
    """Find references that jump and that the gyro does not confirm: groups of false ones, and jumps that stay."""
    if len(seen.values) <= WANDER_STEPS:
        return []
    t_s, sample_s, usual_s = recording.attitudes.t_s, recording.gyro.sample_s, float(np.median(seen.duration_s))
    size = np.linalg.norm(seen.values, axis=1)
    ratio = size / seen.sigma.max(axis=1)
    late_s = max(float(np.quantile(seen.duration_s, LATE_QUANTILE)), sample_s)
    able = _is_beyond_turn(seen, size, late_s) & (seen.duration_s < UNEVEN_STEP * usual_s)
    moved = np.cumsum(seen.values, axis=0)
    wander = WANDERS * float(np.median(np.linalg.norm(moved[WANDER_STEPS:] - moved[:-WANDER_STEPS], axis=1)))
    out, last, others = list[MaskedStretch](), -1, 0
    for k in np.flatnonzero(ratio > GROUP_SIGMAS).tolist():
        if k <= last:
            continue
        length = _find_group_length(recording, seen, k) if able[k] else 0
        alone = _is_isolated(size, k, length)
        others += not (length and alone)
        if not able[k] or not alone:
            continue
        axis, angle = "xyz"[int(np.argmax(np.abs(seen.values[k])))], float(np.rad2deg(size[k]))
        if length:
            first, stop = (float(t_s[seen.second[j]]) for j in (k, k + length))
            out.append(MaskedStretch("reference jump", axis, first, stop, angle))
            last = k + length
        elif size[k] > wander and usual_s < DENSE_SAMPLES * sample_s:
            middle = 0.5 * float(t_s[seen.first[k]] + t_s[seen.second[k]])
            out.append(MaskedStretch("reference jump", axis, middle, middle, angle))
    # Where references are sparse, errors of the gyro leave and do not return, but two in a row may undo each other by chance.
    is_chance = usual_s >= DENSE_SAMPLES * sample_s and len(out) <= others
    return [] if is_chance or len(out) > MOST_LOST * len(size) else out


def _is_beyond_turn(seen: Innovations, size: Array, late_s: float) -> Mask:
    """Whether each innovation (k,) is more than a late frame or a jump of the gyro's own reading would make."""
    rate = seen.turned / seen.duration_s[:, None]
    before, after = np.roll(rate, 1, axis=0), np.roll(rate, -1, axis=0)
    turn = late_s * np.max([np.linalg.norm(one, axis=1) for one in (before, rate, after)], axis=0)
    uneven = np.linalg.norm(rate - 0.5 * (before + after), axis=1) * seen.duration_s
    direction = rate / np.maximum(np.linalg.norm(rate, axis=1, keepdims=True), 1e-300)
    across = np.linalg.norm(np.cross(seen.values, direction), axis=1)
    return np.asarray(((size > turn) | ((across > ACROSS * size) & (size > ACROSS * turn))) & (uneven < EVEN_SHARE * size))


def _is_isolated(size: Array, k: int, length: int) -> bool:
    """Whether an innovation is far beyond those before it and those after the group that it begins."""
    beside = np.concatenate([size[max(k - AROUND, 0) : k], size[k + length + 1 : k + length + 1 + AROUND]])
    return bool(beside.size and size[k] > ISOLATION * float(np.quantile(beside, MOST_AROUND)))


def _find_group_length(recording: Recording, seen: Innovations, k: int) -> int:
    """Number of references of the group that begins with a step: after as many the next one fits again; 0 for none."""
    q = recording.attitudes.quaternions
    begin = float(np.sum((seen.values[k] / seen.sigma[k]) ** 2))
    for length, turn in enumerate(_join_turns(seen, k)):
        if not length:
            continue
        left = compute_misses(q[seen.first[[k]]], turn[None], q[seen.second[[k + length]]])[0] / seen.sigma[k + length]
        if float(left @ left) < max(RETURNED_CHI2, RETURNED_SHARE**2 * begin):
            return length
    return 0


def _join_turns(seen: Innovations, k: int) -> Iterator[Array]:
    """Rotation vectors of the body from the begin of step k to the end of it and of each that follows, as far as they join."""
    turn = Rotation.identity()
    for j in range(k, min(k + LONGEST_GROUP + 1, len(seen.values))):
        if j > k and seen.first[j] != seen.second[j - 1]:
            return
        turn = turn * Rotation.from_rotvec(seen.turned[j])
        yield np.asarray(turn.as_rotvec())
