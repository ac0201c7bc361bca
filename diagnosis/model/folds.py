"""Folds of a recording: an eighth of each interval held out at a time, and predicted from the rest under M0.

Under M0 all observations are jointly normal: noise with the covariance V, and start attitudes, G and b with broad priors,
Σ = V + N P₀ Nᵀ. Given the training rows t, the rows s held out have the mean Σ_st Σ_tt⁻¹ ζ_t and the covariance
C = Σ_ss − Σ_st Σ_tt⁻¹ Σ_ts (Rasmussen & Williams, Gaussian Processes for Machine Learning, section 2.2). Every interval gives
a part to each fold, so that training sees every motion.

The noise of different intervals is independent, V = L Lᵀ block by block, and what they share are a few columns N P₀^½, which
are whitened like all others, B = L⁻¹ N P₀^½. Training rows of a block show of whitened values x = L⁻¹ξ what is orthogonal to
the directions z with (L z)_t = 0, an orthonormal basis Z of L⁻¹E_s; inner products of their own whitened values K⁻¹ξ_t, with
K Kᵀ = V_tt, are those of

    x̃ = x − Z Zᵀx,    and    ξ_s − V_st V_tt⁻¹ ξ_t = L_s Z Zᵀx,    V_ss − V_st V_tt⁻¹ V_ts = L_s Z (L_s Z)ᵀ,

so that a part that is held out costs in proportion to its own size. The singular values B̃ = Q S Uᵀ give the rest without a
matrix of all rows (the matrix inversion lemma, section A.3 there): training values x̃ become

    (I + B̃B̃ᵀ)^−½ x̃ = x̃ − Q (1 − (1 + S²)^−½) Qᵀx̃

in units of their own scatter, and with D = L_s Z ZᵀB the errors of the prediction are

    L_s Z Zᵀx − D U (S/(1 + S²)) Qᵀx̃,    C = L_s Z (L_s Z)ᵀ + D U (1 + S²)⁻¹ Uᵀ Dᵀ,

without differences of the broad priors, in which rounding would show.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.linear import Fold
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices, Mask
from gyrocal.calibration.observability import PLAUSIBLE_RANGE

PARTS = 8  # of an interval
START = 0.02  # rad, prior sigma of a start attitude
BROAD = 10.0  # prior sigma of G and b, in their plausible ranges

RECORDING_SPLIT = "an eighth of each interval at a time"
FOLD_COLUMNS_PER_BATCH = 256  # columns; these stay in a processor's cache


def build_folds(model: RecordingModel, W: Array) -> Iterator[Fold]:
    """Build the folds of a recording with whitened columns (N, p); those that would leave nothing to train on are left out."""
    names = np.array([model.recording.intervals[block.interval].name for block in model.blocks])
    owner = np.repeat(names[model.observation_block], 3)
    rows = np.repeat(assign_folds(model), 3)
    for number in np.unique(rows):
        out = rows == number
        if not out.all():
            conditioned = condition_rows(model, W, out)
            yield _fold(
                conditioned.train_y,
                conditioned.train_X,
                conditioned.error_y,
                conditioned.error_X,
                conditioned.covariance,
                owner[out],
            )


@dataclass(frozen=True)
class ConditionedRows:
    """Some rows of a recording, given the others."""

    # train_y, train_X: (N,), (N, p) training observations and columns, in units of their own scatter, turned into as many rows
    # as there are in all
    train_y: Array
    train_X: Array
    error_y: Array  # error_y, error_X: (s,), (s, p) errors of M0's prediction of the others, not whitened
    error_X: Array
    covariance: Array  # (s, s) C


def condition_rows(model: RecordingModel, W: Array, out: Mask) -> ConditionedRows:
    """Condition the rows `out` (N,) of a recording, with whitened columns W (N, p), on the others; see the module."""
    parts = []
    for block in model.blocks:
        held_rows = np.flatnonzero(out[block.rows])
        Z = _build_hidden_basis(block.whitener, held_rows)
        parts.append(_Part(block.rows, Z, block.whitener[held_rows] @ Z))
    B, D = _split_values(parts, build_shared_columns(model))
    train_y, error_y = _split_values(parts, model.whiten(model.zeta))
    # Rows of zeros below add singular values for directions that no training row shows.
    Q, S, U = np.linalg.svd(np.vstack([B, np.zeros((B.shape[1], B.shape[1]))]), full_matrices=False)
    Q, D = Q[: len(B)], D @ U.T
    shrunk, gain = Q * (1 - 1 / np.sqrt(1 + S**2)), D * (S / (1 + S**2))
    train_X, error_X = np.empty(W.shape, order="F"), np.empty((len(D), W.shape[1]), order="F")
    for first in range(0, W.shape[1], FOLD_COLUMNS_PER_BATCH):
        batch = slice(first, first + FOLD_COLUMNS_PER_BATCH)
        train, error = _split_values(parts, W[:, batch])
        components = Q.T @ train
        train_X[:, batch], error_X[:, batch] = train - shrunk @ components, error - gain @ components
    components_y = Q.T @ train_y
    noise = scipy.linalg.block_diag(*(part.shown @ part.shown.T for part in parts))
    return ConditionedRows(
        train_y - shrunk @ components_y, train_X, error_y - gain @ components_y, error_X, noise + (D / (1 + S**2)) @ D.T
    )


@dataclass(frozen=True)
class _Part:
    """Rows held out of a block."""

    rows: slice  # of the block among all
    hidden: Array  # Z (n, s)
    shown: Array  # L_s Z (s, s)


def _split_values(parts: list[_Part], values: Array) -> tuple[Array, Array]:
    """Split whitened values (N,) or (N, k) into the part x̃ that training rows show, and L_s Z Zᵀx of the rows held out."""
    visible, shown = np.array(values, order="F"), []
    for part in parts:
        hidden = part.hidden.T @ values[part.rows]
        visible[part.rows] -= part.hidden @ hidden
        shown.append(part.shown @ hidden)
    return visible, np.concatenate(shown)


def _build_hidden_basis(L: Array, rows: Indices) -> Array:
    """Build an orthonormal basis (n, s) of the whitened values that the other rows of a block do not show."""
    if rows.size == len(L):
        return np.eye(len(L))
    units = np.zeros((len(L), rows.size))
    units[rows, np.arange(rows.size)] = 1.0
    return np.asarray(np.linalg.qr(_solve_lower(L, units))[0])


def build_normal_fold(sigma: Array, observed: Array, columns: Array, out: Mask, owner: NDArray[np.str_]) -> Fold:
    """Hold some of jointly normal observations (N,) out, with columns (N, p) and the covariance `sigma` (N, N) under M0."""
    train = np.asarray(np.linalg.cholesky(sigma[np.ix_(~out, ~out)]))
    gain = _solve_lower(train, sigma[np.ix_(~out, out)])
    train_y, train_X = _solve_lower(train, observed[~out]), _solve_lower(train, columns[~out])
    error_y, error_X = observed[out] - gain.T @ train_y, columns[out] - gain.T @ train_X
    return _fold(train_y, train_X, error_y, error_X, sigma[np.ix_(out, out)] - gain.T @ gain, owner[out])


def _fold(train_y: Array, train_X: Array, error_y: Array, error_X: Array, covariance: Array, owner: NDArray[np.str_]) -> Fold:
    """Build a fold from the errors of its prediction and their covariance."""
    root = np.asarray(np.linalg.cholesky(covariance))
    dof = {str(name): float(np.sum(owner == name)) for name in np.unique(owner)}
    return Fold(train_y, train_X, _solve_lower(root, error_y), _solve_lower(root, error_X), owner, dof)


def assign_folds(model: RecordingModel) -> Indices:
    """Assign each observation (r,) to a fold: the eighth of its interval, counted from a different one in each interval.

    Intervals are ranked by length, so that two of one kind, such as two slews, do not hold the same part out together.
    """
    rank = np.argsort(np.argsort([block.elapsed_s[-1] for block in model.blocks]))
    fold_of_block = [
        (np.arange(block.groups.size) * PARTS // block.groups.size + int(rank_of_block)) % PARTS
        for rank_of_block, block in zip(rank, model.blocks, strict=True)
    ]
    return np.concatenate(fold_of_block)


def build_shared_columns(model: RecordingModel) -> Array:
    """Build the whitened columns B (N, q) of starts, G, b and lines, which intervals share, in units of their priors."""
    scale = np.concatenate([np.full(model.starts.shape[1], START), BROAD * PLAUSIBLE_RANGE])
    return np.hstack([np.hstack([model.starts, model.calibration]) * scale, model.error_columns])


def _solve_lower(factor: Array, values: Array) -> Array:
    return np.asarray(scipy.linalg.solve_triangular(factor, values, lower=True, check_finite=False))
