"""Covariance of the attitude residuals.

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

from gyrocal.arrays import Array, Indices
from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, multiply, solve_lower, transform_covariance

BoolArray = NDArray[np.bool_]
CovarianceModel = Literal["full", "references only"]

FULL, REFERENCES_ONLY, GIVEN, JOINT = 0, 1, 2, 3
MODEL_CODES = {"full": FULL, "references only": REFERENCES_ONLY, "given": GIVEN}  # "given" is JOINT where one V is


def chain_intervals(first_rows: Indices, last_rows: Indices) -> list[list[int]]:
    """Group intervals that share a reference attitude, as intervals that touch do: their residuals correlate.

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
    """Group residuals that correlate: their order (m,), and one past the end of each group."""
    numbers, firsts = np.unique(interval, return_index=True)
    lasts = np.append(firsts[1:], len(row)) - 1
    chains = chain_intervals(start[firsts], row[lasts])
    members = [np.flatnonzero(np.isin(interval, numbers[chain])) for chain in chains]
    return np.concatenate(members), np.cumsum([len(member) for member in members])


def integrate_white_noise(elapsed_s: Array, arw: float) -> Array:
    """Compute ARW² T I (m, 3, 3), rad², of white noise of root PSD arw, rad/sqrt(s), after times (m,) s."""
    return np.asarray(arw**2 * elapsed_s[:, None, None] * np.eye(3))


@compile_cached
def compute_residual_covariance(R: Array, interval: Indices, start: Indices, row: Indices, noise: Array, walk: Array) -> Array:
    """Compute the covariance V (3m, 3m) of m residuals, rad².

    R: (m, 3, 3) rotation from the start of the interval to each residual
    interval: (m,) interval of each residual; those of one are in the order of time
    start, row: (m,) reference rows each residual starts from and ends at
    noise: (all references, 3, 3) covariance of each about the body axes, rad²
    walk: (m, 3, 3) covariance of the integrated gyro noise up to each residual, in the axes at the start, rad²
    """
    m = len(row)
    V = np.zeros((3 * m, 3 * m))
    for a in range(m):
        for b in range(a + 1):
            shared_turned = np.zeros((3, 3))  # covariance of the errors at the start that a and b share, times R_bᵀ
            for i in range(3):
                for k in range(3):
                    shared = noise[start[a], i, k] if start[a] == start[b] else 0.0
                    if interval[a] == interval[b]:
                        shared += walk[b, i, k]
                    for j in range(3):
                        shared_turned[i, j] += shared * R[b, j, k]
            for i in range(3):
                for j in range(3):
                    value = noise[row[a], i, j] if row[a] == row[b] else 0.0
                    for k in range(3):
                        value += R[a, i, k] * shared_turned[k, j]
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
    """Compute the covariance V (3m, 3m) of m residuals under a model, rad².

    R, interval, start, row, noise, walk: as in `compute_residual_covariance`
    model: FULL, REFERENCES_ONLY, GIVEN for a C of each interval, or JOINT for one V of these very residuals
    given: (intervals, 3, 3) those C, or (1, 3m, 3m) V, rad²; not used otherwise
    """
    if model == JOINT:
        return given[0].copy()
    if model == FULL:
        return compute_residual_covariance(R, interval, start, row, noise, walk)
    V = np.zeros((3 * len(row), 3 * len(row)))
    for a in range(len(row)):
        C = given[interval[a]] if model == GIVEN else transform_covariance(R[a], noise[start[a]])
        for i in range(3):
            for j in range(3):
                V[3 * a + i, 3 * a + j] = C[i, j] if model == GIVEN else C[i, j] + noise[row[a], i, j]
    return V


def find_chains(order: Indices, ends: Indices, interval: Indices, start: Indices, row: Indices) -> BoolArray:
    """Find the groups, (groups,), in which every interval starts at the reference that ends the one before it.

    order, ends : the groups as in `group_residuals`; interval, start, row as in `compute_residual_covariance`
    """
    interval, start, row = interval[order], start[order], row[order]
    same = interval[1:] == interval[:-1]
    broken = np.where(same, (start[1:] != start[:-1]) | (row[1:] <= row[:-1]), start[1:] != row[:-1])
    broken = np.append(False, broken)
    firsts = np.append(0, ends[:-1])
    broken[firsts] = False
    return np.asarray(~np.logical_or.reduceat(broken, firsts))


@compile_cached
def whiten_chain(
    order: Indices,
    values: Array,
    R: Array,
    references: tuple[Indices, Indices, Indices, Array],
    walk: Array,
    out: Array,
    variance: Array,
) -> None:
    """Whiten columns along chains of residuals, and write the variance of each residual, rad².

    order: (n,) the residuals of one chain after another; a chain ends where the next interval does not go on from it
    values: (3m, c) of all residuals
    R, walk, references: interval, start, row and noise, of all residuals, as in `compute_residual_covariance`
    out: (3n, c) for L⁻¹ values of these, L Lᵀ their covariance
    variance: (m, 3) of all residuals
    """
    # Loops: numpy's generality in shapes and layouts would take most of the time to compile. x, P: estimate and covariance of
    # the random walk in the axes at the start; included: the walk's covariance up to the residual before, which P holds.
    interval, start, row, noise = references
    columns, previous = values.shape[1], -1
    x, P, included = np.zeros((3, columns)), np.zeros((3, 3)), np.zeros((3, 3))
    innovation, gain, identity = np.empty((3, columns)), np.empty((3, 3)), np.zeros((3, 3))
    identity[0, 0] = identity[1, 1] = identity[2, 2] = 1.0
    for k in range(len(order)):
        a = order[k]
        if previous < 0 or interval[a] != interval[previous]:
            if previous >= 0 and start[a] == row[previous]:
                x, P = multiply(R[previous], x), transform_covariance(R[previous], P)
                for i in range(3):
                    for c in range(columns):
                        x[i, c] -= values[3 * previous + i, c]
            else:
                x, P = np.zeros((3, columns)), noise[start[a]].copy()
            for i in range(3):
                for j in range(3):
                    included[i, j] = 0.0
        for i in range(3):
            for j in range(3):
                P[i, j] += walk[a, i, j] - included[i, j]
                included[i, j] = walk[a, i, j]
        start_noise, gyro_noise = transform_covariance(R[a], noise[start[a]]), transform_covariance(R[a], walk[a])
        S, predicted = transform_covariance(R[a], P), multiply(R[a], x)
        for i in range(3):
            variance[a, i] = start_noise[i, i] + gyro_noise[i, i] + noise[row[a], i, i]
            for j in range(3):
                S[i, j] += noise[row[a], i, j]
            for c in range(columns):
                innovation[i, c] = values[3 * a + i, c] - predicted[i, c]
        root = solve_lower(compute_lower_root(S), identity)  # S⁻¹ = rootᵀ root
        white_R, white_innovation = multiply(root, R[a]), multiply(root, innovation)
        white_RP = multiply(white_R, P)
        for i in range(3):
            for j in range(3):
                gain[i, j] = white_RP[j, i]
        K, complement, correction = multiply(gain, root), multiply(gain, white_R), multiply(gain, white_innovation)
        for i in range(3):
            for j in range(3):
                complement[i, j] = identity[i, j] - complement[i, j]
            for c in range(columns):
                out[3 * k + i, c] = white_innovation[i, c]
                x[i, c] += correction[i, c]
        P, noise_part = transform_covariance(complement, P), transform_covariance(K, noise[row[a]])
        for i in range(3):
            for j in range(3):
                P[i, j] += noise_part[i, j]
        previous = a
