"""Closed-form evidence of groups of columns with an unknown amplitude.

A group is k columns X of the whitened linear model, with amplitudes a ~ N(0, s² I). Integrated over a, and relative to the
baseline,

    log B(s) = −½ log |I + s² XᵀX| + ½ (Xᵀy)ᵀ (XᵀX + I/s²)⁻¹ (Xᵀy)

(Rasmussen & Williams, Gaussian Processes for Machine Learning, section 2.7), a sum over the eigenvectors of XᵀX. Of the
hundreds of columns of a strong process, a tridiagonal XᵀX = Q T Qᵀ does as well for a third of the work (Golub & Van Loan,
Matrix Computations, section 8.3.1): at each scale, I + s² T is factored in a number of steps that grows with k. The scale s
is not known either: B is averaged over scales spaced evenly in log s, and over the options of an effect (a step's time, a
process' time constant). An average of likelihood ratios has expectation one under the baseline, so that P(B ≥ c) ≤ 1/c there
whatever the recording (Ville's inequality); a search cannot exaggerate it.

An amplitude that can only be positive has the prior 2 N(0, s²) on a > 0. Its posterior before that restriction is normal with
mean over sigma z = s Xᵀy/√(1 + s² XᵀX), so that log B grows by log 2Φ(z).

Conditioned on groups that are already in, their scaled columns C = [s X …] change every inner product to
<p, q> − (Cᵀp)ᵀ (I + CᵀC)⁻¹ (Cᵀq).

A shift o, which has the amplitude one wherever its group is at work, takes y to y − o and adds <o, y> − ½ <o, o> to log B.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.special import log_ndtr

from gyrocal.arrays import Array

MANY = 48  # columns from which on they are not turned to their eigenvectors

LAPACK_BLOCK_COLUMNS = 64  # of columns that LAPACK works on together


def log_bayes(gram: Array, correlation: Array, scales: Array, positive: bool = False, shifted: bool = False) -> Array:
    """Compute log B of every option at every scale.

    Parameters
    ----------
    gram : (o, k, k) XᵀX
    correlation : (o, k) Xᵀy, or (o, k, d) for d observations
    scales : (s,)
    positive : whether the amplitude can only be positive; for groups of one column
    shifted : whether the last column is a shift

    Returns
    -------
    (o, s), or (o, s, d)
    """
    if shifted:
        gram, correlation, known = remove_shift(gram, correlation)
        return known[:, None] + log_bayes(gram, correlation, scales, positive)
    if gram.shape[1] >= MANY and correlation.size == gram.shape[0] * gram.shape[1]:
        evidence = np.array(
            [
                _compute_tridiagonal_evidence(matrix, along.ravel(), scales)
                for matrix, along in zip(gram, correlation, strict=True)
            ]
        )
        if np.isfinite(evidence).all():
            return evidence.reshape(*evidence.shape, *correlation.shape[2:])
    # Most groups are of one column, which needs no decomposition.
    values, vectors = np.linalg.eigh(gram) if gram.shape[1] != 1 else (gram[:, :, 0], np.ones_like(gram))
    values = np.maximum(values, 0.0)
    single = correlation.ndim == 2
    along = np.matmul(vectors.transpose(0, 2, 1), correlation[..., None] if single else correlation)  # (o, k, d)
    variance = scales**2
    gain = 1.0 + variance[None, None, :] * values[:, :, None]  # (o, k, s)
    quadratic = 0.5 * np.einsum("oks,okd->osd", variance / gain, along**2)
    out = quadratic - 0.5 * np.log(gain).sum(axis=1)[:, :, None]
    if positive:
        z = scales[None, :, None] * along / np.sqrt(gain[:, 0, :, None])  # (o, s, d): one column
        out = out + np.log(2.0) + log_ndtr(z)
    return np.asarray(out[:, :, 0] if single else out)


def _compute_tridiagonal_evidence(gram: Array, correlation: Array, scales: Array) -> Array:
    """Compute log B (s,) of one group of many columns by a tridiagonal form of XᵀX; NaN where rounding leaves it negative."""
    reflectors, diagonal, off_diagonal, factors, _ = lapack.dsytrd(gram, lower=1, lwork=LAPACK_BLOCK_COLUMNS * len(gram))
    # Qᵀ Xᵀy; the first reflection leaves the first place as it is, and the others are those of a QR decomposition.
    turned, _, _ = lapack.dormqr("L", "T", reflectors[1:, :-1], factors, correlation[1:, None], lwork=LAPACK_BLOCK_COLUMNS)
    along = np.append(correlation[0], turned)
    out = []
    for variance in scales**2:
        pivots, _, solved, failed = lapack.dptsv(1.0 + variance * diagonal, variance * off_diagonal, along)
        out.append(np.nan if failed else 0.5 * variance * (along @ solved) - 0.5 * np.log(pivots).sum())
    return np.array(out)


def remove_shift(gram: Array, correlation: Array) -> tuple[Array, Array, Array]:
    """Return XᵀX and Xᵀ(y − o) without the shift o in the last column, and <o, y> − ½ <o, o>, (o,) or (o, d)."""
    last_column = gram[:, :, -1] if correlation.ndim == 2 else gram[:, :, -1:]
    known = correlation[:, -1] - 0.5 * last_column[:, -1]
    return gram[:, :-1, :-1], correlation[:, :-1] - last_column[:, :-1], known


def average_evidence(table: Array, log_weights: Array) -> float:
    """Compute log of B averaged over options and scales, (o, s), with the log weights (o,) that sum to one."""
    values = table + log_weights[:, None]
    top = values.max()
    return float(top + np.log(np.exp(values - top).sum()) - np.log(table.shape[1]))
