"""Batch attitudes as references of the calibrator; they share bias, epoch, and the gyro's own noise.

Let ψ = Aᵀθ be the error of a reference attitude in inertial axes, A_true = A exp([ψ×]) to first order for the estimate A, and
w(t) what the noise of the rates has added by t. The residual of an interval from the reference s to the reference e is, beside
Θ Δx of N (21),

    A_e (−ψ_e + ψ_s + w(t_e) − w(t_s))

The batches give ψ as a linear map of independent noises (`gyrocal.estimation.batch.Errors`), so that the covariance V of all
residuals follows with every correlation:

* Two references of one batch share its epoch and bias. Where both ends of an interval come from one plain batch over the same
  gyro data, the gyro noise cancels altogether, and the residual is a measurement of the bias: V = ΔS P_b ΔSᵀ.
* A batch that overlaps an interval has used the gyro noise the interval is propagated with.
* Intervals that take references from one batch correlate with each other.

`interval_covariance` is the blocks of V on its diagonal, as `gyrocal.calibrate` takes them. It is right where no two
intervals take references from one batch. Where they do, as with arcs that end one maneuver and start the next, the blocks
between them matter, and a calibration needs all of V.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.attitude import quaternion_from_matrix
from gyrocal.errors import InputError
from gyrocal.estimation.batch import BatchResult
from gyrocal.recording import Attitudes, Interval, find_reference_rows


def reference_attitudes(batches: Sequence[BatchResult]) -> Attitudes:
    """Collect the wanted attitudes of all batches in the order of time; sigma is that of each by itself.

    Raises
    ------
    InputError
        None is there, or two are of one time.
    """
    references = _gather_references(batches)
    return Attitudes(references.t, quaternion_from_matrix(references.A), references.sigma)


def residual_covariance(batches: Sequence[BatchResult], intervals: Sequence[Interval], arw: float) -> Array:
    """Compute the covariance V (3m, 3m) of the calibrator's m residuals, rad², interval by interval.

    Parameters
    ----------
    batches : of different measurements; their wanted times are the references
    intervals : each with two or more of these times within
    arw : of the gyro, rad/sqrt(s)
    """
    references = _gather_references(batches)
    t, A = references.t, references.A
    start, end = _find_ends(t, intervals)
    edges = np.unique(np.concatenate([t, *(batch.errors.t_s for batch in batches)]))
    middle, length = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    walk = np.zeros((3 * len(end), len(middle), 3))
    V = np.zeros((3 * len(end), 3 * len(end)))
    for b, estimate in enumerate(batches):
        weights = np.zeros((3 * len(end), len(estimate.joint)))  # residuals by errors of the batch
        for j in range(len(end)):
            for row, sign in ((end[j], -1.0), (start[j], 1.0)):
                if references.batch[row] == b:
                    first = len(estimate.covariance) + 3 * references.number[row]
                    weights[3 * j : 3 * j + 3, first : first + 3] += sign * A[end[j]] @ A[row].T
        V += weights @ estimate.errors.measurements @ weights.T
        overlap = (middle > estimate.errors.t_s[0]) & (middle < estimate.errors.t_s[-1])
        step = np.searchsorted(estimate.errors.t_s, middle[overlap]) - 1
        walk[:, overlap] += (weights @ estimate.errors.walk).transpose(1, 0, 2)[:, step]
    for j in range(len(end)):
        during = (middle > t[start[j]]) & (middle < t[end[j]])
        walk[3 * j : 3 * j + 3, during] += A[end[j]][:, None, :]
    weighted = (walk * (arw * np.sqrt(length))[:, None]).reshape(len(V), -1)
    return np.asarray(V + weighted @ weighted.T)


def interval_covariance(batches: Sequence[BatchResult], intervals: Sequence[Interval], arw: float) -> Array:
    """Compute C (intervals, 3, 3) of each interval's residual, rad², for `gyrocal.calibrate`; the module says when it suffices.

    Raises
    ------
    InputError
        An interval has another number of references than two, its ends.
    """
    t = _gather_references(batches).t
    for interval in intervals:
        count = find_reference_rows(t, interval).size
        if count != 2:
            raise InputError(f"interval {interval.name} has {count} references; a C of its own needs one at each end")
    V = residual_covariance(batches, intervals, arw)
    return np.stack([V[k : k + 3, k : k + 3] for k in range(0, len(V), 3)])


class _References(NamedTuple):
    """Wanted attitudes of all batches, in the order of time."""

    t: Array  # (k,) s
    A: Array  # (k, 3, 3)
    sigma: Array  # (k, 3) rad
    batch: Indices  # (k,) batch of each
    number: Indices  # (k,) its number among the wanted attitudes of the batch


def _gather_references(batches: Sequence[BatchResult]) -> _References:
    """Gather the references of all batches."""
    counts = [batch.t_s.size for batch in batches]
    if not sum(counts):
        raise InputError("no batch has an attitude at a wanted time")
    t = np.concatenate([batch.t_s for batch in batches])
    order = np.argsort(t, kind="stable")
    same = np.flatnonzero(np.diff(t[order]) <= 0)
    if same.size:
        raise InputError(f"two references are of one time, {t[order][same[0]]:g} s; want it of one batch only")
    A = np.concatenate([batch.attitudes for batch in batches])[order]
    sigma = np.concatenate([batch.attitude_sigma for batch in batches])[order]
    number = np.concatenate([np.arange(count) for count in counts])[order]
    return _References(t[order], A, sigma, np.repeat(np.arange(len(batches)), counts)[order], number)


def _find_ends(t: Array, intervals: Sequence[Interval]) -> tuple[Indices, Indices]:
    """Find start and end reference of each residual."""
    start: list[int] = []
    end: list[int] = []
    for interval in intervals:
        rows = find_reference_rows(t, interval)
        if rows.size < 2:
            raise InputError(f"interval {interval.name}: {rows.size} reference(s); at least two are needed")
        start += [int(rows[0])] * (rows.size - 1)
        end += [int(row) for row in rows[1:]]
    return np.array(start), np.array(end)
