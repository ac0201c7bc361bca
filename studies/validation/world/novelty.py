"""What of an unlisted effect no listed one explains."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np

from simulator.effects import EFFECTS, Effect, Setting, Surroundings
from simulator.effects.base import Array
from simulator.effects.common import list_spans
from studies.validation.world.evidence import Change
from studies.validation.world.world import World

MOST_TRIALS, STEP_TIMES = 12, 12


def compute_novelty(world: World, one: Setting, listed: Iterable[Effect] | None = None) -> float:
    """Norm of what no listed effect with columns explains of an unlisted effect, as it is in the recording.

    Listed are all of the registry, or those that are given.
    """
    change = world.difference([one])
    response = world.evidence.attitude(change)
    total = float(np.sum(world.evidence.combine_evidence(change) ** 2))
    explained = 0.0
    for effect in EFFECTS.values() if listed is None else listed:
        if effect.has_columns and effect.missing(world.surroundings) is None:
            for columns in _list_whitened_columns(world, effect):
                u, s, _ = np.linalg.svd(columns, full_matrices=False)
                share = u[:, s > 1e-9 * max(float(s[0]), 1e-300)].T @ response
                explained = max(explained, float(share @ share))
    return float(np.sqrt(max(total - explained, 0.0)))


def _list_whitened_columns(world: World, effect: Effect) -> Iterator[Array]:
    """Whitened columns of a listed effect for its axes, for parameters that it would have tried, at times where it may
    begin."""
    around, zero = (
        world.surroundings,
        Change(np.zeros_like(world.surroundings.stream.raw), np.zeros((len(world.surroundings.references.t_s), 3))),
    )
    trials = list(effect.trials(around))
    trials = trials[:: max(1, len(trials) // MOST_TRIALS)]
    times = _list_step_times(around) if effect.switched else [np.nan]
    for axis, trial, time in product(effect.axes or (None,), trials, times):
        given = {one.name: one.default for one in effect.parameters if one.default is not None} | dict(trial.parameters)
        given |= {"time_s": float(time)} if effect.switched else {}
        if effect.on_references:
            columns = effect.reference_columns(around.references, axis, given)
            changes = [replace(zero, reference=one) for one in np.moveaxis(columns, 2, 0)]
        else:
            columns = effect.columns(around.stream, axis, given)
            changes = [replace(zero, raw=one) for one in np.moveaxis(columns, 2, 0)]
        if np.isfinite(columns).all() and columns.any():
            yield np.stack([world.evidence.attitude(one) for one in changes], axis=1)


def _list_step_times(around: Surroundings) -> Array:
    """Times in and between the intervals, s."""
    begin, end = list_spans(around.stream)
    inside = (begin[:, None] + (end - begin)[:, None] * np.array([0.2, 0.5, 0.8])).ravel()
    times = np.sort(np.concatenate([inside, 0.5 * (begin[1:] + end[:-1])]))
    return np.asarray(times[:: max(1, len(times) // STEP_TIMES)])
