"""The diagnosis of a printed table: a few numbers, jointly normal under the baseline, as data of the linear model.

Observations d are flown minus simulated, with the covariance Σ = L Lᵀ under the baseline; observations and columns are whitened
by L. Beside the listed causes there are unlisted rivals, a random difference of any size in some of the numbers.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.inference.search import Explanation, Search
from diagnosis.model.candidates import place_candidates
from diagnosis.model.folds import build_normal_fold
from diagnosis.model.linear import CandidateColumns, LinearModel
from diagnosis.settings import DEFAULT
from gyrocal.arrays import Array

WIDTH = 40  # sets of each size that are extended
HOPELESS = 6.0  # log posterior: if the best set of a size is further below the best of all, no set is extended
UNKNOWN_NAME = "unknown"  # every rival's name begins with it


def whiten(L: Array, values: Array) -> Array:
    """Whiten values, to sigmas."""
    return np.asarray(scipy.linalg.solve_triangular(L, values, lower=True))


def make_candidate(
    effect: str, axis: str | None, columns: Array, unit: str, limits: tuple[float, float] = (0.0, np.inf), **attributes: Any
) -> CandidateColumns:
    """Make a cause with one set of whitened columns; further attributes as of `CandidateColumns`."""
    return CandidateColumns(effect, axis, True, [columns], [{}], np.ones(1), limits, unit, **attributes)


def make_rival(effect: str, axis: str | None, columns: Array, unit: str, limits: tuple[float, float]) -> CandidateColumns:
    """Make a random difference of any size within limits."""
    return CandidateColumns(f"{UNKNOWN_NAME} in {effect}", axis, False, [columns], [{}], np.ones(1), limits, unit, process=True)


def build_model(
    d: Array,
    covariance: Array,
    groups: Sequence[CandidateColumns],
    owner: NDArray[np.str_],
    held: Iterable[str],
    split: str,
    most_effects: int,
) -> LinearModel:
    """Build the linear model of a table.

    Parameters
    ----------
    d, covariance : (n,), (n, n) flown minus simulated under the baseline
    groups : candidates with whitened columns (n, k)
    owner, held, split : (n,) group of each number, groups that are held out in turn, and the kind of group in words
    """
    L = np.asarray(np.linalg.cholesky(covariance))
    candidates, W = place_candidates(groups, lambda columns: columns, DEFAULT, d.size)
    return LinearModel(
        y=whiten(L, d),
        X=W,
        W=W,
        candidates=candidates,
        dof=d.size,
        projected=lambda values: values,
        most_effects=most_effects,
        split=split,
        folds=lambda W: (build_normal_fold(covariance, d, L @ W, owner == name, owner) for name in held),
    )


def rank_explanations(model: LinearModel, nothing: float) -> list[Explanation]:
    """Rank the explanations of a table's difference by posterior; `nothing` is the prior share of chance alone.

    A table has few and flexible candidates, so that the best sets of each size are extended in parallel: one of several timings
    alone explains little.
    """
    search = Search(model)
    best_by_key = {explanation.key: explanation for explanation in search.score_singles()}
    level = list(best_by_key.values())
    for _ in range(model.most_effects - 1):
        children = [child for parent in level[:WIDTH] for child in search.list_children(parent)]
        # Each set once, by its likeliest child, since the last one of a key stays: ascending, and then descending again.
        likeliest = list({child.key: child for child in sort_by_posterior(children)[::-1]}.values())[::-1]
        level = sort_by_posterior([search.optimise_members(explanation.members) for explanation in likeliest[: 2 * WIDTH]])
        best = max(explanation.log_posterior for explanation in best_by_key.values())
        best_by_key |= {explanation.key: explanation for explanation in level}
        if level[0].log_posterior < best - HOPELESS:
            break
    return sort_by_posterior([*best_by_key.values(), Explanation((), 0.0, float(np.log(nothing)))])


def sort_by_posterior(explanations: Iterable[Explanation]) -> list[Explanation]:
    """Sort explanations, the likeliest first."""
    return sorted(explanations, key=lambda explanation: -explanation.log_posterior)
