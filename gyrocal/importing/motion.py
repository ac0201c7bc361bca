"""Mean rates by gyro and by attitudes over the same windows, whatever way either is read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array

WINDOWS = 60  # at least so many in a recording, as far as there are attitudes
MOST_WINDOWS = 4000
GYRO_GAP_SAMPLES = 3.0  # samples, beyond which the gyro's rate is not known
HALF = 0.5  # of the misfit's square, whose shortest time is said
FEWEST_BIAS_WINDOWS = 8  # to tell a bias from other errors
MOST_LEFT_BY_BIAS = 0.1  # of the misfit's square: a step of the bias leaves more, unless it is near an end
MOST_WINDOW_TURN = np.deg2rad(20.0)  # of a window: the mean rate of more is not that of the axes at its ends


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

    def attitudes(self, reverse: bool = False) -> Array:
        """Mean body rates (n, 3) of the attitudes, or of those of the other direction."""
        turned = Rotation.from_quat(self.q)
        if reverse:
            turned = turned.inv()
        # A is the inverse of scipy's rotation, and A(t + Δt) Aᵀ = exp(−[ω×]Δt).
        body = turned[self.rows[:, 0]].inv() * turned[self.rows[:, 1]]
        return np.asarray(body.as_rotvec() / (self.stop_s - self.start_s)[:, None])

    def move_tags(self, offset_s: float, factor: float, accumulated: bool) -> Motion | None:
        """Windows with an offset added to the attitudes' tags and the gyro's tags times a factor about the first.

        accumulated: whether the rates are differences of an angle, which the factor does not change
        """
        edges = self.t_s[0] + factor * (self.t_s - self.t_s[0])
        return build_windows(edges, self.angle if accumulated else factor * self.angle, self.t_ref + offset_s, self.q)


def integrate_rates(t_s: Array, rates: Array, sample_s: float) -> tuple[Array, Array]:
    """Edges (n + 1,) of samples, s, and the integral (n + 1, 3) of their rates up to each, rad."""
    edges = np.append(t_s, t_s[-1] + sample_s)
    return edges, np.concatenate([np.zeros((1, 3)), np.cumsum(rates * np.diff(edges)[:, None], axis=0)])


def rotate_onto(reference: Array, rates: Array, mirrored: bool = False) -> tuple[Array, float]:
    """Orthogonal C (3, 3) with Σ|reference − C rates|² least, which may be a reflection, and tr(Cᵀ Σ reference ratesᵀ) of it.

    Source: Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.
    """
    U, values, Vt = np.linalg.svd(reference.T @ rates)
    signs = np.array([1.0, 1.0, 1.0 if mirrored else np.sign(np.linalg.det(U @ Vt))])
    return np.asarray(U * signs @ Vt), float(values @ signs)


def build_motion(t_s: Array, rates: Array, sample_s: float, t_ref: Array, q: Array, count: int = WINDOWS) -> Motion | None:
    """Windows of rates (n, 3), rad/s, and attitudes, as `build_windows` chooses them.

    t_s: (n,) tags of the gyro, s
    """
    return build_windows(*integrate_rates(t_s, rates, sample_s), t_ref, q, count)


def build_windows(edges: Array, angle: Array, t_ref: Array, q: Array, count: int = WINDOWS) -> Motion | None:
    """Windows over what both sides cover; None if there are too few.

    edges (n,) s and angle (n, 3) rad are of the gyro, t_ref (m,) and q (m, 4), inertial to body, of the attitudes. There are
    count windows side by side, or as many as let none turn by more than `MOST_WINDOW_TURN`.
    """
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


def locate_misfit(windows: Motion) -> str:
    """The shortest stretch of time with half of the misfit's square, in words."""
    gyro, inside = windows.gyro()
    e = (windows.attitudes() - gyro)[inside]
    start, stop = windows.start_s[inside], windows.stop_s[inside]
    square = np.sum(np.square(e - np.median(e, axis=0)), axis=1)
    if not square.sum() > 0:
        return ""
    total = np.concatenate([[0.0], np.cumsum(square)]) / square.sum()
    ends = np.minimum(np.searchsorted(total, total[:-1] + HALF), square.size)
    good = total[ends] >= total[:-1] + HALF - 1e-9
    length = np.where(good, stop[np.maximum(ends - 1, 0)] - start, np.inf)
    k = int(np.argmin(length))
    first, last = float(start[k]), float(stop[max(ends[k] - 1, 0)])
    whole = float(stop[-1] - start[0])
    return f"half of the misfit lies between {first:.6g} and {last:.6g} s, {100 * (last - first) / whole:.0f} % of the time"


def estimate_constant_bias(windows: Motion) -> Array | None:
    """The bias (3,), rad/s, that the rates lack, if a constant one explains most of the misfit."""
    gyro, inside = windows.gyro()
    e = (windows.attitudes() - gyro)[inside]
    bias = e.mean(axis=0)
    if len(e) < FEWEST_BIAS_WINDOWS or not np.sum(np.square(e - bias)) <= MOST_LEFT_BY_BIAS * np.sum(np.square(e)):
        return None
    return np.asarray(bias)
