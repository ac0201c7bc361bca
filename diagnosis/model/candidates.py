"""The linear model of a recording: every effect that could be named, and every unlisted rival, side by side.

Each is a group of columns of its own (`diagnosis.model.groups`); here they get their places, their scales and their priors, and
the recording's nuisance parameters are taken out of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.finer_processes import add_finer_process
from diagnosis.model.folds import RECORDING_SPLIT, build_folds
from diagnosis.model.groups import CandidateColumns, list_alternative_groups, list_effect_groups
from diagnosis.model.linear import (
    UNBOUNDED_SCALES,
    VISIBLE,
    Candidate,
    ColumnStore,
    LinearModel,
    ParameterChoice,
    SelectedCandidate,
    Wanted,
    build_scales,
    choose_scales,
)
from diagnosis.model.periods import add_finer_periods, scan_periods
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.steps import add_finer_times, add_step_times
from diagnosis.model.true_rates import use_true_rates
from diagnosis.settings import DEFAULT, DiagnosisSettings
from simulator.effects.base import Effect

Array = NDArray[np.float64]


def build_linear_model(
    model: RecordingModel,
    effects: Sequence[Effect],
    settings: DiagnosisSettings = DEFAULT,
    rivals: bool = True,
    scan: bool = True,
    tell: Callable[[int], None] = lambda count: None,
) -> LinearModel:
    """The linear model of a recording.

    Parameters
    ----------
    model : the recording, linearised about its calibration under M0
    effects : that may be named
    settings : priors
    rivals : whether unlisted rivals compete
    scan : whether the data are scanned for swings of any period; if not, some periods stand for all of them
    tell : called with the number of candidates that are made, before each
    """
    tell(0)
    found = scan_periods(model) if scan else None

    store = ColumnStore(model.nuisance)

    def store_groups() -> Iterator[CandidateColumns]:
        others = list_alternative_groups(model, found or {}, effects) if rivals else ()
        for count, group in enumerate(chain(list_effect_groups(model, effects, found), others)):
            tell(count)
            yield replace(group, columns=[store.add(part) for part in group.columns])

    candidates = list_candidates(list(store_groups()), lambda projected: projected, settings)
    return assemble_linear_model(model, candidates, store, {effect.name: effect for effect in effects}, settings)


def place_candidates(
    groups: Sequence[CandidateColumns],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    size: int = 0,
    visible: tuple[float, float] = VISIBLE,
) -> tuple[tuple[Candidate, ...], Array]:
    """Place the columns (N, p) of all groups side by side, and list their candidates; see `list_candidates`."""
    candidates, columns = list_candidates(groups, projected, settings, visible), [np.empty((size, 0))]
    parts = [part for group in groups for part in group.columns]
    return candidates, np.hstack(parts or columns)


def list_candidates(
    groups: Sequence[CandidateColumns],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    visible: tuple[float, float] = VISIBLE,
) -> tuple[Candidate, ...]:
    """List the candidates of groups whose columns lie side by side, with their scales and priors.

    Each effect has the same prior, shared by its axes, and so has each rival; what could not be seen is left out.

    Parameters
    ----------
    groups : the candidates
    projected : takes the nuisance parameters out of columns
    settings : priors
    visible : signal-to-noise ratios of interest
    """
    names = {group.effect for group in groups if group.listed}
    rivals = {group.effect for group in groups if not group.listed}
    share = settings.unlisted_share if rivals and names else float(bool(rivals))
    axes = {name: sum(group.effect == name for group in groups) for name in names | rivals}
    candidates, stop = [], 0
    for group in groups:
        stops = stop + np.cumsum([part.shape[1] for part in group.columns], dtype=int)
        stop = int(stops[-1]) if stops.size else stop
        norms = [np.linalg.norm(projected(part), axis=0) for part in group.columns]
        largest = max((float(norm.max()) for norm in norms if norm.size), default=0.0)
        scales = choose_scales(largest, group.limits, visible) if group.scales is None else group.scales
        # What a size of a random process shows differs between its options, each of which has scales of its own.
        windows = (
            [_find_scale_range(norm, group.limits, visible) for norm in norms] if group.process and group.scales is None else []
        )
        if windows and scales.size:
            scales = build_scales(
                min(low for low, high in windows if low < high), max(high for low, high in windows if low < high)
            )
        if not scales.size:
            continue
        family = (1 - share) / len(names) if group.listed else share / len(rivals)
        options = []
        windows = windows or [UNBOUNDED_SCALES] * len(norms)
        for end, norm, weight, parameters, window in zip(
            stops.tolist(), norms, group.weights, group.parameters, windows, strict=True
        ):
            if not window[0] < window[1] or (group.scales is None and not norm.size):  # nothing of it can be seen here
                continue
            options.append(ParameterChoice(end - norm.size, norm.size, float(np.log(weight)), parameters, window))
        prior = float(np.log(group.weight * family / axes[group.effect]))
        candidates.append(
            Candidate(
                group.effect, group.axis, group.listed, prior, tuple(options), scales, group.unit, group.process,
                group.positive, group.log_odds, group.read, group.size_sigma, group.shifted, group.scanned,
            )
        )  # fmt: skip
    return tuple(candidates)


def _find_scale_range(norms: Array, limits: tuple[float, float], visible: tuple[float, float]) -> tuple[float, float]:
    """Range of the scales that an option can show; no range where nothing of it can be seen."""
    largest = float(norms.max(initial=0.0))
    return (max(limits[0], visible[0] / largest), min(limits[1], visible[1] / largest)) if largest > 0 else (np.inf, 0.0)


def assemble_linear_model(
    model: RecordingModel,
    candidates: tuple[Candidate, ...],
    store: ColumnStore,
    effects: Mapping[str, Effect],
    settings: DiagnosisSettings,
) -> LinearModel:
    """The linear model of a recording, by the columns of all candidates side by side."""
    W = store.restore()

    def refine(linear: LinearModel, member: SelectedCandidate) -> LinearModel:
        effect = effects.get(linear.candidate(member).effect)
        if effect is None:
            return linear
        if effect.scanned:
            return add_finer_periods(model, linear, member, effect)
        if linear.candidate(member).process:
            return add_finer_process(model, linear, member, effect)
        finer = add_finer_times if effect.switched else use_true_rates
        return finer(model, linear, member, effect)

    def moments(linear: LinearModel, wanted: Sequence[Wanted]) -> LinearModel:
        return add_step_times(model, linear, effects, wanted)

    return LinearModel(
        y=model.y,
        X=W.X,
        W=W,
        candidates=candidates,
        dof=model.degrees_of_freedom,
        projected=model.project_out_nuisance,
        most_effects=settings.largest_set,
        split=RECORDING_SPLIT,
        folds=lambda W: build_folds(model, W),
        room=store.room,
        refine=refine,
        moments=moments,
    )
