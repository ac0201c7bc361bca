"""The options of an effect that swings with any period: its columns, and finer periods around those that were found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model import periods
from diagnosis.model.linear import LinearModel, Member, Option, Parameters
from diagnosis.model.recording import RecordingModel
from simulator.effects.base import AXES, Effect, Value

Array = NDArray[np.float64]

FINE_PERIODS = 8  # to either side of one that was found
MOST_ALIASES = 8  # of a period, around which the same is done
NEARLY, ENOUGH = 0.03, 12.0  # share of χ² and χ² by which an alias may explain less


def columns_of(model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value]) -> Array:
    """(N, k) whitened columns of an effect per unit of its amplitudes."""
    if effect.on_references:
        return model.whitened(model.reference_error(effect.reference_columns(model.references, axis, parameters)))
    return model.whitened(model.reading(effect.columns(model.stream, axis, parameters)))


def period_parameters(frequency: float, width: float) -> Parameters:
    """Period, s, and the sigma of a period that may be anywhere between an option and its neighbours; both from Hz."""
    return {"period_s": 1 / frequency, "period_sigma_s": width / np.sqrt(12) / frequency**2}


def swing_columns(model: RecordingModel, effect: Effect, axis: str, frequencies: Array) -> list[Array]:
    """(N, 2) whitened columns of a swing at several frequencies, Hz, in the effect's unit: that of the first decides on it."""
    found = periods.columns(model, AXES.index(axis), effect.on_references, frequencies)
    exact = columns_of(model, effect, axis, {"period_s": 1 / float(frequencies[0])})
    factor = float(np.sum(found[0] * exact) / np.sum(found[0] ** 2))
    return [factor * part for part in found]


def with_finer_periods(model: RecordingModel, linear: LinearModel, member: Member, effect: Effect) -> LinearModel:
    """The linear model with more periods of a swing, close together around the one at which a member is held and its aliases.

    Each of these options keeps half of its prior; the new ones, which reach to its neighbours, share as much as it had.
    """
    entry = linear.candidate(member)
    if not entry.scanned:
        return linear
    held = _aliases(linear, member)
    beside = np.array([k for k in range(-FINE_PERIODS, FINE_PERIODS + 1) if k]) / FINE_PERIODS
    near = np.array([_frequency(one) + _width(one) * beside for one in held])
    W = np.hstack(swing_columns(model, effect, str(entry.axis), near.ravel()))
    start = linear.W.shape[1]
    finer = [
        Option(start + 2 * (beside.size * k + i), 2, one.log_weight - float(np.log(beside.size)), parameters)
        for k, one in enumerate(held)
        for i, parameters in enumerate(period_parameters(float(f), _width(one) / FINE_PERIODS) for f in near[k])
    ]
    options = [replace(one, log_weight=one.log_weight - np.log(2)) if one in held else one for one in entry.options]
    return linear.with_options(member.candidate, [*options, *finer], W, model.projected(W))


def _aliases(linear: LinearModel, member: Member) -> list[Option]:
    """The option at which a swing is held, and others, none next to another, that explain nearly as much by themselves."""
    options, first = linear.candidate(member).options, linear.option(member)
    explained = {one.start: _explained(linear, one) for one in options}
    least = (1 - NEARLY) * explained[first.start] - ENOUGH
    found = [first]
    for one in sorted(options, key=lambda one: -explained[one.start]):
        apart = all(abs(_frequency(one) - _frequency(other)) > 2 * FINE_PERIODS * _width(first) for other in found)
        if len(found) < MOST_ALIASES and explained[one.start] >= least and apart:
            found.append(one)
    return found


def _explained(linear: LinearModel, option: Option) -> float:
    """χ² that an option explains by itself."""
    return float(np.sum((scipy.linalg.orth(linear.X[:, option.columns]).T @ linear.y) ** 2))


def _frequency(option: Option) -> float:
    return 1 / float(option.parameters["period_s"])


def _width(option: Option) -> float:
    """Between an option of a swing and its neighbours, Hz."""
    return float(option.parameters["period_sigma_s"]) * float(np.sqrt(12)) * _frequency(option) ** 2
