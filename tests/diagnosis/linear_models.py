"""Linear models made by hand: columns of any kind, with or without nuisance parameters."""

import numpy as np

from diagnosis.model.linear import Candidate, LinearModel, ParameterChoice

SCALES = np.geomspace(0.3, 30, 9)


def candidate(number, parts, start, share, **changes):
    """A candidate whose options are arrays of columns, of equal weight; its columns begin at `start`."""
    options = []
    for part in parts:
        options.append(ParameterChoice(start, part.shape[1], -float(np.log(len(parts))), {}))
        start += part.shape[1]
    given = {"effect": f"e{number}", "axis": None, "listed": True, "log_prior": share, "scales": SCALES, "unit": ""}
    return Candidate(options=tuple(options), **(given | changes))


def linear_model(columns, y, nuisance=None, changes=(), **further):
    """A model with a candidate for each entry: columns (N, k), or a list of them that are its options; nuisance is (N, q)."""
    changes = dict(changes)
    Q = np.empty((len(y), 0)) if nuisance is None else np.linalg.qr(nuisance)[0]

    def projected(values):
        return values - Q @ (Q.T @ values)

    parts = [list(one) if isinstance(one, list | tuple) else [one] for one in columns]
    candidates, start = [], 0
    for number, options in enumerate(parts):
        candidates.append(candidate(number, options, start, -float(np.log(len(parts))), **changes.get(number, {})))
        start += sum(part.shape[1] for part in options)
    W = np.hstack([part for options in parts for part in options])
    return LinearModel(
        y=projected(y),
        X=projected(W),
        W=W,
        candidates=tuple(candidates),
        dof=len(y) - Q.shape[1],
        projected=projected,
        **further,
    )
