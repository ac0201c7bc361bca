"""Mean rates by gyro and by attitudes over the same windows, whatever way either is read."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array

QUATERNION_INDICES = (0, 1, 2, 3)  # of a quaternion, in the order in which they are read
WINDOWS = 60  # at least so many in a recording, as far as there are attitudes
MOST_WINDOWS = 4000
GYRO_GAP_SAMPLES = 3.0  # samples, beyond which the gyro's rate is not known
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

    def attitudes(
        self, order: tuple[int, ...] = QUATERNION_INDICES, reverse: bool = False, reversed_before: bool = False
    ) -> Array:
        """Mean body rates (n, 3) of the attitudes, with the elements of the quaternions in another order on file, or reversed.

        reversed_before: whether the quaternions on file have been conjugated to be these
        """
        conjugate = np.array([-1.0, -1.0, -1.0, 1.0]) if reversed_before else np.ones(4)
        turned = Rotation.from_quat((self.q * conjugate)[:, order] * conjugate)
        if reverse:
            turned = turned.inv()
        # A is the inverse of scipy's rotation, and A(t + Δt) Aᵀ = exp(−[ω×]Δt).
        body = turned[self.rows[:, 0]].inv() * turned[self.rows[:, 1]]
        return np.asarray(body.as_rotvec() / (self.stop_s - self.start_s)[:, None])


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
    """Windows over what both sides cover; None if there are too few.

    t_s (n,) and rates (n, 3) rad/s are of the gyro, t_ref (m,) and q (m, 4), inertial to body, of the attitudes. There are
    count windows side by side, or as many as let none turn by more than `MOST_WINDOW_TURN`.
    """
    edges, angle = integrate_rates(t_s, rates, sample_s)
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
