r"""Whether more scatter in second differences than is stated is of the references, or of the angle turned between them.

With e_k the error of reference k about its body axes, of covariance S_k, θ_k that of the angle turned from k to k + 1, about
the same axes and of covariance W_k, and T_kl = A_k A_lᵀ the turn of the body from l to k, the second difference of residuals
about the axes of the middle one is

    d_k = T_k,k−1 e_k−1 − 2 e_k + T_k,k+1 e_k+1 + θ_k − T_k,k−1 θ_k−1,

normal, with covariances that the model gives for neighbours too:

    ⟨d_k d_kᵀ⟩   = T_k,k−1 S_k−1 T_k,k−1ᵀ + 4 S_k + T_k,k+1 S_k+1 T_k,k+1ᵀ + W_k + T_k,k−1 W_k−1 T_k,k−1ᵀ
    ⟨d_k+1 d_kᵀ⟩ = −2 T_k+1,k S_k − 2 S_k+1 T_k,k+1ᵀ − T_k+1,k W_k
    ⟨d_k+2 d_kᵀ⟩ = T_k+2,k+1 S_k+1 T_k,k+1ᵀ.

An excess of S, or one of W, of some size x, log-uniform, is weighed by the likelihoods of three differences after one another;
where the body turns, as it does on a spinner, covariances about its axes one by one would show neither. More of them together
would show slow errors, which are neither: sums of many differences hold little of either and much of what is slow. The threes
begin at each place, and so count a third each.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.special import logsumexp

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

EXCESS = np.geomspace(0.03, 1000.0, 24)  # over what is stated
TOGETHER = 3  # differences
BAND = 9  # diagonals: differences that share a reference


def log_odds(
    values: Array, kept: Mask, middle: Indices, to_inertial: Array, variance: Array, walk: Array, axes: slice
) -> float:
    """log of the evidence of an excess of the references over that of an excess of the angle turned.

    Parameters
    ----------
    values : (k, 3) second differences in the body axes of the middle reference, rad
    kept : (k, 3) those that count
    middle : (k,) index of the middle reference
    to_inertial : (m, 3, 3) Aᵀ of each reference
    variance : (m, 3) stated, of each reference about its body axes, rad²
    walk : (m, 3) variance of the angle turned from each reference to the next, rad²
    axes : body axes that have the excess
    """
    chosen = np.zeros(3)
    chosen[axes] = 1.0
    A = to_inertial.transpose(0, 2, 1)
    of_references, of_angle = _banded(A, middle, variance * chosen, 0 * walk), _banded(A, middle, 0 * variance, walk * chosen)
    stated = _banded(A, middle, variance, walk)
    counted = kept.ravel()
    size = of_references[0, counted].mean() / max(float(of_angle[0, counted].mean()), np.finfo(float).tiny)
    v = np.where(kept, values, 0.0).ravel()
    threes = [(np.arange(middle.size) + start) // TOGETHER for start in range(TOGETHER)]
    together = [_together(np.repeat(three, 3), counted) for three in threes]

    def log_density(covariance: Array) -> float:
        return sum(_log_density(v, np.where(own, covariance, 0.0), counted) for own in together) / TOGETHER

    each = [logsumexp([log_density(stated + x * excess) for x in EXCESS]) for excess in (of_references, size * of_angle)]
    return float(each[0] - each[1])


def _banded(A: Array, middle: Indices, variance: Array, walk: Array) -> Array:
    """(9, 3k) covariance of all differences, its lower diagonals; see the module."""
    S, W = np.einsum("mi,ij->mij", variance, np.eye(3)), np.einsum("mi,ij->mij", walk, np.eye(3))
    before, after = _turn(A, middle, middle - 1), _turn(A, middle, middle + 1)
    own = 4 * S[middle] + W[middle] + _seen(before, S[middle - 1] + W[middle - 1]) + _seen(after, S[middle + 1])
    out = np.zeros((BAND, 3 * middle.size))
    _put(out, 0, np.arange(middle.size), own)
    for apart in (1, 2):
        first = np.arange(middle.size - apart)
        gap = middle[first + apart] - middle[first]
        near, far = first[gap == 1], first[gap == 2]
        back = _turn(A, middle[near] + 1, middle[near])
        both = -2 * back @ S[middle[near]] - 2 * S[middle[near] + 1] @ after[near].transpose(0, 2, 1) - back @ W[middle[near]]
        _put(out, apart, near, both)
        beyond = _turn(A, middle[far] + 2, middle[far] + 1)
        _put(out, apart, far, beyond @ S[middle[far] + 1] @ after[far].transpose(0, 2, 1))
    return out


def _turn(A: Array, to: Indices, of: Indices) -> Array:
    """(k, 3, 3) from the body axes of some references to those of others."""
    return np.asarray(A[to] @ A[of].transpose(0, 2, 1))


def _seen(turn: Array, covariance: Array) -> Array:
    return np.asarray(turn @ covariance @ turn.transpose(0, 2, 1))


def _put(banded: Array, apart: int, first: Indices, blocks: Array) -> None:
    """Blocks ⟨d_k+apart d_kᵀ⟩ of the differences `first`, into the lower diagonals."""
    for i in range(3):
        for j in range(3):
            if 3 * apart + i - j >= 0:
                banded[3 * apart + i - j, 3 * first + j] = blocks[:, i, j]


def _together(group: Indices, counted: Mask) -> Mask:
    """(9, 3k) of the lower diagonals, what is between values that count and are of one group."""
    out = np.zeros((BAND, group.size), dtype=bool)
    for below in range(BAND):
        stop = group.size - below
        out[below, :stop] = counted[:stop] & counted[below:] & (group[:stop] == group[below:])
    return out


def _log_density(v: Array, banded: Array, counted: Mask) -> float:
    """log of the normal density of those of v that count, but for a constant."""
    L = scipy.linalg.cholesky_banded(np.vstack([np.where(counted, banded[0], 1.0), banded[1:]]), lower=True, check_finite=False)
    return float(-np.sum(np.log(L[0])) - 0.5 * v @ scipy.linalg.cho_solve_banded((L, True), v, check_finite=False))
