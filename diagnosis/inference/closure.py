"""How far the gap shrinks, measured on held-out data.

Each fold of a linear model (`diagnosis.model.linear.Fold`) holds out one part of the data and trains on the rest. Let e be the
error of M0's prediction of the held-out part from the training part, whitened by its covariance under M0. The measure *before*
is eᵀe over its degrees of freedom. Its expectation is one if M0 is true, and that is the *floor*. For *after*, the fold
searches for explanations and estimates their amplitudes on its training part alone. Their predictions, weighted by the
explanations' probabilities, are subtracted from e, and the rest is measured in the same metric, so that an effect cannot gain
by claiming more noise. Then

    closed = 1 − (after − floor)/(before − floor).

A random process does not predict residuals, only how far they scatter. Where the cause is one, the measure is the log score
eᵀe + log |C|, in which each model uses its own covariance C of the prediction; the floor is its expectation if the C of the
model with the process is true.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.answer import Closure
from diagnosis.inference.search import Search, total
from diagnosis.model.linear import Fold, LinearModel, Member

Array = NDArray[np.float64]
Weighted = Sequence[tuple[float, Sequence[Member]]]
Chooser = Callable[[Search], Weighted]

TINY = 1e-6
USUAL_SCORES = 1000  # of a fold's search
LEAST_WEIGHT = 0.005  # of an explanation, below which a fold's prediction does without it


def found_by(depth: int) -> Chooser:
    """Chooser that searches the training part for sets of up to `depth` effects."""

    def choose(search: Search) -> Weighted:
        explanations = search.explanations(depth)
        top = total(explanations)
        weights = [float(np.exp(one.log_posterior - top)) for one in explanations]
        likely = [(w, one.members) for w, one in zip(weights, explanations, strict=True) if w > LEAST_WEIGHT]
        return [(w * share, at) for w, members in likely for share, at in search.over_options(members)]

    return choose


def fixed(labels: tuple[str, ...]) -> Chooser:
    """Chooser of one given explanation; its amplitudes are still those of the training part."""

    def choose(search: Search) -> Weighted:
        explanation = search.of(labels)
        return [] if explanation is None else [(1.0, explanation.members)]

    return choose


def closure(
    model: LinearModel,
    members: Sequence[Member],
    choose: Chooser | None = None,
    tell: Callable[[float], None] = lambda done: None,
) -> Closure | None:
    """Closure of the gap on held-out data.

    Parameters
    ----------
    model : the data and its candidates
    members : the explanation that is named; it says how many effects a fold looks for, and whether one is a random process.
        Unlisted ones among them weigh what a fold learns from, and predict nothing
    choose : explanations that a fold comes to, given its search; by default the search among the listed effects
    tell : called with the number of folds that are done, and with parts of one as its search goes on

    Returns
    -------
    None where nothing can be held out
    """
    chooser = found_by(len(members)) if choose is None else choose
    return measured(learnable(model, members), is_random(model, members), chooser, tell)


def is_random(model: LinearModel, members: Sequence[Member]) -> bool:
    """Whether one of the listed effects of an explanation is a random process."""
    return any(model.candidate(member).process and model.candidate(member).listed for member in members)


def learnable(model: LinearModel, members: Sequence[Member]) -> LinearModel:
    """What a fold learns of, with its whitened columns alone, so that the model it is from may be let go."""
    labels = [model.candidate(member).label for member in members]
    listed = model.keeping(lambda candidate: candidate.listed or candidate.label in labels)
    for label, member in zip(labels, members, strict=True):
        # Options are made finer around what was found; each fold still chooses among all of them.
        place = listed.find(label)
        assert place is not None
        listed = listed.refine(listed, replace(member, candidate=place))
    chosen, candidates = listed.renumbered()
    return replace(listed, candidates=candidates, X=model.X[:, :0].copy(), W=listed.W[:, chosen], room=None)


def measured(
    listed: LinearModel, random: bool, choose: Chooser, tell: Callable[[float], None] = lambda done: None
) -> Closure | None:
    """Closure of the gap by what each fold learns of some candidates; parameters as of `closure`."""
    parts: list[Array] = []
    left: list[Fold] = []
    for fold in listed.folds(listed.W[:, :]):
        tell(len(left))
        own = Search(replace(listed, X=fold.train_X, W=fold.train_X, y=fold.train_y), tell=_counted(tell, len(left)))
        parts.append(_one(listed, fold, choose(own), random))
        left.append(without_columns(fold))
        del fold, own  # or their columns would be there while those of the next one are made
    return summed(parts, left, listed.split, random) if parts else None


def _counted(tell: Callable[[float], None], done: int) -> Callable[[int], None]:
    """Progress of a fold's search, where how many scores it needs is known only roughly."""
    return lambda count: tell(done + count / (count + USUAL_SCORES))


