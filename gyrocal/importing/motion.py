"""Mean rates by gyro and by attitudes over the same windows, whatever way either is read, and rests of the body."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.mask_runs import find_mask_runs

Array = NDArray[np.float64]

QUATERNION_INDICES = (0, 1, 2, 3)  # of a quaternion, in the order in which they are read
WINDOWS = 60  # at least so many in a recording, as far as there are attitudes
MOST_WINDOWS = 4000
GYRO_GAP_SAMPLES = 3.0  # samples, beyond which the gyro's rate is not known
MOST_WINDOW_TURN = np.deg2rad(20.0)  # of a window: the mean rate of more is not that of the axes at its ends
REST_WINDOW_S = 0.5  # in which the scatter of the rates tells rest from motion
FEWEST_REST_SAMPLES = 5  # samples in it
QUIET = 2.5  # times the quietest scatter
REST_SPEED_SHARE = 0.02  # of the motion: a body that turns slower is at rest, as far as the attitudes tell
SHORTEST_REST_S = 3.0
SPEED_S = 1.0
REST_PARTS = 8  # of each rest, whose means tell the noise of the whole mean, slow noise included
REST_SIGMAS = 7.0  # of the difference of two means: by chance once in 10⁵, of two rests


@dataclass(frozen=True)
class Motion:
    """Mean rates by both sides over windows."""

    # start_s, stop_s: (n,) of the windows
    start_s: Array
    stop_s: Array
    rows: NDArray[np.intp]  # (n, 2) attitudes at their ends
    # t_s, angle: gyro tags with the end of the last sample, and the integral of the rates (., 3) up to each
    t_s: Array
    angle: Array
    # t_ref, q: (m,) s and (m, 4) of all attitudes, inertial to body, scalar last
    t_ref: Array
    q: Array

    @property
    def is_coarse(self) -> bool:
        """Whether most windows turn too far for their mean rate to be that of the axes at their ends."""
        gyro, inside = self.gyro()
        if not inside.any():
            return False
        # A large bias of the gyro is no turn of the body.
        body = gyro[inside] - (gyro - self.attitudes())[inside].mean(axis=0)
        turn = np.linalg.norm(body, axis=1) * (self.stop_s - self.start_s)[inside]
        return turn.size > 0 and float(np.median(turn)) > MOST_WINDOW_TURN

    def gyro(self, offset_s: float = 0.0) -> tuple[Array, NDArray[np.bool_]]:
        """Mean rates (n, 3) of the gyro, its tags offset, and the windows that it covers."""
        return self.measure(self.start_s + offset_s, self.stop_s + offset_s)

    def measure(self, a: Array, b: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Mean rates (n, 3) of the gyro from times a to b (n,) by its tags, and whether it has samples all the while."""
        sample_s, lost_s = self._gaps
        turn = np.stack([np.interp(b, self.t_s, x) - np.interp(a, self.t_s, x) for x in self.angle.T], axis=1)
        covered = (a >= self.t_s[0]) & (b <= self.t_s[-1])
        if lost_s[-1] > 0:
            covered &= np.interp(b, self.t_s, lost_s) - np.interp(a, self.t_s, lost_s) <= sample_s
        return turn / (b - a)[:, None], covered

    @cached_property
    def _gaps(self) -> tuple[float, Array]:
        """Length of a sample, s, and the time (n,) that the gyro has been without samples up to each tag, s."""
        steps = np.diff(self.t_s)
        sample_s = float(np.median(steps))
        return sample_s, np.append(0.0, np.cumsum(np.where(steps > GYRO_GAP_SAMPLES * sample_s, steps, 0.0)))

    def attitudes(
        self, order: tuple[int, ...] = QUATERNION_INDICES, reverse: bool = False, reversed_before: bool = False
    ) -> Array:
        """Mean body rates (n, 3) of the attitudes, read in another way.

        Parameters
        ----------
        order : places of the elements of the quaternions on file
        reverse : whether the direction is the other one
        reversed_before : whether the quaternions on file have been conjugated to be these
        """
        conjugate = np.array([-1.0, -1.0, -1.0, 1.0]) if reversed_before else np.ones(4)
        turned = Rotation.from_quat((self.q * conjugate)[:, order] * conjugate)
        if reverse:
            turned = turned.inv()
        # A is the inverse of scipy's rotation, and A(t + Δt) Aᵀ = exp(−[ω×]Δt).
        body = turned[self.rows[:, 0]].inv() * turned[self.rows[:, 1]]
        return np.asarray(body.as_rotvec() / (self.stop_s - self.start_s)[:, None])


def rotate_onto(reference: Array, rates: Array, mirrored: bool = False) -> tuple[Array, float]:
    """Orthogonal C (3, 3) with Σ|reference − C rates|² least, and tr(Cᵀ Σ reference ratesᵀ) of it.

    Source: Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.

    Parameters
    ----------
    reference, rates : (n, 3)
    mirrored : whether C may be a reflection
    """
    U, values, Vt = np.linalg.svd(reference.T @ rates)
    signs = np.array([1.0, 1.0, 1.0 if mirrored else np.sign(np.linalg.det(U @ Vt))])
    return np.asarray(U * signs @ Vt), float(values @ signs)


