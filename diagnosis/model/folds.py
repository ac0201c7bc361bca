"""Folds of a recording: an eighth of each interval held out at a time, and predicted from the rest under M0.

Under M0 all observations are jointly normal: noise with the covariance V, and start attitudes, G and b with broad priors,
Σ = V + N P₀ Nᵀ. Given the training rows t, the rows s held out have the mean Σ_st Σ_tt⁻¹ ζ_t and the covariance
C = Σ_ss − Σ_st Σ_tt⁻¹ Σ_ts (Rasmussen & Williams, Gaussian Processes for Machine Learning, section 2.2). Every interval gives
a part to each fold, so that training sees every motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.linear import Fold
from diagnosis.model.recording import RecordingModel
from gyrocal.calibration.observability import PLAUSIBLE_RANGE

Array = NDArray[np.float64]

PARTS = 8  # of an interval
SPLIT = "an eighth of each interval at a time"
START = 0.02  # rad, prior sigma of a start attitude
BROAD = 10.0  # prior sigma of G and b, in their plausible ranges


def folds(model: RecordingModel, W: Array, part: NDArray[np.intp] | None = None, biases: Array | None = None) -> Iterator[Fold]:
    """Folds of a recording; those that would leave nothing to learn from are left out.

    Parameters
    ----------
    model : the recording
    W : (N, p) whitened columns
    part : (r,) fold of each observation; by default that of `parts`
    biases : (N, q) whitened columns of further biases
    """
    sigma = joint_covariance(model, biases)
    columns = unwhitened(model, W)
    names = np.array([model.recording.intervals[block.interval].name for block in model.blocks])
    owner = np.repeat(names[model.observation_block], 3)
    rows = np.repeat(parts(model) if part is None else part, 3)
    for number in np.unique(rows):
        out = rows == number
        if not out.all():
            yield held_out(sigma, model.zeta, columns, out, owner)


def held_out(sigma: Array, observed: Array, columns: Array, out: NDArray[np.bool_], owner: NDArray[np.str_]) -> Fold:
    """One part of jointly normal observations held out.

    Parameters
    ----------
    sigma : (N, N) covariance of all observations under M0
    observed : (N,) observations
    columns : (N, p) columns, in their unit
    out : (N,) which are held out
    owner : (N,) name of what each belongs to
    """
    train = np.asarray(np.linalg.cholesky(sigma[np.ix_(~out, ~out)]))
    gain = _solved(train, sigma[np.ix_(~out, out)])
    left = np.asarray(np.linalg.cholesky(sigma[np.ix_(out, out)] - gain.T @ gain))
    train_y, train_X = _solved(train, observed[~out]), _solved(train, columns[~out])
    own = owner[out]
    return Fold(
        train_y=train_y,
        train_X=train_X,
        left_y=_solved(left, observed[out] - gain.T @ train_y),
        left_X=_solved(left, columns[out] - gain.T @ train_X),
        log_scale=2 * np.log(np.diag(left)),
        owner=own,
        dof={str(name): float(np.sum(own == name)) for name in np.unique(own)},
    )


def parts(model: RecordingModel) -> NDArray[np.intp]:
    """(r,) fold of each observation: which eighth of its interval, counted from another one in each interval.

    Intervals are ranked by length, so that two of one kind, such as two slews, do not hold the same part out together.
    """
    rank = np.argsort(np.argsort([block.elapsed_s[-1] for block in model.blocks]))
    each = [
        (np.arange(block.groups.size) * PARTS // block.groups.size + int(place)) % PARTS
        for place, block in zip(rank, model.blocks, strict=True)
    ]
    return np.concatenate(each)


def joint_covariance(model: RecordingModel, biases: Array | None = None) -> Array:
    """(N, N) covariance Σ of all observations under M0, with broad priors on start attitudes, G, b and further biases."""
    V = np.zeros((model.size, model.size))
    for block in model.blocks:
        V[block.rows, block.rows] = block.whitener @ block.whitener.T
    more = np.empty((model.size, 0)) if biases is None else biases
    own = np.full(more.shape[1], BROAD * PLAUSIBLE_RANGE[-1])
    scale = np.concatenate([np.full(3 * len(model.blocks), START), BROAD * PLAUSIBLE_RANGE, own])
    columns = unwhitened(model, np.hstack([model.starts, model.calibration, more]) * scale)
    return V + columns @ columns.T


def unwhitened(model: RecordingModel, columns: Array) -> Array:
    """L times whitened columns."""
    out = np.empty_like(columns)
    for block in model.blocks:
        out[block.rows] = block.whitener @ columns[block.rows]
    return out


def _solved(factor: Array, values: Array) -> Array:
    return np.asarray(scipy.linalg.solve_triangular(factor, values, lower=True, check_finite=False))
