"""What the covariance of the attitude residuals holds.

With A_obs = exp([e×]) A_true at each reference attitude and the gyro's white noise n (root PSD ARW) in the rates, the residual
of output j, propagated from reference 0 through R_j, is to first order

    θ_j = Θ_j Δx + e_j − R_j e_0 + g_j,    g_j = R_j ∫₀^{t_j} A(τ)ᵀ n(τ) dτ

so that for two outputs a, b of one interval

    cov(θ_a, θ_b) = δ_ab diag(σ_a²) + R_a diag(σ_0²) R_bᵀ + ARW² min(t_a, t_b) R_a R_bᵀ.

The start attitude is shared by all outputs of an interval, and one reference attitude may end an interval and start the
next, cov = −diag(σ²) R_bᵀ; both make residuals correlate. The noise is taken along the body axes: G ≈ I, its departure from I
changes the noise by |G − I| of itself.

"references only" is the paper's C in N (31)–(32): each residual by itself, both ends' reference errors and no gyro noise.

References from a batch over the gyro's own samples correlate in other ways, and `gyrocal.estimation.reference_covariance`
gives what their residuals then have: a C of each interval by itself, or one V of all residuals.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal.compiled import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
CovarianceModel = Literal["full", "references only"]

FULL, REFERENCES_ONLY, GIVEN, JOINT = 0, 1, 2, 3
MODEL_CODES = {"full": FULL, "references only": REFERENCES_ONLY, "given": GIVEN}  # "given" is JOINT where one V is


def chained(first_rows: Indices, last_rows: Indices) -> list[list[int]]:
    """Groups of intervals whose residuals correlate because they share a reference attitude, as intervals that touch do.

    Parameters
    ----------
    first_rows, last_rows : reference rows at the start and end of each interval, which uses all from one to the other
    """
    groups: list[list[int]] = []
    reached = -1
    for interval in np.argsort(first_rows, kind="stable"):
        if not groups or first_rows[interval] > reached:
            groups.append([])
        groups[-1].append(int(interval))
        reached = max(reached, int(last_rows[interval]))
    return groups


@compiled
def residual_covariance(
    R: Array,
    interval: Indices,
    start: Indices,
    row: Indices,
    elapsed_s: Array,
    sigma: Array,
    arw: float,
    model: int,
    given: Array,
) -> Array:  # pragma: no cover - compiled
    """Covariance V (3m, 3m) of m residuals.

    Parameters
    ----------
    R : (m, 3, 3) rotation from the start of the interval to each residual
    interval : (m,) interval of each residual
    start, row : (m,) reference rows each residual starts from and ends at
    elapsed_s : (m,) s since the start
    sigma : (all references, 3) 1-sigma per body axis, rad
    arw : root PSD of the integrated rate's noise, rad/sqrt(s); for skipped samples, of what is left of it
    model : FULL, REFERENCES_ONLY, GIVEN for a C of each interval, or JOINT for one V of these very residuals
    given : (intervals, 3, 3) those C, or (1, 3m, 3m) V, rad²; not used otherwise
    """
    m = len(row)
    V = np.zeros((3 * m, 3 * m))
    for a in range(m):
        for b in range(a + 1):
            if a != b and model != FULL and model != JOINT:
                continue
            noise = arw * arw * min(elapsed_s[a], elapsed_s[b]) if model == FULL and interval[a] == interval[b] else 0.0
            for i in range(3):
                for j in range(3):
                    value = 0.0
                    if model == GIVEN:
                        value = given[interval[a], i, j]
                    elif model == JOINT:
                        value = given[0, 3 * a + i, 3 * b + j]
                    else:
                        if row[a] == row[b] and i == j:
                            value += sigma[row[a], i] ** 2
                        shared = start[a] == start[b]
                        for k in range(3):
                            error = sigma[start[a], k] ** 2 if shared else 0.0
                            value += R[a, i, k] * (error + noise) * R[b, j, k]
                        # e_j of one residual is e_0 of another where an interval ends at the reference the next starts from.
                        if model == FULL and row[a] == start[b]:
                            value -= sigma[row[a], i] ** 2 * R[b, j, i]
                        if model == FULL and row[b] == start[a]:
                            value -= R[a, i, j] * sigma[row[b], j] ** 2
                    V[3 * a + i, 3 * b + j] = value
                    V[3 * b + j, 3 * a + i] = value
    return V


def walk_covariance(R: Array, walk: Array, interval: Indices) -> Array:
    """Compute the part (3m, 3m) of V that gyro noise has which differs between the axes, rad².

    Parameters
    ----------
    R : (m, 3, 3) rotation from the start of the interval to each residual
    walk : (m, 3, 3) covariance of the integrated noise in the axes at the start, rad²
    interval : (m,) interval of each residual; those of one are in the order of time
    """
    m = len(interval)
    first = np.minimum.outer(np.arange(m), np.arange(m))
    same = np.equal.outer(interval, interval)
    blocks = R[:, None] @ (walk[first] * same[:, :, None, None]) @ R.transpose(0, 2, 1)
    return np.asarray(blocks.transpose(0, 2, 1, 3).reshape(3 * m, 3 * m))
