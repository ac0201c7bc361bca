"""Inseparable pairs: which effect imitates which, and from what signal-to-noise ratio on they are told apart.

If A is at work with signature x, B imitates the part P_B x, ρ² = ‖P_B x‖²/‖x‖². The log evidence of A over B then is about
½ a²‖x‖² (1 − ρ²), with Occam factors that grow only with log a left out (Kay, Fundamentals of Statistical Signal Processing
II, section 7.7, for the noncentrality). A probability of 0.95 takes log odds of ln 19, hence a signal-to-noise ratio of

    SNR = a‖x‖ = sqrt(2 ln 19 / (1 − ρ²))

Two random effects are told apart by the Kullback–Leibler divergence of their covariances, I + s² K_A against the I + r² K_B
closest to it, which is the expected log likelihood ratio; s is that for which it is ln 19.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.plan.columns import Signature, find_median_index
from diagnosis.plan.result import SETTINGS, Pair, Visible
from gyrocal.arrays import Array
from simulator.effects import EFFECTS


def compute_confusion_shares(signatures: Sequence[Signature]) -> tuple[Array, Array]:
    """Compute ρ² of each effect (row) by each other (column), and the other's size for a unit of the first.

    Over the options of the other the best imitation counts, over those of the effect itself the median.
    """
    count = len(signatures)
    bases = [_build_basis(signature) for signature in signatures]
    Q = np.hstack([basis.reshape(len(basis), -1) for basis in bases])
    parts = np.cumsum([0] + [signature.X.shape[1] * signature.X.shape[2] for signature in signatures])
    rho, ratio = np.zeros((count, count)), np.zeros((count, count))
    for i, signature in enumerate(signatures):
        power = np.sum(signature.X**2, axis=(0, 2))  # (o,)
        products = np.sum(
            (Q.T @ signature.X.reshape(len(signature.X), -1)).reshape(Q.shape[1], *signature.X.shape[1:]) ** 2, axis=2
        )
        for j, other in enumerate(signatures):
            options, k = other.X.shape[1:]
            explained_powers = products[parts[j] : parts[j + 1]].reshape(options, k, -1).sum(axis=1)  # (options, o)
            best = explained_powers.argmax(axis=0)
            explained = explained_powers[best, np.arange(power.size)]
            share = np.minimum(explained / np.maximum(power, 1e-300), 1.0)
            middle = find_median_index(share, signature.weights)
            rho[i, j] = share[middle]
            ratio[i, j] = np.sqrt(explained[middle] / signature.X.shape[2]) / max(other.norms[best[middle]], 1e-300)
    return rho, ratio


def _build_basis(signature: Signature) -> Array:
    """Build an orthonormal basis (N, o, k) of each option; zero where the option cannot be seen."""
    U, s, _ = np.linalg.svd(signature.X.transpose(1, 0, 2), full_matrices=False)
    is_visible = (s > 1e-9 * max(float(s.max()), 1e-300)) & (signature.share > SETTINGS.gone)[:, None]
    return np.asarray((U * is_visible[:, None, :]).transpose(1, 0, 2))


def compute_separating_snr(share: Array) -> Array:
    """Compute the SNR that gives log odds of ln 19 where the share ρ² can be explained by another effect."""
    distinct = 1 - np.asarray(share)
    return np.where(distinct > SETTINGS.exact, np.sqrt(2 * SETTINGS.log_odds / np.maximum(distinct, SETTINGS.exact)), np.inf)


def list_pairs(signatures: Sequence[Signature], sizes: Sequence[Visible]) -> list[Pair]:
    """List the pairs of visible effects that take more than an SNR of `PlanSettings.limit_snr` to tell apart, the worst first.

    An imitation that takes an implausible size of the other does not count. Random effects are compared with one another;
    a pair of them counts if it takes as much more than the visible size as `PlanSettings.limit_snr` is more than the usual SNR.
    """
    visible = {signature.label: signature for signature in sizes if signature.verdict == "visible"}
    deterministic = [signature for signature in signatures if signature.label in visible and not signature.process]
    pairs = []
    if deterministic:
        rho, ratio = compute_confusion_shares(deterministic)
        snr = compute_separating_snr(rho)
        for i, j in np.argwhere(snr > SETTINGS.limit_snr):
            if i == j:
                continue
            signature = visible[deterministic[i].label]
            if ratio[i, j] * signature.best > EFFECTS[deterministic[j].effect].prior[1]:
                continue
            size = float(snr[i, j]) / float(deterministic[i].norms[deterministic[i].middle])
            pairs.append(Pair(signature.label, deterministic[j].label, float(rho[i, j]), float(snr[i, j]), size))
    random = [signature for signature in signatures if signature.label in visible and signature.process]
    for first in random:
        for second in random:
            if first.label != second.label:
                size = find_separating_size(first, second, visible[first.label].size)
                if size > SETTINGS.limit_snr / SETTINGS.snr * visible[first.label].size:
                    pairs.append(Pair(first.label, second.label, float("nan"), float("nan"), size))
    return sorted(pairs, key=lambda pair: (-np.nan_to_num(pair.snr, nan=0.0), pair.effect, pair.other))


def find_separating_size(signature: Signature, other: Signature, start: float) -> float:
    """Find the size of a random effect at which another differs by a divergence of ln 19 at its best size.

    With orthogonal columns X of squared lengths d and unit directions Q, S = I + r² X Xᵀ has S⁻¹ = I − Q g Qᵀ with
    g = r² d/(1 + r² d), so that the divergence

        ½ [tr(S_B⁻¹ S_A) − N + ln|S_B| − ln|S_A|]

    takes only the squared products of the directions of both.
    """
    A, B = signature.X[:, 0], other.X[:, 0]
    d_A, d_B = np.sum(A**2, axis=0), np.sum(B**2, axis=0)
    cross = ((B / np.sqrt(np.maximum(d_B, 1e-300))).T @ A) ** 2  # (r_B, r_A)
    sizes = start * np.geomspace(0.3, 30.0, 41)
    gain = np.geomspace(1e-3, 1e5, 120)[:, None] / max(float(d_B.max()), 1e-300) * d_B  # (q, r_B): r² d
    g = gain / (1 + gain)
    squared = sizes**2
    mixed = squared[:, None] * (d_A.sum() - g @ cross.sum(axis=1)) - g.sum(axis=1)  # (s, q)
    log_A = np.log1p(squared[:, None] * d_A).sum(axis=1)
    divergence = 0.5 * (mixed + np.log1p(gain).sum(axis=1) - log_A[:, None]).min(axis=1)
    enough = np.flatnonzero(divergence >= SETTINGS.log_odds)
    return float(sizes[enough[0]]) if enough.size else float("inf")