def build_motion(t_s: Array, rates: Array, sample_s: float, t_ref: Array, q: Array, count: int = WINDOWS) -> Motion | None:
    """Windows over what both sides cover; None if there are too few.

    Parameters
    ----------
    t_s, rates, sample_s : gyro tags (n,), raw or adjusted rates (n, 3) rad/s, length of a sample
    t_ref, q : attitudes, (m,) s and (m, 4) inertial to body, scalar last
    count : of windows side by side, as far as none turns by more than `MOST_WINDOW_TURN`
    """
    edges = np.append(t_s, t_s[-1] + sample_s)
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(rates * np.diff(edges)[:, None], axis=0)])
    inside = np.flatnonzero((t_ref >= edges[0]) & (t_ref <= edges[-1]))
    if inside.size < 4:
        return None
    step = float(np.median(np.diff(t_ref[inside])))
    turned = Rotation.from_quat(q[inside])
    speed = np.percentile((turned[:-1].inv() * turned[1:]).magnitude() / np.diff(t_ref[inside]), 90)
    length = min(MOST_WINDOW_TURN / max(float(speed), 1e-12), (t_ref[inside[-1]] - t_ref[inside[0]]) / count)
    stride = max(int(length / step), 1)
    first, last = inside[:-stride], inside[stride:]
    whole = t_ref[last] - t_ref[first] < 1.5 * stride * step
    if whole.sum() < 3:
        return None
    chosen = np.flatnonzero(whole)
    chosen = chosen[:: max(chosen.size // MOST_WINDOWS, 1)]
    rows = np.stack([first[chosen], last[chosen]], axis=1)
    return Motion(t_ref[rows[:, 0]], t_ref[rows[:, 1]], rows, edges, angle, t_ref, q)


def find_rests(rates: Array, sample_s: float, speed: Array) -> list[tuple[int, int]]:
    """Stretches of samples at rest: the rates scatter as little as anywhere, and the attitudes do not turn.

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
        a, b = (first + 1) * size, (stop - 1) * size
        if (b - a) * sample_s >= SHORTEST_REST_S:
            out.append((a, b))
    return out


def compare_rests(t_s: Array, rates: Array, rests: list[tuple[int, int]]) -> tuple[str, Array]:
    """Compare the biases at rest: say which two differ by most sigmas, if they do, and by how much, (3,) rad/s.

    Parameters
    ----------
    t_s, rates : of the samples, (n,) s and (n, 3) rad/s
    rests : of `find_rests`
    """
    if len(rests) < 2:
        return "", np.zeros(3)
    whole = np.concatenate([rates[first:stop] for first, stop in rests])
    parts = np.array([[part.mean(axis=0) for part in np.array_split(rates[a:b], REST_PARTS)] for a, b in rests])
    bias, length = -parts.mean(axis=1), np.diff(rests)
    density = np.mean(parts.var(axis=1, ddof=1) / REST_PARTS * length, axis=0)  # variance of a mean times its samples
    rounding = np.array([np.diff(np.unique(x)).min(initial=np.inf) for x in whole.T])
    floor = np.where(np.isfinite(rounding), np.square(rounding), 1.0) / 12
    change = bias[:, None] - bias
    sigmas = np.abs(change) / np.sqrt(density * (1 / length[:, None] + 1 / length) + floor)
    one, other, axis = (int(k) for k in np.unravel_index(np.argmax(sigmas), sigmas.shape))
    if sigmas[one, other, axis] < REST_SIGMAS:
        return "", np.zeros(3)
    one, other = sorted((one, other))
    values = [f"{np.rad2deg(bias[k, axis]):.4g} deg/s in that at {t_s[rests[k][0]]:.6g} s" for k in (one, other)]
    apart = f"{sigmas[one, other, axis]:.2g} sigmas apart"
    text = f"bias differs between rests: b_{'xyz'[axis]} is {values[0]} and {values[1]}, {apart}"
    return text, np.asarray(change[one, other])


def compute_speed(t_ref: Array, q: Array, t_s: Array) -> Array:
    """Compute the body's speed (n,) at the gyro's tags, rad/s, from attitudes `SPEED_S` apart: their noise is negligible.

    Parameters
    ----------
    t_ref, q : (m,) s and (m, 4) A(q)
    t_s : (n,) s
    """
    later = np.minimum(np.searchsorted(t_ref, t_ref + SPEED_S), t_ref.size - 1)
    rows = np.flatnonzero(later > np.arange(later.size))
    turned = Rotation.from_quat(q)
    elapsed = t_ref[later[rows]] - t_ref[rows]
    found = (turned[rows].inv() * turned[later[rows]]).magnitude() / elapsed
    return np.interp(t_s, t_ref[rows] + 0.5 * elapsed, found)
