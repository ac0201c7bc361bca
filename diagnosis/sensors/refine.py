"""Numbers of an effect that are no amplitudes: a time constant, the size of a field.

A search takes them from a few options. Between those lies up to half a step, which in thousands of measurements is seen, as a
discrepancy that no effect explains, or as a size that is off by sigmas. So they are moved to where the sum of squares χ², the
amplitudes and all that M0 leaves free fitted, is least, and their uncertainty is made part of that of the amplitudes: at the
minimum the derivative of the error by the logarithm of each is one more column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from diagnosis.sensors.candidates import Held, effect_of, held_columns
from diagnosis.sensors.sizes import Sized
from diagnosis.sensors.spans import Fitted
from simulator.effects.base import Value

Array = NDArray[np.float64]

FIRST_STEP = 0.15  # of a logarithm
ENOUGH = 0.004  # of a logarithm
ENOUGH_CHI2 = 0.01
MOST_TRIALS = 60
STEP = 0.05  # of a logarithm, for the derivative; fields are seen in steps of the sampling


def refined(fits: Sequence[Fitted], held: Mapping[str, Held]) -> dict[str, Held]:
    """Effects by label with their parameters moved to the least χ², and the amplitudes that fit there.

    Parameters
    ----------
    fits : the stretches under M0
    held : what to start from
    """
    places = _places(held)
    if not places:
        return dict(held)

    def at(x: Array) -> dict[str, Held]:
        return _moved(held, places, x)

    def chi2(x: Array) -> float:
        _, left = _solved(fits, at(x))
        return left

    start = np.array([np.log(float(held[label].parameters[name])) for label, name in places])
    simplex = start + np.vstack([np.zeros(start.size), FIRST_STEP * np.eye(start.size)])
    options = {"initial_simplex": simplex, "xatol": ENOUGH, "fatol": ENOUGH_CHI2, "maxfev": MOST_TRIALS}
    best = at(minimize(chi2, start, method="Nelder-Mead", options=options).x)
    amplitudes, _ = _solved(fits, best)
    out, begin = {}, 0
    for label, one in best.items():
        out[label] = replace(one, amplitudes=amplitudes[begin : begin + one.amplitudes.size])
        begin += one.amplitudes.size
    return out


def widened(fits: Sequence[Fitted], found: Sequence[Sized]) -> tuple[Sized, ...]:
    """Effects with the uncertainty of their parameters in that of their sizes."""
    held = {one.label: one.held for one in found}
    places = _places(held)
    if not places:
        return tuple(found)
    x = np.array([np.log(float(held[label].parameters[name])) for label, name in places])
    total = None
    for fitted in fits:
        columns = [held_columns(fitted, held)]
        for k in range(x.size):
            step = STEP * np.eye(x.size)[k]
            high, low = (_along(fitted, _moved(held, places, x + way * step)) for way in (1, -1))
            columns.append(((high - low) / (2 * STEP))[:, None])
        gram, _ = fitted.gram(np.hstack(columns))
        total = gram if total is None else total + gram
    assert total is not None
    covariance = _inverse(total[:-1, :-1])
    out, begin = [], 0
    for one in found:
        own = slice(begin, begin + one.held.amplitudes.size)
        begin = own.stop
        length = np.linalg.norm(one.held.amplitudes)
        along = (
            one.held.amplitudes / length if length > 0 else np.full(one.held.amplitudes.size, one.held.amplitudes.size**-0.5)
        )
        block = covariance[own, own]
        out.append(replace(one, sigma=float(np.sqrt(along @ block @ along)), sigmas=np.sqrt(np.diag(block))))
    return tuple(out)


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


def _solved(fits: Sequence[Fitted], held: Mapping[str, Held]) -> tuple[Array, float]:
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


def _along(fitted: Fitted, held: Mapping[str, Held]) -> Array:
    """(r,) errors of some effects at their amplitudes, in sigmas."""
    amplitudes = np.concatenate([one.amplitudes for one in held.values()])
    return np.asarray(held_columns(fitted, held) @ amplitudes)
