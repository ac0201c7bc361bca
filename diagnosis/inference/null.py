"""Whether there is a gap: the evidence of all candidates together against its distribution under M0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.search import Search

Array = NDArray[np.float64]

TINY = 1e-300
AT_ONCE = 250  # draws


def p_value(search: Search, seed: int, draws: int) -> float:
    """P-value of the evidence averaged over all candidates.

    It comes from draws of M0, and beyond what those can resolve from the bound P(B ≥ c) ≤ 1/c on an average of likelihood
    ratios.

    Parameters
    ----------
    search : over the candidates
    seed : of the draws
    draws : their number
    """
    observed = search.null_statistic(search.correlation[:, None])[0]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(b"diagnosis_null")))
    noise = search.model.projected(rng.standard_normal((search.model.y.size, draws)))
    # Some at a time: there are thousands of candidates' columns, and several numbers for each of their products.
    parts = [search.null_statistic(search.model.X.T @ noise[:, k : k + AT_ONCE]) for k in range(0, draws, AT_ONCE)]
    null = np.concatenate(parts)
    simulated = (1 + int(np.sum(null >= observed))) / (1 + draws)
    bound = float(np.exp(-max(observed, 0.0)))
    return max(min(simulated, bound) if bound < 1 / (1 + draws) else simulated, TINY)
