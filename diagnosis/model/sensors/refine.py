"""Numbers of an effect that are no amplitudes: a time constant, the size of a field.

A search takes them from a few options. Between those lies up to half a step, which in thousands of measurements is seen, as a
discrepancy that no effect explains, or as a size that is off by sigmas. So they are moved to where the sum of squares χ², with
the amplitudes and all nuisance parameters fitted, is least. It has steps, as a field is seen in steps of the sampling. At the
minimum the derivative of the error by the logarithm of each is one more column, which says how well it is known. Options about
a sigma apart then stand for its posterior, and the amplitudes, averaged over them, have its uncertainty in theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.optimize import minimize

from diagnosis.model.sensors.arcs import FittedArc
from diagnosis.model.sensors.columns import HeldAmplitudes, build_held_columns, find_sensor_effect
from gyrocal.arrays import Array
from simulator.effects.base import Value

Places = Sequence[tuple[str, str]]  # label and name of each parameter

FIRST = 0.15  # step of the search for the least χ², less than half that between options
# spread of the parameters and of χ² that ends the search, both far below a sigma
ENOUGH = 0.004
ENOUGH_CHI2 = 0.01
TRIALS = 60  # at most
STEP = 0.05  # for the derivative, over several steps of χ²
# sigmas at which options stand; under a normal density they have nearly its variance
AROUND = (-2.5, -1.25, 0.0, 1.25, 2.5)


def refine_parameters(fits: Sequence[FittedArc], settings: Mapping[str, HeldAmplitudes]) -> dict[str, HeldAmplitudes]:
    """Move the parameters of effects, by label, to the least χ², with the amplitudes that fit there and options around."""
    places = [(label, name) for label in settings for name in find_sensor_effect(label)[0].refined]
    if not places:
        return dict(settings)

    def solve(change: Array) -> tuple[Array, float]:
        """Solve for the amplitudes of all effects together with changed parameters; also χ² with them."""
        moved = _move_parameters(settings, places, change)
        gram = _sum_grams(fits, lambda fitted: build_held_columns(fitted, moved))
        amplitudes = _invert_scaled(gram[:-1, :-1]) @ gram[:-1, -1]
        return amplitudes, float(gram[-1, -1] - amplitudes @ gram[:-1, -1])

    simplex = np.vstack([np.zeros(len(places)), FIRST * np.eye(len(places))])
    options = {
        "initial_simplex": simplex, "xatol": ENOUGH, "fatol": ENOUGH_CHI2, "maxfev": TRIALS
    }  # fmt: skip
    change = minimize(lambda x: solve(x)[1], simplex[0], method="Nelder-Mead", options=options).x
    amplitudes, improved, start = solve(change)[0], _move_parameters(settings, places, change), 0
    for label, setting in improved.items():
        improved[label] = replace(setting, amplitudes=amplitudes[start : start + setting.amplitudes.size])
        start += setting.amplitudes.size
    covariance = _estimate_parameter_covariance(fits, improved, places)
    return {
        label: replace(setting, others=_list_near_parameters(label, setting, places, covariance))
        for label, setting in improved.items()
    }


def _list_near_parameters(
    label: str, fitted: HeldAmplitudes, places: Places, covariance: Array
) -> tuple[Mapping[str, Value], ...]:
    """List an effect's parameters on a grid around the fitted ones, in sigmas along the principal axes of their covariance."""
    indices = [k for k, (effect_label, _) in enumerate(places) if effect_label == label]
    variances, directions = np.linalg.eigh(covariance[np.ix_(indices, indices)])
    axes = directions * np.sqrt(np.maximum(variances, 0.0))
    steps = [axes @ sigmas for sigmas in product(AROUND, repeat=len(indices)) if np.any(sigmas)]
    return tuple(_move_parameters({label: fitted}, [places[k] for k in indices], step)[label].parameters for step in steps)


def _estimate_parameter_covariance(fits: Sequence[FittedArc], settings: Mapping[str, HeldAmplitudes], places: Places) -> Array:
    """Estimate the covariance (q, q) of the logarithms of the parameters, all amplitudes fitted too."""
    amplitudes = np.concatenate([setting.amplitudes for setting in settings.values()])

    def columns(fitted: FittedArc) -> Array:
        ends = [
            [build_held_columns(fitted, _move_parameters(settings, places, sign * step)) @ amplitudes for sign in (1, -1)]
            for step in STEP * np.eye(len(places))
        ]
        return np.column_stack([build_held_columns(fitted, settings), *((high - low) / (2 * STEP) for high, low in ends)])

    return _invert_scaled(_sum_grams(fits, columns)[:-1, :-1])[-len(places) :, -len(places) :]


def _move_parameters(settings: Mapping[str, HeldAmplitudes], places: Places, change: Array) -> dict[str, HeldAmplitudes]:
    """Change parameters by a logarithm each, between half the least and twice the largest of the options."""
    moved = dict(settings)
    for (label, name), log_factor in zip(places, change, strict=True):
        options = [float(option[name]) for option in find_sensor_effect(label)[0].options]
        value = float(np.clip(float(settings[label].parameters[name]) * np.exp(log_factor), min(options) / 2, 2 * max(options)))
        moved[label] = replace(moved[label], parameters={**moved[label].parameters, name: value})
    return moved


def _sum_grams(fits: Sequence[FittedArc], columns: Callable[[FittedArc], Array]) -> Array:
    """Sum the products of columns and residuals of all arcs, the residuals last."""
    return np.asarray(sum(fitted.gram(columns(fitted))[0] for fitted in fits))


def _invert_scaled(gram: Array) -> Array:
    """Compute the pseudo-inverse of a Gram matrix, columns scaled to one length first."""
    norms = np.sqrt(np.diag(gram))
    scale = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    return np.asarray(np.linalg.pinv(gram * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale))
