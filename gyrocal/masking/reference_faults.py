"""Reference attitudes that freeze or jump, by the innovations that a gyro propagates from one to the next.

A camera that swaps markers has an error in single frames, or in all later frames. In the innovations (`gyrocal.innovations`) a
group of false references leaves and returns, and the reference after it fits the one before it. A lasting jump is an innovation
far beyond those around it. Errors of the gyro may look alike if references are far apart, since an innovation then sums the
errors of many samples. A lasting jump therefore counts only if references are about as dense as samples. In both cases the jump
has to be larger than the rotation of the body from one reference to the next, which is the largest effect of a late or repeated
frame, or to have another axis; and the gyro's own rate has to be steady.
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

FEWEST_REPEATS = 2  # successive repeats; a single one may be a tag that was read twice
FREEZE_TURN_SIGMAS = 8.0  # sigmas of an innovation that the body rotates during repeats
GROUP_SIGMAS = 12.0  # of the first innovation of a group, beyond the tails of any sensor's noise
LONGEST_GROUP = 3  # references
RETURNED_CHI2 = 25.0  # χ² of three axes over the whole group, which noise exceeds once in 10⁵
RETURNED_SHARE = 0.1  # of the first innovation that may remain over a group, by errors of the gyro's calibration
WANDER_STEPS = 20  # steps over which the difference of references and gyro is measured
WANDER_RATIO = 2.0  # times its median: the sigma of the references covers smaller lasting jumps; a cut costs an attitude
DENSE_SAMPLES = 3.5  # gyro samples from one reference to the next, up to which a lasting jump counts
NEIGHBOUR_STEPS = 5  # steps before and after an innovation that it is compared with
ISOLATION_RATIO = 5.0  # of an isolated innovation to the quantile of its neighbours
NEIGHBOUR_QUANTILE = 0.7
UNEVEN_STEP = 1.5  # usual spacings; over a longer time errors of the gyro add up
EVEN_SHARE = 0.5  # of the innovation: largest difference of the gyro's own rotation from those beside it
LATE_QUANTILE = 0.95  # of the times from one reference to the next: the largest delay of a frame
ACROSS_SHARE = 0.5  # of an innovation across the rotation of the body, which no error of the time tags causes
MOST_FALSE_SHARE = 0.05  # of the references: more jumps are no faults


def find_frozen(recording: Recording, innovations: Innovations) -> list[MaskedStretch]:
    """Find runs of references that agree to the last digit while the gyro turns."""
    t_s, q = recording.attitudes.t_s, recording.attitudes.quaternions
    out = []
    for low, high in find_mask_runs((q[innovations.first] == q[innovations.second]).all(axis=1)):
        rotation = float(np.linalg.norm(np.cumsum(innovations.turned[low:high], axis=0), axis=1).max())
        if high - low >= FEWEST_REPEATS and rotation > FREEZE_TURN_SIGMAS * float(innovations.sigma[low:high].max()):
            last = float(t_s[innovations.second[high - 1]]) + float(innovations.duration_s[high - 1])
            out.append(MaskedStretch("frozen", None, float(t_s[innovations.second[low]]), last))
    return out


def find_jumps(recording: Recording, innovations: Innovations) -> list[MaskedStretch]:
    """Find jumps of the references that the gyro does not confirm: groups of false references, and lasting jumps."""
    if len(innovations.values) <= WANDER_STEPS:
        return []
    t_s, sample_s, usual_s = recording.attitudes.t_s, recording.gyro.sample_s, float(np.median(innovations.duration_s))
    size = np.linalg.norm(innovations.values, axis=1)
    ratio = size / innovations.sigma.max(axis=1)
    late_s = max(float(np.quantile(innovations.duration_s, LATE_QUANTILE)), sample_s)
    is_candidate = _is_beyond_turn(innovations, size, late_s) & (innovations.duration_s < UNEVEN_STEP * usual_s)
    drift = np.cumsum(innovations.values, axis=0)
    wander = WANDER_RATIO * float(np.median(np.linalg.norm(drift[WANDER_STEPS:] - drift[:-WANDER_STEPS], axis=1)))
    out, last, unreturned = list[MaskedStretch](), -1, 0
    for k in np.flatnonzero(ratio > GROUP_SIGMAS).tolist():
        if k <= last:
            continue
        length = _find_group_length(recording, innovations, k) if is_candidate[k] else 0
        is_isolated = _is_isolated(size, k, length)
        unreturned += not (length and is_isolated)
        if not is_candidate[k] or not is_isolated:
            continue
        axis, angle = "xyz"[int(np.argmax(np.abs(innovations.values[k])))], float(np.rad2deg(size[k]))
        if length:
            first, stop = (float(t_s[innovations.second[j]]) for j in (k, k + length))
            out.append(MaskedStretch("reference jump", axis, first, stop, angle))
            last = k + length
        elif size[k] > wander and usual_s < DENSE_SAMPLES * sample_s:
            middle = 0.5 * float(t_s[innovations.first[k]] + t_s[innovations.second[k]])
            out.append(MaskedStretch("reference jump", axis, middle, middle, angle))
    # With sparse references, errors of the gyro leave and do not return, but two successive ones may cancel by chance.
    is_chance = usual_s >= DENSE_SAMPLES * sample_s and len(out) <= unreturned
    return [] if is_chance or len(out) > MOST_FALSE_SHARE * len(size) else out


def _is_beyond_turn(innovations: Innovations, size: Array, late_s: float) -> Mask:
    """Whether each innovation (k,) is larger than the effect of a late frame or of a jump of the gyro's own reading."""
    rate = innovations.turned / innovations.duration_s[:, None]
    before, after = np.roll(rate, 1, axis=0), np.roll(rate, -1, axis=0)
    turn = late_s * np.max([np.linalg.norm(rates, axis=1) for rates in (before, rate, after)], axis=0)
    uneven = np.linalg.norm(rate - 0.5 * (before + after), axis=1) * innovations.duration_s
    direction = rate / np.maximum(np.linalg.norm(rate, axis=1, keepdims=True), 1e-300)
    across = np.linalg.norm(np.cross(innovations.values, direction), axis=1)
    is_across = (across > ACROSS_SHARE * size) & (size > ACROSS_SHARE * turn)
    return np.asarray(((size > turn) | is_across) & (uneven < EVEN_SHARE * size))


