"""The linear model of a recording: every effect that could be named, and every unlisted rival, side by side.

Each is a group of columns of its own (`diagnosis.model.groups`); here they get their places, their scales and their priors, and
the recording's nuisance parameters are taken out of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.finer_processes import with_finer_process, with_whole_process
from diagnosis.model.folds import SPLIT, folds
from diagnosis.model.groups import Group, listed, unlisted_groups
from diagnosis.model.linear import EVERY, Candidate, LinearModel, Member, Option, Restored, Room, Wanted, scales_of, spaced
from diagnosis.model.linear import SETTINGS as LINEAR
from diagnosis.model.periods import add_finer_periods, scan_periods
from diagnosis.model.recording import RecordingModel
from diagnosis.model.steps import with_finer_times, with_moments
from diagnosis.model.true_rates import with_true_rates
from diagnosis.settings import DEFAULT, DiagnosisSettings
from simulator.effects.base import Effect

Array = NDArray[np.float64]

AT_ONCE = 512  # columns that are projected together
BLOCK = 6_000_000  # numbers; what is as large is memory of its own to the system


def linear_model(
    model: RecordingModel,
    effects: Sequence[Effect],
    further: Iterable[Group] = (),
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
    further : candidates that tests of the samples bring
    settings : priors
    rivals : whether unlisted rivals compete
    scan : whether the data are scanned for swings of any period; if not, some periods stand for all of them
    tell : called with the number of candidates that are made, before each
    """
    tell(0)
    found = scan_periods(model) if scan else None

    def made() -> Iterator[Group]:
        others = unlisted_groups(model, found or {}, effects) if rivals else ()
        for count, group in enumerate(packed(chain(listed(model, effects, found), further, others), model.size)):
            tell(count)
            yield group

    candidates, columns = ordered(list(made()), model.projected, settings)
    return of_columns(model, candidates, columns, {effect.name: effect for effect in effects}, settings)


