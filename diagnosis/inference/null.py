"""Test for a misfit: the evidence of all candidates together against its distribution under M0.

Options that a scan has chosen for the data at hand have no such distribution over other data. Their evidence, averaged over all
options that were tried, is bounded instead: an average B of likelihood ratios has P(B ≥ c) ≤ 1/c under M0, and options that the
scan dropped would only add to it. The two tests share the rate of false alarms (`DiagnosisSettings.scanned_share`).

The draws take the columns X as given, while those of a recording come from readings with noise of their own. Two things could
make its statistic another one. The observations y = (I − P) L⁻¹ ζ are the linear response to the noise up to a shift δ: second
order in ζ (`diagnosis.model.linearise`) and the motion inside a sample. It moves the score z = xᵀy/|x| of a column by
|δ| at most, and the probability beyond z by a factor of up to about exp(z |δ|). Columns that follow the rates are x + e, with
e the noise that smoothing has left; their score is N(0, 1) given e unless e goes with y, and its square then exceeds one on
average. Whether either matters is seen where the noise is known, as the difference from the statistic of the linear response
to that noise about the true motion.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import logsumexp

from diagnosis.inference.search import Search
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array

LEAST_POSITIVE = 1e-300
DRAWS_PER_BATCH = 250  # draws

ENOUGH = 20  # draws beyond the observed statistic, after which drawing ends
TAIL = 0.1  # share of the draws that the tail is fitted to
EXPONENTIAL = 1e-6  # shape below which a tail is exponential


def compute_null_p(
    search: Search,
    seed: int,
    draws: int,
    scanned_share: float = DEFAULT.scanned_share,
    report_share: Callable[[float], None] = lambda share: None,
) -> float:
    """Compute the p-value of the evidence averaged over all candidates.

    It comes from draws under M0; if few of them exceed the observed statistic, from their tail (`extrapolate_tail`); and if
    draws cannot resolve it, from the bound P(B ≥ c) ≤ 1/c on an average of likelihood ratios, without draws. Drawing ends when
    `ENOUGH` draws exceed the observed statistic: if the l-th draw is the h-th that exceeds it, h/l is a p-value as exact as
    that of all draws (Besag and Clifford, Biometrika 78 (1991) 301).

    Parameters
    ----------
    search : over the candidates
    seed : of the draws
    draws : their number
    scanned_share : of the false alarms, that what a scan has chosen may have
    report_share : called with the share of the draws that are done
    """
    observed = search.compute_observed_statistic()
    bound = float(np.exp(-max(observed, 0.0)))
    if bound * (1 + draws) < 1:
        return _combine_scanned_p(search, bound, scanned_share)
    null = draw_null_statistics(search, seed, draws, report_share, observed)
    unscanned_p = ENOUGH / null.size if null.size < draws else extrapolate_tail(null, observed)
    return _combine_scanned_p(search, unscanned_p, scanned_share)


def extrapolate_tail(null: Array, observed: float) -> float:
    """Estimate the p-value of the observed statistic among draws (n,), with a smooth tail.

    Fewer than `ENOUGH` draws beyond it are a coarse estimate, and none is no estimate at all. A generalised Pareto distribution
    is fitted to what the largest draws exceed a threshold by (Knijnenburg et al., Bioinformatics 25, 2009), by the method of
    probability-weighted moments (Hosking and Wallis, Technometrics 29, 1987). A shape below zero, whose tail has an end, is
    taken as zero, an exponential tail.
    """
    beyond = int(np.sum(null >= observed))
    count = int(TAIL * null.size)
    if beyond >= ENOUGH or count < ENOUGH:
        return (1 + beyond) / (1 + null.size)
    top = np.sort(null)[-count - 1 :]
    excess = top[1:] - top[0]
    ranks = (np.arange(count) + 0.65) / count
    mean, weighed = float(excess.mean()), float(np.mean((1 - ranks) * excess))
    shape = max(2 - mean / max(mean - 2 * weighed, LEAST_POSITIVE), 0.0)
    size = mean * (1 - shape)
    z = (observed - top[0]) / max(size, LEAST_POSITIVE)
    tail = np.exp(-z) if shape < EXPONENTIAL else (1 + shape * z) ** (-1 / shape)
    return float(count / null.size * tail)


def draw_null_statistics(
    search: Search,
    seed: int,
    draws: int,
    report_share: Callable[[float], None] = lambda share: None,
    observed: float = np.inf,
) -> Array:
    """Draw the statistic under M0, whose distribution does not depend on the observations.

    Returns `draws` values, or those up to the one at which `ENOUGH` have reached the observed statistic.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"diagnosis_null")))
    noise = search.model.projected(rng.standard_normal((search.model.y.size, draws)))
    # Some at a time: there are thousands of candidates' columns, and several numbers for each of their products.
    drawn = np.empty(0)
    for k in range(0, draws, DRAWS_PER_BATCH):
        report_share(k / draws)
        drawn = np.append(drawn, search.compute_null_statistic(search.model.X.T @ noise[:, k : k + DRAWS_PER_BATCH]))
        beyond = np.flatnonzero(drawn >= observed)
        if beyond.size >= ENOUGH:
            return np.asarray(drawn[: beyond[ENOUGH - 1] + 1])
    return drawn


def _combine_scanned_p(search: Search, unscanned_p: float, scanned_share: float) -> float:
    """Combine the p-values of both tests, given that of the candidates whose options no scan has chosen."""
    listed = [candidate for candidate in search.model.candidates if candidate.scanned and candidate.listed]
    if not listed:
        return max(unscanned_p, LEAST_POSITIVE)
    prior = float(logsumexp([candidate.log_prior for candidate in listed]))
    scanned_bound = float(np.exp(min(prior - search.compute_observed_statistic(scanned=True), 0.0)))
    return max(min(unscanned_p / (1 - scanned_share), scanned_bound / scanned_share, 1.0), LEAST_POSITIVE)
