"""Reduction of the misfit by an explanation on held-out data.

Each fold of a linear model (`diagnosis.model.linear.Fold`) holds out one part of the data and trains on the rest. Let e be the
error of M0's prediction of the held-out part from the training part, whitened by its covariance under M0. The measure *before*
is eᵀe over its degrees of freedom. Its expectation is one if M0 is true, and that is the *floor*. For *after*, the amplitudes
of the explanation are estimated on the training part alone. Their prediction is subtracted from e, and the rest is measured in
the same metric, so that an effect cannot gain by claiming more noise. Then

    closed = 1 − (after − floor)/(before − floor).

All data choose which effects are in the explanation. A random process closes as much as the training part predicts of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from diagnosis.answer import Closure
from diagnosis.model.linear import Fold, LinearModel, SelectedCandidate
from gyrocal.arrays import Array

MEASURE = "held-out whitened mean square"
LEAST_MISFIT = 1e-6


def compute_closure(model: LinearModel, members: Sequence[SelectedCandidate]) -> Closure | None:
    """Compute how far an explanation closes the misfit on held-out data.

    Parameters
    ----------
    model : the data and its candidates
    members : the explanation. Amplitudes of unlisted members are estimated on the training part and predict nothing

    Returns
    -------
    None where nothing can be held out
    """
    listed = sorted(members, key=lambda member: not model.candidate(member).listed)
    places, scale, shifts = model.build_design(listed)
    listed_count = model.build_design([member for member in listed if model.candidate(member).listed])[0].size
    columns = np.hstack([model.W[:, places] * scale, model.W[:, shifts].sum(axis=1)[:, None]])
    folds = list(model.folds(columns))
    errors = [_predict(fold, listed_count) for fold in folds]
    return average_closure(errors, folds, model.split) if folds else None


def _predict(fold: Fold, listed_count: int) -> Array:
    """Compute the errors (s, 2) of the held-out rows before and after the prediction by the listed members and the shift.

    The amplitudes have the prior of the evidence, so that a fold invents no amplitude that it cannot see.
    """
    A, shift = fold.train_X[:, :-1], fold.train_X[:, -1]
    amplitudes = np.linalg.solve(np.eye(A.shape[1]) + A.T @ A, A.T @ (fold.train_y - shift))
    predicted = fold.left_X[:, :listed_count] @ amplitudes[:listed_count] + fold.left_X[:, -1]
    return np.column_stack([fold.left_y, fold.left_y - predicted])


def average_closure(errors: Sequence[Array], folds: Sequence[Fold], split: str) -> Closure:
    """Average squares of errors (s, 2), before and after, over all folds, of each interval and of all."""
    names = list(dict.fromkeys(str(name) for fold in folds for name in fold.owner))
    table = np.zeros((len(names), 3))
    for error, fold in zip(errors, folds, strict=True):
        for name, dof in fold.dof.items():
            # A builder that compressed its rows keeps their square sums, and their degrees of freedom in `dof`.
            table[names.index(name)] += [*(error[fold.owner == name] ** 2).sum(axis=0), dof]
    degrees = table[:, 2]
    before, after = (float(value) for value in table[:, :2].sum(axis=0) / degrees.sum())
    gap = before - 1.0
    closed = 1.0 - (after - 1.0) / gap if abs(gap) > LEAST_MISFIT else 0.0
    # The noise of the held-out data is in both; what it adds to the difference from the floor scatters by √(2/dof).
    spread = 1.645 * float(np.sqrt(2.0 / degrees.sum())) / max(abs(gap), LEAST_MISFIT)
    by_interval = pd.DataFrame(
        {"interval": names, "before": table[:, 0] / degrees, "after": table[:, 1] / degrees, "floor": 1.0, "dof": degrees}
    )
    return Closure(MEASURE, split, before, after, 1.0, closed, (closed - spread, closed + spread), by_interval)
