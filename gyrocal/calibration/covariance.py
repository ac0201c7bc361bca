"""What the covariance of the attitude residuals holds.

With A_obs = exp([e×]) A_true at each reference attitude and the gyro's white noise n (root PSD ARW) in the rates, the residual
of output j, propagated from reference 0 through R_j, is to first order

    θ_j = Θ_j Δx + e_j − R_j e_0 + g_j,    g_j = R_j ∫₀^{t_j} A(τ)ᵀ n(τ) dτ

so that for two outputs a, b of one interval

    cov(θ_a, θ_b) = δ_ab diag(σ_a²) + R_a diag(σ_0²) R_bᵀ + ARW² min(t_a, t_b) R_a R_bᵀ.

The start attitude is shared by all outputs of an interval, and one reference attitude may end an interval and start the next,
cov = −diag(σ²) R_bᵀ; both make residuals correlate. The noise is taken along the body axes: G ≈ I, its departure from I changes
the noise by |G − I| of itself. The errors of a reference may correlate between axes; then 3×3 covariances stand for diag(σ²).

"references only" is the paper's C in N (31)–(32): each residual by itself, both ends' reference errors and no gyro noise.

Along a chain of intervals, each of which starts at the reference that ends the one before, the residuals are readings
θ_j = e_j + R_j s_j of a random walk s_j = −e_0 + ∫Aᵀn of three components, and begin anew with s = −e_j. `whiten_chain` filters
them, with time and memory linear in their number; other intervals take their whole covariance.

References from a batch over the gyro's own samples correlate in other ways, and `gyrocal.estimation.reference_covariance`
gives what their residuals then have: a C of each interval by itself, or one V of all residuals.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, solve_lower

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
CovarianceModel = Literal["full", "references only"]

FULL, REFERENCES_ONLY, GIVEN, JOINT = 0, 1, 2, 3
MODEL_CODES = {"full": FULL, "references only": REFERENCES_ONLY, "given": GIVEN}  # "given" is JOINT where one V is


def chain_intervals(first_rows: Indices, last_rows: Indices) -> list[list[int]]:
    """Groups of intervals whose residuals correlate because they share a reference attitude, as intervals that touch do.

    first_rows, last_rows: reference rows at the start and end of each interval, which uses all from one to the other.
    """
    groups: list[list[int]] = []
    reached = -1
    for interval in np.argsort(first_rows, kind="stable"):
        if not groups or first_rows[interval] > reached:
            groups.append([])
        groups[-1].append(int(interval))
        reached = max(reached, int(last_rows[interval]))
    return groups


def group_residuals(interval: Indices, start: Indices, row: Indices) -> tuple[Indices, Indices]:
    """Group correlated residuals: their order (m,), and one past the end of each group."""
    numbers, firsts = np.unique(interval, return_index=True)
    lasts = np.append(firsts[1:], len(row)) - 1
    chains = chain_intervals(start[firsts], row[lasts])
    members = [np.flatnonzero(np.isin(interval, numbers[chain])) for chain in chains]
    return np.concatenate(members), np.cumsum([len(own) for own in members])


def integrate_white_noise(elapsed_s: Array, arw: float) -> Array:
    """ARW² T I (m, 3, 3) of white noise of root PSD arw, rad/sqrt(s), after some times (m,) s."""
    return np.asarray(arw**2 * elapsed_s[:, None, None] * np.eye(3))


@compile_cached
def compute_residual_covariance(R: Array, interval: Indices, start: Indices, row: Indices, noise: Array, walk: Array) -> Array:
    """Covariance V (3m, 3m) of m residuals.

    Parameters
    ----------
    R : (m, 3, 3) rotation from the start of the interval to each residual
    interval : (m,) interval of each residual; those of one are in the order of time
    start, row : (m,) reference rows each residual starts from and ends at
    noise : (all references, 3, 3) covariance of each about the body axes, rad²
    walk : (m, 3, 3) covariance of the integrated gyro noise up to each residual, in the axes at the start, rad²
    """
    m = len(row)
    V = np.zeros((3 * m, 3 * m))
    for a in range(m):
        for b in range(a + 1):
            both = np.zeros((3, 3))  # of the errors that R carries to both
            if start[a] == start[b]:
                both += noise[start[a]]
            if interval[a] == interval[b]:
                both += walk[b]
            turned = np.zeros((3, 3))
            for i in range(3):
                for j in range(3):
                    for k in range(3):
                        turned[i, j] += both[i, k] * R[b, j, k]
            for i in range(3):
                for j in range(3):
                    value = noise[row[a], i, j] if row[a] == row[b] else 0.0
                    for k in range(3):
                        value += R[a, i, k] * turned[k, j]
                    # e_j of one residual is e_0 of another where an interval ends at the reference the next starts from.
                    if row[a] == start[b]:
                        for k in range(3):
                            value -= noise[row[a], i, k] * R[b, j, k]
                    if row[b] == start[a]:
                        for k in range(3):
                            value -= R[a, i, k] * noise[row[b], k, j]
                    V[3 * a + i, 3 * b + j] = value
                    V[3 * b + j, 3 * a + i] = value
    return V


@compile_cached
def model_covariance(
    R: Array,
    interval: Indices,
    start: Indices,
    row: Indices,
    noise: Array,
    walk: Array,
    model: int,
    given: Array,
) -> Array:
    """Covariance V (3m, 3m) of m residuals under a model.

    Parameters
    ----------
    R, interval, start, row, noise, walk : as in `compute_residual_covariance`
    model : FULL, REFERENCES_ONLY, GIVEN for a C of each interval, or JOINT for one V of these very residuals
    given : (intervals, 3, 3) those C, or (1, 3m, 3m) V, rad²; not used otherwise
    """
    if model == JOINT:
        return given[0].copy()
    if model == FULL:
        return compute_residual_covariance(R, interval, start, row, noise, walk)
    V = np.zeros((3 * len(row), 3 * len(row)))
    for a in range(len(row)):
        own, at = slice(a, a + 1), slice(3 * a, 3 * a + 3)
        if model == GIVEN:
            V[at, at] = given[interval[a]]
        else:
            V[at, at] = compute_residual_covariance(R[own], interval[own], start[own], row[own], noise, 0.0 * walk[own])
    return V


@compile_cached
def is_chain(interval: Indices, start: Indices, row: Indices) -> bool:
    """Whether each interval of some residuals starts at the reference that ends the one before it."""
    for a in range(1, len(row)):
        same = interval[a] == interval[a - 1]
        if (start[a] != start[a - 1] or row[a] <= row[a - 1]) if same else start[a] != row[a - 1]:
            return False
    return True


@compile_cached
def whiten_chain(R: Array, interval: Indices, start: Indices, row: Indices, noise: Array, walk: Array, values: Array) -> Array:
    """L⁻¹ values (3m, c), L Lᵀ the covariance of the residuals of a chain; the others as in `compute_residual_covariance`."""
    out, x = np.empty_like(values), np.zeros((3, values.shape[1]))
    P, known = noise[start[0]].copy(), np.zeros((3, 3))
    for a in range(len(row)):
        if a > 0 and interval[a] != interval[a - 1]:
            x = R[a - 1] @ x - values[3 * a - 3 : 3 * a]
            P = R[a - 1] @ P @ R[a - 1].T
            known = np.zeros((3, 3))
        P = P + walk[a] - known
        known = walk[a]
        root = solve_lower(compute_lower_root(R[a] @ P @ R[a].T + noise[row[a]]), np.eye(3))
        seen = root @ R[a]
        out[3 * a : 3 * a + 3] = root @ (values[3 * a : 3 * a + 3] - R[a] @ x)
        gain = P @ seen.T
        x = x + gain @ out[3 * a : 3 * a + 3]
        kept, K = np.eye(3) - gain @ seen, gain @ root
        P = kept @ P @ kept.T + K @ noise[row[a]] @ K.T
    return out