def without_columns(fold: Fold) -> Fold:
    """A fold that is done with: its columns are a hundred megabytes of a long recording."""
    return replace(fold, train_X=fold.train_X[:, :0].copy(), left_X=fold.left_X[:, :0].copy())


def _one(model: LinearModel, fold: Fold, weighted: Weighted, random: bool) -> Array:
    """(s, 3) the measure of each row held out: before, after, floor; predicted by what the fold has come to."""
    before = fold.left_y
    log = fold.log_scale if random else np.zeros(before.size)
    if not weighted:
        return np.column_stack([before**2 + log, before**2 + log, 1 + log])
    after = before.copy()
    for weight, members in weighted:
        places, scale, shifts = model.design(sorted(members, key=lambda member: not model.candidate(member).listed))
        amplitudes, _ = _amplitudes(fold.train_X[:, places] * scale, fold.train_y - fold.train_X[:, shifts].sum(axis=1))
        own = model.design([member for member in members if model.candidate(member).listed])[0]
        predicted = fold.left_X[:, own] @ (scale * amplitudes)[: own.size] + fold.left_X[:, shifts].sum(axis=1)
        after = after - weight * predicted
    if not random:
        return np.column_stack([before**2, after**2, np.ones(before.size)])
    # The scatter that the likeliest explanation claims for the part held out.
    places, scale, _ = model.design(max(weighted, key=lambda pair: pair[0])[1])
    _, information = _amplitudes(fold.train_X[:, places] * scale, fold.train_y)
    B = fold.left_X[:, places] * scale
    factor = np.linalg.cholesky(np.eye(before.size) + B @ np.linalg.solve(information, B.T))
    own = scipy.linalg.solve_triangular(factor, after, lower=True, check_finite=False)
    more = log + 2 * np.log(np.diag(factor))
    return np.column_stack([before**2 + log, own**2 + more, 1 + more])


def _amplitudes(A: Array, y: Array) -> tuple[Array, Array]:
    """Amplitudes in units of the scale that the evidence gives them, and their information.

    With that prior, an amplitude that a fold cannot see is not invented.
    """
    information = np.eye(A.shape[1]) + A.T @ A
    return np.asarray(np.linalg.solve(information, A.T @ y)), np.asarray(information)


def summed(parts: list[Array], folds: Sequence[Fold], split: str, random: bool) -> Closure:
    """Means over all folds, of each interval and of all, over their degrees of freedom."""
    names = list(dict.fromkeys(str(name) for fold in folds for name in fold.owner))
    table = np.zeros((len(names), 4))
    for part, fold in zip(parts, folds, strict=True):
        for name, dof in fold.dof.items():
            own = part[fold.owner == name]
            # A builder that compressed its rows keeps their square sums; what M0 leaves on average is their degrees of freedom.
            table[names.index(name)] += [*own[:, :2].sum(axis=0), own[:, 2].sum() * dof / len(own), dof]
    return _closure(names, table, split, random)


def _closure(names: list[str], table: Array, split: str, random: bool) -> Closure:
    dof = table[:, 3]
    before, after, floor = (float(value) for value in table[:, :3].sum(axis=0) / dof.sum())
    gap = before - floor
    closed = 1.0 - (after - floor) / gap if abs(gap) > TINY else 0.0
    # The noise of the data held out is in both; what it adds to the difference from the floor scatters by √(2/dof).
    spread = 1.645 * float(np.sqrt(2.0 / dof.sum())) / max(abs(gap), TINY)
    frame = pd.DataFrame(
        {"interval": names, "before": table[:, 0] / dof, "after": table[:, 1] / dof, "floor": table[:, 2] / dof, "dof": dof}
    )
    return Closure(
        measure="held-out log score" if random else "held-out whitened mean square",
        split=split,
        before=before,
        after=after,
        floor=floor,
        closed=float(closed),
        interval_90=(float(closed - spread), float(closed + spread)),
        by_interval=frame,
    )