def packed(groups: Iterable[Group], size: int) -> Iterator[Group]:
    """Groups with their columns (N, k) side by side in large blocks of memory, each of which is given back as a whole.

    Small arrays that are made among others that stay leave holes, which no other program can use.
    """
    block = Room(np.empty((size, 0), order="F"))
    for group in groups:
        columns = []
        for part in group.columns:
            stop = block.used + part.shape[1]
            if stop > block.memory.shape[1]:
                block, stop = Room(np.empty((size, max(BLOCK // max(size, 1), part.shape[1])), order="F")), part.shape[1]
            block.memory[:, block.used : stop] = part
            columns.append(block.memory[:, block.used : stop])
            block.used = stop
        yield replace(group, columns=columns)


def placed(
    groups: Sequence[Group],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    size: int = 0,
    visible: tuple[float, float] = LINEAR.visible,
) -> tuple[tuple[Candidate, ...], Array]:
    """Candidates with their places and priors, and all columns side by side; see `ordered`."""
    candidates, columns = ordered(groups, projected, settings, visible)
    return candidates, np.hstack(columns) if columns else np.empty((size, 0))


def ordered(
    groups: Sequence[Group],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    visible: tuple[float, float] = LINEAR.visible,
) -> tuple[tuple[Candidate, ...], list[Array]]:
    """Candidates with their places and priors, and the columns of all their options in that order.

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
    candidates, columns, start = [], [], 0
    for group in groups:
        norms = [np.linalg.norm(projected(part), axis=0) for part in group.columns]
        largest = max((float(norm.max()) for norm in norms if norm.size), default=0.0)
        shown = visible[0], max(visible[1], group.loudest)
        scales = scales_of(largest, group.limits, shown) if group.scales is None else group.scales
        # What a size of a random process shows differs between its options, each of which has scales of its own.
        windows = [_window(norm, group.limits, shown) for norm in norms] if group.process and group.scales is None else []
        if windows and scales.size:
            scales = spaced(min(low for low, high in windows if low < high), max(high for low, high in windows if low < high))
        if not scales.size:
            continue
        family = (1 - share) / len(names) if group.listed else share / len(rivals)
        options = []
        windows = windows or [EVERY] * len(norms)
        for part, weight, parameters, window in zip(group.columns, group.weights, group.parameters, windows, strict=True):
            if not window[0] < window[1] or (group.scales is None and not part.shape[1]):  # nothing of it can be seen here
                continue
            options.append(Option(start, part.shape[1], float(np.log(weight)), parameters, window))
            columns.append(part)
            start += part.shape[1]
        prior = float(np.log(group.weight * family / axes[group.effect]))
        candidates.append(
            Candidate(
                group.effect, group.axis, group.listed, prior, tuple(options), scales, group.unit, group.process,
                group.positive, group.log_odds, group.read, group.size_sigma, group.shifted, group.scanned, group.roughness,
            )
        )  # fmt: skip
    return tuple(candidates), columns


def _window(norms: Array, limits: tuple[float, float], visible: tuple[float, float]) -> tuple[float, float]:
    """Range of the scales that an option can show; no range where nothing of it can be seen."""
    largest = float(norms.max(initial=0.0))
    return (max(limits[0], visible[0] / largest), min(limits[1], visible[1] / largest)) if largest > 0 else (np.inf, 0.0)


def _projected(model: RecordingModel, columns: list[Array]) -> tuple[Room, Restored]:
    """Columns (N, k) side by side and projected, with room for more; those that are done are taken off the list."""
    count = sum(part.shape[1] for part in columns)
    # Column by column, so that what is not used yet takes no memory, and columns side by side are products without a copy.
    room = Room(np.empty((model.size, 2 * count + AT_ONCE), order="F"))
    basis, hidden = model.nuisance, np.empty((model.nuisance.shape[1], count))
    columns.reverse()
    while columns:
        some, wide = [columns.pop()], AT_ONCE
        while columns and (wide := wide - some[-1].shape[1]) > 0:
            some.append(columns.pop())
        part, start = np.hstack(some), room.used
        room.used += part.shape[1]
        np.matmul(basis.T, part, out=hidden[:, start : room.used])
        np.subtract(part, basis @ hidden[:, start : room.used], out=room.memory[:, start : room.used])
    return room, Restored(room.memory[:, :count], basis, hidden)


def of_columns(
    model: RecordingModel,
    candidates: tuple[Candidate, ...],
    columns: list[Array],
    effects: Mapping[str, Effect],
    settings: DiagnosisSettings,
) -> LinearModel:
    """The linear model of a recording, by the whitened columns of all candidates in their order."""
    room, W = _projected(model, columns)

    def refine(linear: LinearModel, member: Member) -> LinearModel:
        effect = effects.get(linear.candidate(member).effect)
        if effect is None or effect.of_trackers:
            return linear
        if effect.scanned:
            return add_finer_periods(model, linear, member, effect)
        if linear.candidate(member).process:
            return with_finer_process(model, linear, member, effect)
        finer = with_finer_times if effect.switched else with_true_rates
        return finer(model, linear, member, effect)

    def whole(linear: LinearModel, member: Member) -> LinearModel:
        effect = effects.get(linear.candidate(member).effect)
        if effect is None or effect.of_trackers or not linear.candidate(member).process:
            return linear
        return with_whole_process(model, linear, member, effect)

    def moments(linear: LinearModel, wanted: Sequence[Wanted]) -> LinearModel:
        return with_moments(model, linear, effects, wanted)

    return LinearModel(
        y=model.y,
        X=W.X,
        W=W,
        candidates=candidates,
        dof=model.degrees_of_freedom,
        projected=model.projected,
        most_effects=settings.largest_set,
        split=SPLIT,
        folds=lambda W: folds(model, W),
        room=room,
        refine=refine,
        whole=whole,
        moments=moments,
    )
