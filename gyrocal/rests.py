"""Rests of the body: where they are, the bias in each, and the speed of the body by the attitudes."""

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from gyrocal.mask_runs import find_mask_runs

REST_WINDOW_S = 0.5  # in which the scatter of the rates separates rest from motion
FEWEST_REST_SAMPLES = 5  # samples in it
QUIET = 2.5  # times the quietest scatter
REST_SPEED_SHARE = 0.02  # of the motion: by the attitudes a body that turns slower is at rest
SHORTEST_REST_S = 3.0
SPEED_S = 1.0
REST_PARTS = 8  # of each rest, whose means give the noise of the whole mean, slow noise included
REST_SIGMAS = 7.0  # of the difference of two means: by chance once in 10⁵, of two rests


def find_rests(rates: Array, sample_s: float, speed: Array) -> list[tuple[int, int]]:
    """Find stretches of samples at rest: the rates scatter as little as anywhere, and the attitudes do not turn.

    Parameters
    ----------
    rates : (n, 3) rad/s
    speed : (n,) magnitude of the body rate by the attitudes about each sample, rad/s
    """
    size = max(round(REST_WINDOW_S / sample_s), FEWEST_REST_SAMPLES)
    count = len(rates) // size
    if count < 4:
        return []
    parts = rates[: count * size].reshape(count, size, 3)
    scatter = np.sqrt(np.mean(parts.var(axis=1), axis=1))
    turning = np.array([np.median(part) for part in speed[: count * size].reshape(count, size)])
    motion = float(np.sqrt(np.mean(np.square(speed))))
    still = (scatter <= QUIET * np.percentile(scatter, 5)) & (turning <= REST_SPEED_SHARE * motion)
    out = []
    for first, stop in find_mask_runs(still):
        # A window at either end may hold the beginning of a motion.
        begin, end = (first + 1) * size, (stop - 1) * size
        if (end - begin) * sample_s >= SHORTEST_REST_S:
            out.append((begin, end))
    return out


def compare_rests(t_s: Array, rates: Array, rests: list[tuple[int, int]]) -> tuple[str, Array]:
    """Compare the biases at rest: text on the two that differ by most sigmas, empty if none do, and the change (3,), rad/s.

    Parameters
    ----------
    t_s, rates : of the samples, (n,) s and (n, 3) rad/s
    rests : of `find_rests`
    """
    if len(rests) < 2:
        return "", np.zeros(3)
    rest_rates = np.concatenate([rates[first:stop] for first, stop in rests])
    part_means = np.array([[part.mean(axis=0) for part in np.array_split(rates[a:b], REST_PARTS)] for a, b in rests])
    bias, samples = -part_means.mean(axis=1), np.diff(rests)
    density = np.mean(part_means.var(axis=1, ddof=1) / REST_PARTS * samples, axis=0)  # variance of a mean times its samples
    rounding = np.array([np.diff(np.unique(x)).min(initial=np.inf) for x in rest_rates.T])
    floor = np.where(np.isfinite(rounding), np.square(rounding), 1.0) / 12
    change = bias[:, None] - bias
    sigmas = np.abs(change) / np.sqrt(density * (1 / samples[:, None] + 1 / samples) + floor)
    earlier, later, axis = (int(k) for k in np.unravel_index(np.argmax(sigmas), sigmas.shape))
    if sigmas[earlier, later, axis] < REST_SIGMAS:
        return "", np.zeros(3)
    earlier, later = sorted((earlier, later))
    values = [f"{np.rad2deg(bias[k, axis]):.4g} deg/s in that at {t_s[rests[k][0]]:.6g} s" for k in (earlier, later)]
    separation = f"{sigmas[earlier, later, axis]:.2g} sigmas apart"
    text = f"bias differs between rests: b_{'xyz'[axis]} is {values[0]} and {values[1]}, {separation}"
    return text, np.asarray(change[earlier, later])


def compute_speed(t_ref: Array, q: Array, t_s: Array) -> Array:
    """Compute the body's speed (n,) at the gyro's tags, rad/s, from attitudes `SPEED_S` apart: their noise is negligible.

    Parameters
    ----------
    t_ref, q : (m,) s and (m, 4) A(q)
    t_s : (n,) s
    """
    later = np.minimum(np.searchsorted(t_ref, t_ref + SPEED_S), t_ref.size - 1)
    rows = np.flatnonzero(later > np.arange(later.size))
    attitudes = Rotation.from_quat(q)
    elapsed = t_ref[later[rows]] - t_ref[rows]
    speed = (attitudes[rows].inv() * attitudes[later[rows]]).magnitude() / elapsed
    return np.interp(t_s, t_ref[rows] + 0.5 * elapsed, speed)
