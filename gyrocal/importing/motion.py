"""Mean rates by gyro and by attitudes over the same windows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array

WINDOWS = 60  # fewest in a recording with sufficient attitudes
MOST_WINDOWS = 4000
GYRO_GAP_SAMPLES = 3.0  # samples: over a longer step the gyro's rate is unknown
MISFIT_SHARE = 0.5  # of the misfit's square, whose shortest stretch of time is located
FEWEST_BIAS_WINDOWS = 8  # to separate a bias from other errors
MOST_LEFT_BY_BIAS = 0.1  # of the misfit's square: a step of the bias leaves more, unless it is near an end
MOST_WINDOW_TURN = np.deg2rad(20.0)  # rotation in a window: above it the mean rate is not that about the axes at its ends


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
        """Whether the body rotates too far in most windows for a mean rate about the axes at their ends."""
        gyro, inside = self.compute_gyro_rates()
        if not inside.any():
            return False
        # A large bias of the gyro is no rotation of the body.
        body = gyro[inside] - (gyro - self.compute_attitude_rates())[inside].mean(axis=0)
        turn = np.linalg.norm(body, axis=1) * (self.stop_s - self.start_s)[inside]
        return turn.size > 0 and float(np.median(turn)) > MOST_WINDOW_TURN

    def compute_gyro_rates(self) -> tuple[Array, NDArray[np.bool_]]:
        """Compute the mean rates (n, 3) of the gyro, rad/s, and the windows that it covers."""
        return self.average_gyro_rates(self.start_s, self.stop_s)

    def average_gyro_rates(self, first_s: Array, last_s: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Compute the gyro's mean rates (n, 3) between times (n,) by its tags, rad/s, and whether it has samples throughout."""
        sample_s, lost_s = self._gaps
        turn = np.stack([np.interp(last_s, self.t_s, x) - np.interp(first_s, self.t_s, x) for x in self.angle.T], axis=1)
        covered = (first_s >= self.t_s[0]) & (last_s <= self.t_s[-1])
        if lost_s[-1] > 0:
            covered &= np.interp(last_s, self.t_s, lost_s) - np.interp(first_s, self.t_s, lost_s) <= sample_s
        return turn / (last_s - first_s)[:, None], covered

    @cached_property
    def _gaps(self) -> tuple[float, Array]:
        """Length of a sample, s, and the time (n,) that the gyro has been without samples up to each tag, s."""
        steps = np.diff(self.t_s)
        sample_s = float(np.median(steps))
        return sample_s, np.append(0.0, np.cumsum(np.where(steps > GYRO_GAP_SAMPLES * sample_s, steps, 0.0)))

    def compute_attitude_rates(self, reverse: bool = False) -> Array:
        """Compute the mean body rates (n, 3) of the attitudes, or of their inverses, rad/s."""
        attitudes = Rotation.from_quat(self.q)
        if reverse:
            attitudes = attitudes.inv()
        # A is the inverse of scipy's rotation, and A(t + Δt) Aᵀ = exp(−[ω×]Δt).
        body = attitudes[self.rows[:, 0]].inv() * attitudes[self.rows[:, 1]]
        return np.asarray(body.as_rotvec() / (self.stop_s - self.start_s)[:, None])

    def move_tags(self, offset_s: float, factor: float, accumulated: bool) -> Motion | None:
        """Build the windows with an offset added to the attitudes' tags and the gyro's tags times a factor about the first.

        accumulated: whether the rates are differences of an angle, which the factor does not change
        """
        edges = self.t_s[0] + factor * (self.t_s - self.t_s[0])
        return build_windows(edges, self.angle if accumulated else factor * self.angle, self.t_ref + offset_s, self.q)


def integrate_rates(t_s: Array, rates: Array, sample_s: float) -> tuple[Array, Array]:
    """Integrate rates (n, 3); return the edges (n + 1,) of the samples, s, and the integral (n + 1, 3) up to each, rad."""
    edges = np.append(t_s, t_s[-1] + sample_s)
    return edges, np.concatenate([np.zeros((1, 3)), np.cumsum(rates * np.diff(edges)[:, None], axis=0)])


