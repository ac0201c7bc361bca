"""Checks of what is named against a few jumps (`diagnosis.inference.few_jumps`), with the columns of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.checks import Check
from diagnosis.inference.evidence import log_bayes
from diagnosis.inference.few_jumps import log_evidence
from diagnosis.inference.search import Search
from diagnosis.model.in_progress import steps_at
from diagnosis.model.linear import LinearModel, Member
from diagnosis.model.recording import RecordingModel
from diagnosis.model.steps import Left
from diagnosis.settings import DEFAULT, DiagnosisSettings
from simulator.effects.base import Effect

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

AXES = "xyz"
TURNS = 0.2  # of the largest departure from the usual rate of an interval, from which on the body turns
ALWAYS = 0.5  # of the cells, from which on a body that turns has no turns to tell apart
TINY = 1e-300


def step_columns(model: RecordingModel, axis: int, on_references: bool) -> Array:
    """(N, c) projected columns of a unit error that sets in with each cell, or each observation, and stays.

    An error of all references that is there from the first on is a rotation, which nothing shows.
    """
    columns = model.reference_columns[axis] if on_references else model.cell_columns[axis]
    return model.projected(np.cumsum(columns[:, ::-1], axis=1)[:, ::-1])


def place_weights(model: RecordingModel, on_references: bool) -> Array:
    """(c,) prior of a step at each place: half of it even, the rest as the body turns there and as its rate changes."""
    if on_references:
        interval = model.observation_block
        rates = model.rates[steps_at(model, model.observation_t_s, interval)]
    else:
        rates, interval = _cell_rates(model), model.cells.interval
    change = np.zeros(len(rates))
    change[1:] = np.linalg.norm(np.diff(rates, axis=0), axis=1) * (np.diff(interval) == 0)
    size, even = np.linalg.norm(rates, axis=1), np.full(change.size, 1 / change.size)
    parts = [one / one.sum() if one.any() else even for one in (change, size)]
    return np.asarray(0.5 * even + 0.25 * parts[0] + 0.25 * parts[1])


def turn_places(model: RecordingModel, on_references: bool) -> list[Indices]:
    """Places of a step at every turn of the body, without and with one between every two intervals; none if it always turns."""
    rates, interval = _cell_rates(model), model.cells.interval
    usual = np.array([np.median(rates[interval == number], axis=0) for number in range(len(model.blocks))])
    away = np.linalg.norm(rates - usual[interval], axis=1)
    turns = away > TURNS * away.max()
    if not turns.any() or turns.mean() > ALWAYS:
        return []
    begins = turns & np.append(True, ~turns[:-1] | (np.diff(interval) != 0))
    number = np.cumsum(begins)[turns]
    middle = np.rint(np.bincount(number, np.flatnonzero(turns))[1:] / np.bincount(number)[1:]).astype(np.intp)
    between = np.flatnonzero(np.diff(interval)) + 1
    sets = [middle, np.union1d(middle, between)] if between.size else [middle]
    if not on_references:
        return sets
    places = [np.unique(np.searchsorted(model.observation_t_s, model.t_s[model.cells.first[one]])) for one in sets]
    return [one[one < model.observation_t_s.size] for one in places]


def _cell_rates(model: RecordingModel) -> Array:
    """(c, 3) mean rate of the body in each cell."""
    turned = np.add.reduceat(model.rates * model.dt[:, None], model.cells.first, axis=0)
    return np.asarray(turned / model.cells.duration_s[:, None])


@dataclass(frozen=True)
class Jumps:
    """Whether a few jumps explain what a member of an explanation is there for, with all others about its axis.

    Attributes
    ----------
    label : of the member
    log_bayes : log of the Bayes factor of the jumps, at least
    log_prior : what the prior adds where they stand for several causes at once, less the part that is of the others
    """

    label: str
    log_bayes: float
    log_prior: float

    @property
    def check(self) -> Check:
        """It as a check, whose p-value is a bound."""
        return Check(jumps_of(self.label), self.log_bayes, 0.0, float(np.exp(-np.clip(self.log_bayes, 0.0, -np.log(TINY)))))


def jumps_instead(
    model: RecordingModel,
    linear: LinearModel,
    members: Sequence[Member],
    effects: Mapping[str, Effect],
    settings: DiagnosisSettings = DEFAULT,
) -> tuple[Jumps, ...]:
    """Whether a few jumps of the rate, or of the references, explain all members about one axis.

    The evidence of the members is averaged over their options and scales, as that of the jumps is. Where several members are
    about one axis, the jumps are one cause and they are several: all but the likeliest have their prior to pay, and each then
    has an equal part of the jumps. What the samples say against a member speaks for the jumps.
    """
    at = [_place(linear, one, effects) for one in members]
    search, found = Search(linear, settings), []
    for place in dict.fromkeys(one for one in at if one is not None):
        axis, on_references = place
        own = [one for one, its in zip(members, at, strict=True) if its == place]
        others = tuple(one for one in members if one not in own)
        left, D = Left(linear, others), step_columns(model, AXES.index(axis), on_references)
        weights, turns = place_weights(model, on_references), turn_places(model, on_references)
        jumps = log_evidence(D.T @ left.y, D.T @ left.of(D), weights, turns)
        named = _log_density(linear, tuple(members)) - _log_density(linear, others) + _occam(search, tuple(members), own)
        alone = [linear.candidate(one).log_prior for one in own]
        priors = sum(alone) + sum(min(linear.candidate(one).log_odds, 0.0) for one in own)
        more = max(alone) - priors - (len(own) - 1) * float(np.log(settings.another)) - float(np.log(len(own)))
        found += [Jumps(linear.candidate(one).label, jumps - named, more) for one in own]
    return tuple(found)


def _occam(search: Search, members: tuple[Member, ...], own: Sequence[Member]) -> float:
    """log of what the evidence of some members loses as it is averaged over their options and scales.

    `_log_density` does not know that some amplitudes can only be positive, whose prior is twice as dense.
    """
    scores = [search.score(one.candidate, tuple(other for other in members if other != one)) for one in own]
    doubled = float(np.log(2.0)) * sum(search.model.candidate(one).positive for one in own)
    return sum(one.average - one.best for one in scores) + doubled


def jumps_of(label: str) -> str:
    """Name of the check of what a label does, alone or with others about its axis."""
    return f"a few jumps in place of {label}"


def _place(linear: LinearModel, member: Member, effects: Mapping[str, Effect]) -> tuple[str, bool] | None:
    """Axis of a member, and whether it acts on the references; None of what is about no single axis, or of trackers."""
    entry, effect = linear.candidate(member), effects.get(linear.candidate(member).effect)
    return None if effect is None or entry.axis is None or effect.of_trackers else (entry.axis, effect.on_references)


def _log_density(linear: LinearModel, members: tuple[Member, ...]) -> float:
    """log of the density of the observations under members at their scales, but for a constant."""
    places, scales, shifts = linear.design(members)
    y, C = linear.y - linear.X[:, shifts].sum(axis=1), linear.X[:, places] * scales
    gain = log_bayes((C.T @ C)[None], (C.T @ y)[None], np.ones(1))[0, 0] if places.size else 0.0
    return float(gain - 0.5 * y @ y)
