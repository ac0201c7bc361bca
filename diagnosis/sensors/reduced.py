"""From fitted stretches to one small linear model: products of all columns, by stretch and summed.

The search of `diagnosis.inference.search` needs inner products only. From the summed Gram matrix of [X, y] = Q diag(λ) Qᵀ, the
rows diag(√λ) Qᵀ have the same products as the thousands of rows they stand for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.evidence import Option, scales_of
from diagnosis.model.candidates import Bank, Candidate
from diagnosis.sensors.candidates import Group, Held, listed_columns, listed_groups, rival_columns, rival_groups
from diagnosis.sensors.spans import Fitted
from simulator.effects.sensor import SENSOR_EFFECTS

Array = NDArray[np.float64]

UNLISTED_SHARE = 0.2  # prior of all rivals together
DAY = 86400.0
MONTH = 30 * DAY
WANDERING = {"DSS-2": "dss_misalignment", "Earth sensor": "esa_bias"}  # whose columns a day's shift has


@dataclass(frozen=True)
class Part:
    """One stretch.

    Attributes
    ----------
    name : of the interval
    t_s : its middle
    gram : (p + 1, p + 1) products of columns and residuals, the residuals last
    dof : degrees of freedom
    """

    name: str
    t_s: float
    gram: Array
    dof: int


@dataclass(frozen=True)
class Reduced:
    """All stretches.

    Attributes
    ----------
    parts : the stretches
    groups : whose the columns are
    nameable : effects that may be named
    sources : columns that shifts and drifts of a sensor are made of, by its name; none without rivals
    """

    parts: tuple[Part, ...]
    groups: tuple[Group, ...]
    nameable: tuple[str, ...]
    sources: Mapping[str, NDArray[np.intp]]

    @property
    def dof(self) -> int:
        """Degrees of freedom of all together."""
        return sum(part.dof for part in self.parts)

    @property
    def chi2(self) -> float:
        """Square sum of the residuals of M0 in sigmas."""
        return float(sum(part.gram[-1, -1] for part in self.parts))


def reduce(
    fits: Sequence[Fitted],
    library: Sequence[str] | None = None,
    rivals: bool = True,
    about: Mapping[str, Held] | None = None,
) -> Reduced:
    """Products of all columns.

    Parameters
    ----------
    fits : the stretches
    library : effects that may be named, all by default
    rivals : whether to add what is on no list
    about : amplitudes by label that were taken off the measurements before the fits and are held in the derivatives; the
        residuals get their linear part back
    """
    names = tuple(SENSOR_EFFECTS) if library is None else tuple(name for name in SENSOR_EFFECTS if name in library)
    # Columns of the days' shifts are there even where the effect may not be named.
    present = tuple(name for name in SENSOR_EFFECTS if name in names or (rivals and name in WANDERING.values()))
    held = about or {}
    groups = listed_groups(present, held)
    end = groups[-1].start + groups[-1].count if groups else 0
    amplitudes = _amplitudes(groups, held, end)
    parts = []
    for fitted in fits:
        X = listed_columns(fitted, present, held)
        if rivals:
            X = np.hstack([X, rival_columns(fitted)])
        gram, dof = fitted.gram(X)
        back = np.eye(len(gram))
        back[: amplitudes.size, -1] = amplitudes
        parts.append(Part(fitted.span.name, float(fitted.path.t.mean()), back.T @ gram @ back, dof))
    kept = [group for group in groups if group.effect in names]
    sources = {
        name: np.arange(group.start, group.start + group.count)
        for name, effect in WANDERING.items()
        for group in groups
        if rivals and group.effect == effect
    }
    return Reduced(tuple(parts), (*kept, *(rival_groups(end) if rivals else ())), names, sources)


def _amplitudes(groups: Sequence[Group], held: Mapping[str, Held], count: int) -> Array:
    """(count,) held amplitudes at the columns of their parameters."""
    out = np.zeros(count)
    for label, one in held.items():
        own = next(group for group in groups if group.label == label and group.parameters == dict(one.parameters))
        out[own.start : own.start + own.count] = one.amplitudes
    return out


def bank(reduced: Reduced, keep: Sequence[int] | None = None, rivals: bool = True) -> tuple[Bank, Array]:
    """Candidates and observations for a search.

    Parameters
    ----------
    keep : numbers of the stretches to take, all by default
    rivals : whether what is on no list competes

    Returns
    -------
    the bank, and the observations (N,)
    """
    chosen = list(range(len(reduced.parts))) if keep is None else list(keep)
    groups = [group for group in reduced.groups if group.listed or rivals]
    gram, wandering = _summed(reduced, chosen, rivals)
    groups += wandering
    values, vectors = np.linalg.eigh(gram)
    rows = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    X, y = rows[:, :-1], rows[:, -1]
    return Bank(X, X, _candidates(groups, gram)), np.ascontiguousarray(y)


def _summed(reduced: Reduced, chosen: Sequence[int], rivals: bool) -> tuple[Array, list[Group]]:
    """Gram matrix of all columns, those of the days' shifts before the residuals, and the latters' groups."""
    p = reduced.parts[0].gram.shape[0] - 1
    total = sum((reduced.parts[k].gram for k in chosen), np.zeros((p + 1, p + 1)))
    if not rivals or not reduced.sources:
        return total, []
    own = np.concatenate(list(reduced.sources.values()))
    width = own.size
    size = p + width * (len(chosen) + 1) + 1
    out = np.zeros((size, size))
    places = np.concatenate([np.arange(p), [size - 1]])
    out[np.ix_(places, places)] = total
    middle = float(np.mean([reduced.parts[k].t_s for k in chosen]))
    months = [(reduced.parts[k].t_s - middle) / MONTH for k in chosen]
    # Columns in the order of the sources; within each the days, and one for the drift.
    at = p
    where: list[NDArray[np.intp]] = []
    groups: list[Group] = []
    for name, columns in reduced.sources.items():
        count = columns.size
        where.append(at + np.arange(count * (len(chosen) + 1)).reshape(len(chosen) + 1, count))
        groups.append(Group(f"{name} sits differently each day", None, False, at, count * len(chosen), {}, 1.0))
        groups.append(Group(f"{name} drifts", None, False, at + count * len(chosen), count, {}, 1.0))
        at += count * (len(chosen) + 1)
    for k, (number, month) in enumerate(zip(chosen, months, strict=True)):
        gram = reduced.parts[number].gram
        day = np.concatenate([place[k] for place in where])
        drift = np.concatenate([place[-1] for place in where])
        for new, factor in ((day, 1.0), (drift, month)):
            block = factor * gram[own]
            out[np.ix_(new, places)] += block
            out[np.ix_(places, new)] += block.T
        inner = gram[np.ix_(own, own)]
        out[np.ix_(day, day)] += inner
        out[np.ix_(drift, drift)] += month**2 * inner
        out[np.ix_(day, drift)] += month * inner
        out[np.ix_(drift, day)] += month * inner
    return out, groups


def _candidates(groups: Sequence[Group], gram: Array) -> tuple[Candidate, ...]:
    labels: dict[tuple[str, str | None], list[Group]] = {}
    for group in groups:
        labels.setdefault((group.effect, group.axis), []).append(group)
    listed = {effect for effect, _ in labels if effect in SENSOR_EFFECTS}
    rivals = len(labels) - sum(effect in listed for effect, _ in labels)
    norms = np.sqrt(np.maximum(np.diag(gram), 0.0))
    out = []
    for (effect, axis), members in labels.items():
        largest = max(float(norms[group.start : group.start + group.count].max()) for group in members)
        scales = scales_of(largest, SENSOR_EFFECTS[effect].prior if effect in listed else (0.0, np.inf))
        if not scales.size:
            continue
        share = UNLISTED_SHARE if rivals and listed else 1.0
        if effect in listed:
            axes = sum(name == effect for name, _ in labels)
            prior = ((1 - share) if rivals else 1.0) / len(listed) / axes
        else:
            prior = share / rivals
        options = tuple(Option(g.start, g.count, float(np.log(g.weight)), dict(g.parameters)) for g in members)
        unit = SENSOR_EFFECTS[effect].unit if effect in listed else ""
        out.append(Candidate(effect, axis, effect in listed, float(np.log(prior)), options, scales, unit))
    return tuple(out)
