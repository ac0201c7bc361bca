"""How large the effects of an explanation are, what an orthogonal matrix absorbs of a head, and how far the gap closes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.answer import Closure
from diagnosis.inference.search import Explanation, Member, total
from diagnosis.sensors.candidates import Group, Held
from diagnosis.sensors.reduced import Reduced, bank
from diagnosis.sensors.search import SensorSearch
from simulator.effects.base import Value
from simulator.effects.sensor import SENSOR_EFFECTS

Array = NDArray[np.float64]

FOLDS = 6
SPLIT = "days left out, a sixth of the stretches at a time"
MEASURE = "held-out whitened mean square"
LEAST_WEIGHT = 0.005
TINY = 1e-9


@dataclass(frozen=True)
class Sized:
    """One effect of an explanation.

    Attributes
    ----------
    label, effect, axis : which
    size, sigma, unit : how large
    parameters : its other numbers
    held : its amplitudes
    sigmas : (k,) of each amplitude, the other effects of the explanation free
    place : (k,) its columns
    """

    label: str
    effect: str
    axis: str | None
    size: float
    sigma: float
    unit: str
    parameters: dict[str, Value]
    held: Held
    sigmas: Array
    place: NDArray[np.intp]


def sized(reduced: Reduced, chosen: Mapping[str, int]) -> tuple[Sized, ...]:
    """Least-squares amplitudes of some effects together.

    Parameters
    ----------
    reduced : the model
    chosen : option of each effect by label
    """
    if not chosen:
        return ()
    groups = [_group(reduced, label, option) for label, option in chosen.items()]
    gram = sum((part.gram for part in reduced.parts), np.zeros_like(reduced.parts[0].gram))
    places = np.concatenate([np.arange(group.start, group.start + group.count) for group in groups])
    covariance = np.linalg.pinv(gram[np.ix_(places, places)], hermitian=True)
    amplitudes = covariance @ gram[places, -1]
    out, at = [], 0
    for group in groups:
        own = slice(at, at + group.count)
        at += group.count
        effect = SENSOR_EFFECTS[group.effect]
        size, parameters = effect.from_amplitudes(amplitudes[own])
        length = np.linalg.norm(amplitudes[own])
        along = amplitudes[own] / length if length > 0 else np.full(group.count, group.count**-0.5)
        sigma = float(np.sqrt(along @ covariance[own, own] @ along))
        sigmas = np.sqrt(np.diag(covariance[own, own]))
        out.append(
            Sized(
                group.label, group.effect, group.axis, size, sigma, effect.unit, {**group.parameters, **parameters},
                Held(amplitudes[own], group.parameters), sigmas, places[own],
            )
        )  # fmt: skip
    return tuple(out)


def _group(reduced: Reduced, label: str, option: int) -> Group:
    return [group for group in reduced.groups if group.label == label][option]


def absorbed(reduced: Reduced, label: str, by: Sequence[str]) -> Array:
    """(k,) share of each amplitude's trace, in square, that other effects with free amplitudes take.

    Parameters
    ----------
    label : of the effect, its first option
    by : labels of the others
    """
    gram = sum((part.gram for part in reduced.parts), np.zeros_like(reduced.parts[0].gram))
    group = _group(reduced, label, 0)
    own = np.arange(group.start, group.start + group.count)
    others = [_group(reduced, other, 0) for other in by]
    places = np.concatenate([np.arange(one.start, one.start + one.count) for one in others])
    cross = gram[np.ix_(places, own)]
    taken = np.einsum("po,po->o", cross, np.linalg.pinv(gram[np.ix_(places, places)], hermitian=True) @ cross)
    return np.asarray(taken / np.diag(gram)[own])


def closure(before: Reduced, after: Reduced, depth: int, fixed: Sequence[str] | None = None) -> Closure:
    """How far the gap closes on days that chose and fitted nothing.

    A day keeps its own epoch attitude and gyro bias, which are no part of any explanation. Its residuals under M0 have a mean
    square of one per degree of freedom if M0 is true, which is the floor. Each fold finds its explanations of listed effects
    and fits them on the other days; their predictions, weighted, are taken out.

    Parameters
    ----------
    before : the model about M0
    after : the model about the amplitudes found, whose second order the measure does without
    depth : largest number of effects of a fold's explanations
    fixed : labels of one explanation for all folds in place of the search; amplitudes are still of the other days

    Parameters between the options (`diagnosis.sensors.refine`) are those of all days: of thousands of numbers, one or two.
    """
    count = len(after.parts)
    records = []
    for fold in range(min(FOLDS, count)):
        out = list(range(fold, count, FOLDS))
        kept = [k for k in range(count) if k not in out]
        if not kept:
            continue
        weighted = _predictions(after, kept, depth, fixed)
        for k in out:
            part = after.parts[k]
            change = np.zeros(len(part.gram) - 1)
            for weight, places, amplitudes in weighted:
                change[places] += weight * amplitudes
            step = np.append(-change, 1.0)
            records.append((part.name, before.parts[k].gram[-1, -1], float(step @ part.gram @ step), part.dof))
    table = pd.DataFrame.from_records(records, columns=["interval", "before", "after", "dof"])
    table = table.set_index("interval").loc[[part.name for part in after.parts if part.name in set(table["interval"])]]
    dof = float(table["dof"].sum())
    first, left = float(table["before"].sum() / dof), float(table["after"].sum() / dof)
    gap = first - 1.0
    closed = 1.0 - (left - 1.0) / gap if abs(gap) > TINY else 0.0
    spread = 1.645 * float(np.sqrt(2.0 / dof)) / max(abs(gap), TINY)
    by_interval = table.assign(before=table["before"] / table["dof"], after=table["after"] / table["dof"], floor=1.0)
    columns = ["interval", "before", "after", "floor", "dof"]
    return Closure(
        MEASURE, SPLIT, first, left, 1.0, closed, (closed - spread, closed + spread), by_interval.reset_index()[columns]
    )


def _predictions(
    reduced: Reduced, kept: Sequence[int], depth: int, fixed: Sequence[str] | None
) -> list[tuple[float, NDArray[np.intp], Array]]:
    """Weight, columns and amplitudes of the explanations that some days come to."""
    candidates, y = bank(reduced, kept, rivals=False)
    search = SensorSearch(candidates, y)
    found: list[Explanation]
    if fixed is None:
        found = search.explanations(depth)
    else:
        one = search.of(tuple(fixed))
        found = [one] if one is not None else []
    norm = total(found) if found else 0.0
    out = []
    for one in found:
        weight = float(np.exp(one.log_posterior - norm))
        if weight > LEAST_WEIGHT:
            out.append((weight, *_amplitudes(search, one.members)))
    return out


def _amplitudes(search: SensorSearch, members: Sequence[Member]) -> tuple[NDArray[np.intp], Array]:
    """Columns, and amplitudes with the prior that the evidence gives them."""
    places, scales = [], []
    for member in members:
        entry = search.bank.candidates[member.candidate]
        option = entry.options[member.option]
        places.append(np.arange(option.start, option.start + option.count))
        scales.append(np.full(option.count, entry.scales[member.scale]))
    columns, scale = np.concatenate(places), np.concatenate(scales)
    X = search.bank.X[:, columns] * scale
    factor = scipy.linalg.cho_factor(np.eye(scale.size) + X.T @ X)
    return columns, scale * scipy.linalg.cho_solve(factor, X.T @ search.y)
