"""What the covariance of the attitude residuals holds.

With A_obs = exp([e×]) A_true at each reference attitude and the gyro's white noise n (root PSD ARW) in the rates, the residual
of output j, propagated from reference 0 through R_j, is to first order

    θ_j = Θ_j Δx + e_j − R_j e_0 + g_j,    g_j = R_j ∫₀^{t_j} A(τ)ᵀ n(τ) dτ

so that for two outputs a, b of one interval

    cov(θ_a, θ_b) = δ_ab diag(σ_a²) + R_a diag(σ_0²) R_bᵀ + ARW² min(t_a, t_b) R_a R_bᵀ.

The start attitude is shared by all outputs of an interval, and one reference attitude may end an interval and start the
next; both make residuals correlate, and both follow from writing every residual in terms of the references it uses. The
noise is taken along the body axes: G ≈ I, its departure from I changes the noise by |G − I| of itself.

"references only" is the paper's C in N (31)–(32): each residual by itself, both ends' reference errors and no gyro noise.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CovarianceModel = Literal["full", "references only"]


def chained(first_rows: NDArray[np.intp], last_rows: NDArray[np.intp]) -> list[list[int]]:
    """Groups of intervals whose residuals correlate because one ends at the reference attitude the next starts from.

    Parameters
    ----------
    first_rows, last_rows : reference rows at the start and end of each interval
    """
    groups: list[list[int]] = []
    ending: dict[int, list[int]] = {}
    for interval in np.argsort(first_rows, kind="stable"):
        group = ending.get(int(first_rows[interval]))
        if group is None:
            group = []
            groups.append(group)
        group.append(int(interval))
        ending[int(last_rows[interval])] = group
    return groups


def residual_covariance(
    R: Array,
    interval: NDArray[np.intp],
    start: NDArray[np.intp],
    row: NDArray[np.intp],
    elapsed_s: Array,
    sigma: Array,
    arw: float,
    model: CovarianceModel = "full",
) -> Array:
    """Covariance V of m residuals.

    Parameters
    ----------
    R : (m, 3, 3) rotation from the start of the interval to each residual
    interval : (m,) interval of each residual
    start, row : (m,) reference rows each residual starts from and ends at
    elapsed_s : (m,) s since the start
    sigma : (all references, 3) 1-sigma per body axis, rad
    arw : root PSD of the integrated rate's noise, rad/sqrt(s); for skipped samples, of what is left of it
    model : "full", or "references only" for the paper's C

    Returns
    -------
    (3m, 3m)
    """
    m = len(row)
    V = np.zeros((m, 3, m, 3))
    diagonal = np.arange(m)
    V[diagonal, :, diagonal, :] += np.eye(3) * sigma[row][:, None, :] ** 2
    # Rotated start error of every residual, scaled: U_a U_bᵀ is its covariance wherever a and b share the start.
    U = R * sigma[start][:, None, :]
    if model == "references only":
        V[diagonal, :, diagonal, :] += U @ U.transpose(0, 2, 1)
        return V.reshape(3 * m, 3 * m)
    shared = start[:, None] == start[None, :]
    V += _outer(U) * shared[:, None, :, None]
    together = interval[:, None] == interval[None, :]
    variance = arw**2 * np.minimum(elapsed_s[:, None], elapsed_s[None, :]) * together
    V += _outer(R) * variance[:, None, :, None]
    # e_j of one residual is e_0 of another where an interval ends at the reference the next one starts from.
    a, b = np.nonzero(row[:, None] == start[None, :])
    for i, j in zip(a, b, strict=True):
        cross = -np.diag(sigma[row[i]] ** 2) @ R[j].T
        V[i, :, j, :] += cross
        V[j, :, i, :] += cross.T
    return V.reshape(3 * m, 3 * m)


def _outer(M: Array) -> Array:
    """M_a M_bᵀ of every pair, (m, 3, 3) → (m, 3, m, 3)."""
    m = len(M)
    flat = M.reshape(3 * m, 3)
    return (flat @ flat.T).reshape(m, 3, m, 3)