def _is_isolated(size: Array, k: int, length: int) -> bool:
    """Whether an innovation is far beyond those before it and those after the group that it begins."""
    after = size[k + length + 1 : k + length + 1 + NEIGHBOUR_STEPS]
    neighbours = np.concatenate([size[max(k - NEIGHBOUR_STEPS, 0) : k], after])
    return bool(neighbours.size and size[k] > ISOLATION_RATIO * float(np.quantile(neighbours, NEIGHBOUR_QUANTILE)))


def _find_group_length(recording: Recording, innovations: Innovations, k: int) -> int:
    """Count the references of the group that begins with step k, after which the next one fits again; 0 without a group."""
    q = recording.attitudes.quaternions
    first_chi2 = float(np.sum((innovations.values[k] / innovations.sigma[k]) ** 2))
    for length, turn in enumerate(_join_turns(innovations, k)):
        if not length:
            continue
        first, last = q[innovations.first[[k]]], q[innovations.second[[k + length]]]
        miss = compute_misses(first, turn[None], last)[0] / innovations.sigma[k + length]
        if float(miss @ miss) < max(RETURNED_CHI2, RETURNED_SHARE**2 * first_chi2):
            return length
    return 0


def _join_turns(innovations: Innovations, k: int) -> Iterator[Array]:
    """Yield the rotation vectors of the body from the begin of step k to its end and to that of each step joined to it."""
    turn = Rotation.identity()
    for j in range(k, min(k + LONGEST_GROUP + 1, len(innovations.values))):
        if j > k and innovations.first[j] != innovations.second[j - 1]:
            return
        turn = turn * Rotation.from_rotvec(innovations.turned[j])
        yield np.asarray(turn.as_rotvec())
