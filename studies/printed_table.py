"""The diagnosis of a printed table: a few numbers, jointly normal under the baseline, as one more source of the linear model.

Observations d are flown minus simulated, with the covariance Σ = L Lᵀ under the baseline; observations and columns are whitened
by L. Beside what may be named there are unlisted rivals, a random difference of any size in some of the numbers.
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

WIDTH = 40  # sets of each size that grow
HOPELESS = 6.0  # log posterior by which the best set of a size may fall below the best of all, beyond which none grows further
UNKNOWN_NAME = "unknown"  # every rival's name begins with it


def whiten(L: Array, values: Array) -> Array:
    """Values in sigmas."""
    return np.asarray(scipy.linalg.solve_triangular(L, values, lower=True))


def make_candidate(
    effect: str, axis: str | None, columns: Array, unit: str, limits: tuple[float, float] = (0.0, np.inf), **more: Any
) -> CandidateColumns:
    """A cause with one set of whitened columns; further attributes as of `CandidateColumns`."""
    return CandidateColumns(effect, axis, True, [columns], [{}], np.ones(1), limits, unit, **more)


def make_rival(effect: str, axis: str | None, columns: Array, unit: str, limits: tuple[float, float]) -> CandidateColumns:
    """A random difference of any size within limits."""
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
    """The linear model of a table.

    Parameters
    ----------
    d, covariance : (n,), (n, n) flown minus simulated under the baseline
    groups : candidates with whitened columns (n, k)
    owner, held, split : (n,) what each number belongs to, what is held out in turn, and what that is in words
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
    """Rank the explanations of a table's difference, the likeliest first; `nothing` is the prior share of chance alone.

    A table has few candidates and flexible ones, so that the best sets of each size grow side by side: one of several timings
    alone explains little.
    """
    search = Search(model)
    found = {one.key: one for one in search.score_singles()}
    level = list(found.values())
    for _ in range(model.most_effects - 1):
        children = [child for parent in level[:WIDTH] for child in search.list_children(parent)]
        likeliest = list({child.key: child for child in sort_by_posterior(children)[::-1]}.values())[::-1]
        level = sort_by_posterior([search.optimise_members(one.members) for one in likeliest[: 2 * WIDTH]])
        hopeless = level[0].log_posterior < max(one.log_posterior for one in found.values()) - HOPELESS
        found |= {one.key: one for one in level}
        if hopeless:
            break
    return sort_by_posterior([*found.values(), Explanation((), 0.0, float(np.log(nothing)))])


def sort_by_posterior(explanations: Iterable[Explanation]) -> list[Explanation]:
    """Explanations, the likeliest first."""
    return sorted(explanations, key=lambda explanation: -explanation.log_posterior)
