"""Numbers of an effect that are no amplitudes: a time constant, the size of a field.

A search takes them from a few options. Between those lies up to half a step, which in thousands of measurements is seen, as a
discrepancy that no effect explains, or as a size that is off by sigmas. So they are moved to where the sum of squares χ², with
the amplitudes and all nuisance parameters fitted, is least. At the minimum the derivative of the error by the logarithm of each
is one more column, which says how well it is known; options about a sigma apart then stand for its posterior, and the
amplitudes, averaged over them, have its uncertainty in theirs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from diagnosis.model.sensors.arcs import FittedArc
from diagnosis.model.sensors.columns import Held, effect_of, held_columns
from simulator.effects.base import Value

Array = NDArray[np.float64]

FIRST_STEP = 0.15  # of a logarithm
ENOUGH = 0.004  # of a logarithm
ENOUGH_CHI2 = 0.01
MOST_TRIALS = 60
STEP = 0.05  # of a logarithm, for the derivative; fields are seen in steps of the sampling
AROUND = 1.25 * np.arange(-2, 3)  # sigmas at which options stand; under a normal density they have nearly its variance


def refined(fits: Sequence[FittedArc], held: Mapping[str, Held]) -> dict[str, Held]:
    """Effects by label with their parameters moved to the least χ², the amplitudes that fit there, and options around.

    Parameters
    ----------
    fits : the arcs under M0
    held : what to start from
    """
    places = _places(held)
    if not places:
        return dict(held)

    def chi2(x: Array) -> float:
        _, left = _solved(fits, _moved(held, places, x))
        return left

    start = np.array([np.log(float(held[label].parameters[name])) for label, name in places])
    simplex = start + np.vstack([np.zeros(start.size), FIRST_STEP * np.eye(start.size)])
    options = {"initial_simplex": simplex, "xatol": ENOUGH, "fatol": ENOUGH_CHI2, "maxfev": MOST_TRIALS}
    x = minimize(chi2, start, method="Nelder-Mead", options=options).x
    best = _moved(held, places, x)
    amplitudes, _ = _solved(fits, best)
    out, begin = {}, 0
    for label, one in best.items():
        out[label] = replace(one, amplitudes=amplitudes[begin : begin + one.amplitudes.size])
        begin += one.amplitudes.size
    return {label: replace(one, others=others) for (label, one), others in zip(out.items(), _around(fits, out), strict=True)}


def _around(fits: Sequence[FittedArc], held: Mapping[str, Held]) -> list[tuple[dict[str, Value], ...]]:
    """Of each effect, parameters at a few sigmas from those held."""
    places = _places(held)
    x = np.array([np.log(float(held[label].parameters[name])) for label, name in places])
    covariance = _covariance(fits, held, places, x)
    out = []
    for label, one in held.items():
        own = [k for k, (other, _) in enumerate(places) if other == label]
        values, vectors = np.linalg.eigh(covariance[np.ix_(own, own)])
        factor = vectors * np.sqrt(np.maximum(values, 0.0))
        steps = [np.array(step) for step in product(AROUND, repeat=len(own)) if np.any(step)]
        moved = [_moved({label: one}, [places[k] for k in own], x[own] + factor @ step) for step in steps]
        out.append(tuple(dict(there[label].parameters) for there in moved))
    return out


def _covariance(fits: Sequence[FittedArc], held: Mapping[str, Held], places: Sequence[tuple[str, str]], x: Array) -> Array:
    """(q, q) of the logarithms of the parameters, all amplitudes fitted too."""
    total = None
    for fitted in fits:
        columns = [held_columns(fitted, held)]
        for step in STEP * np.eye(x.size):
            high, low = (_along(fitted, _moved(held, places, x + way * step)) for way in (1, -1))
            columns.append(((high - low) / (2 * STEP))[:, None])
        gram, _ = fitted.gram(np.hstack(columns))
        total = gram if total is None else total + gram
    assert total is not None
    return _inverse(total[:-1, :-1])[-x.size :, -x.size :]


def _places(held: Mapping[str, Held]) -> list[tuple[str, str]]:
    return [(label, name) for label in held for name in effect_of(label)[0].refined]


def _moved(held: Mapping[str, Held], places: Sequence[tuple[str, str]], x: Array) -> dict[str, Held]:
    """With other parameters, between half the least and twice the largest of the options."""
    out = dict(held)
    for (label, name), value in zip(places, x, strict=True):
        options = [float(option[name]) for option in effect_of(label)[0].options]
        changed: dict[str, Value] = {
            **out[label].parameters,
            name: float(np.clip(np.exp(value), min(options) / 2, 2 * max(options))),
        }
        out[label] = Held(out[label].amplitudes, changed)
    return out


def _solved(fits: Sequence[FittedArc], held: Mapping[str, Held]) -> tuple[Array, float]:
    """Amplitudes of all effects together, and χ² with them."""
    total = None
    for fitted in fits:
        gram, _ = fitted.gram(held_columns(fitted, held))
        total = gram if total is None else total + gram
    assert total is not None
    amplitudes = _inverse(total[:-1, :-1]) @ total[:-1, -1]
    return amplitudes, float(total[-1, -1] - amplitudes @ total[:-1, -1])


def _inverse(gram: Array) -> Array:
    """Pseudo-inverse, columns brought to one length first."""
    norms = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    return np.asarray(np.linalg.pinv(gram * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale))


def _along(fitted: FittedArc, held: Mapping[str, Held]) -> Array:
    """(r,) errors of some effects at their amplitudes, in sigmas."""
    amplitudes = np.concatenate([one.amplitudes for one in held.values()])
    return np.asarray(held_columns(fitted, held) @ amplitudes)