def rotate_onto(reference: Array, rates: Array, mirrored: bool = False) -> tuple[Array, float]:
    """Fit the orthogonal C (3, 3) with the least Σ|reference − C rates|²; also return its tr(Cᵀ Σ reference ratesᵀ).

    mirrored: whether C may be a reflection

    Source: Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.
    """
    U, values, Vt = np.linalg.svd(reference.T @ rates)
    signs = np.array([1.0, 1.0, 1.0 if mirrored else np.sign(np.linalg.det(U @ Vt))])
    return np.asarray(U * signs @ Vt), float(values @ signs)


def build_motion(t_s: Array, rates: Array, sample_s: float, t_ref: Array, q: Array, count: int = WINDOWS) -> Motion | None:
    """Build the windows of rates (n, 3), rad/s, and attitudes, see `build_windows`.

    t_s: (n,) tags of the gyro, s
    """
    return build_windows(*integrate_rates(t_s, rates, sample_s), t_ref, q, count)


def build_windows(edges: Array, angle: Array, t_ref: Array, q: Array, count: int = WINDOWS) -> Motion | None:
    """Build windows over the common time of gyro and attitudes; None if there are too few.

    edges (n,) s and angle (n, 3) rad are of the gyro, t_ref (m,) and q (m, 4), inertial to body, of the attitudes. There are
    count windows side by side, or more, so that the rotation in each is at most `MOST_WINDOW_TURN`.
    """
    inside = np.flatnonzero((t_ref >= edges[0]) & (t_ref <= edges[-1]))
    if inside.size < 4:
        return None
    step = float(np.median(np.diff(t_ref[inside])))
    attitudes = Rotation.from_quat(q[inside])
    speed = np.percentile((attitudes[:-1].inv() * attitudes[1:]).magnitude() / np.diff(t_ref[inside]), 90)
    length = min(MOST_WINDOW_TURN / max(float(speed), 1e-12), (t_ref[inside[-1]] - t_ref[inside[0]]) / count)
    stride = max(int(length / step), 1)
    first, last = inside[:-stride], inside[stride:]
    is_contiguous = t_ref[last] - t_ref[first] < 1.5 * stride * step
    if is_contiguous.sum() < 3:
        return None
    selected = np.flatnonzero(is_contiguous)
    selected = selected[:: max(selected.size // MOST_WINDOWS, 1)]
    rows = np.stack([first[selected], last[selected]], axis=1)
    return Motion(t_ref[rows[:, 0]], t_ref[rows[:, 1]], rows, edges, angle, t_ref, q)


def locate_misfit(windows: Motion) -> str:
    """Describe the shortest stretch of time with half of the misfit's square; empty without a misfit."""
    gyro, inside = windows.compute_gyro_rates()
    difference = (windows.compute_attitude_rates() - gyro)[inside]
    start, stop = windows.start_s[inside], windows.stop_s[inside]
    square = np.sum(np.square(difference - np.median(difference, axis=0)), axis=1)
    if not square.sum() > 0:
        return ""
    total = np.concatenate([[0.0], np.cumsum(square)]) / square.sum()
    # The end of the shortest stretch from each window on; none if the rest of the time has less than the share.
    ends = np.minimum(np.searchsorted(total, total[:-1] + MISFIT_SHARE), square.size)
    good = total[ends] >= total[:-1] + MISFIT_SHARE - 1e-9
    length = np.where(good, stop[np.maximum(ends - 1, 0)] - start, np.inf)
    k = int(np.argmin(length))
    first, last = float(start[k]), float(stop[max(ends[k] - 1, 0)])
    duration = float(stop[-1] - start[0])
    return f"half of the misfit lies between {first:.6g} and {last:.6g} s, {100 * (last - first) / duration:.0f} % of the time"


def estimate_constant_bias(windows: Motion) -> Array | None:
    """Estimate the bias (3,), rad/s, missing in the rates if a constant one explains most of the misfit; None otherwise."""
    gyro, inside = windows.compute_gyro_rates()
    difference = (windows.compute_attitude_rates() - gyro)[inside]
    bias = difference.mean(axis=0)
    before, after = np.sum(np.square(difference)), np.sum(np.square(difference - bias))
    if len(difference) < FEWEST_BIAS_WINDOWS or not after <= MOST_LEFT_BY_BIAS * before:
        return None
    return np.asarray(bias)
