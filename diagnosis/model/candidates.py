"""The linear model of a recording: every effect that could be named, and every unlisted rival, side by side.

Each is a group of columns (`diagnosis.model.groups`). Listed effects have columns or a covariance; unlisted rivals are those of
`diagnosis.model.unlisted`, `diagnosis.model.periods`, `diagnosis.model.processes` and `diagnosis.model.trackers`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model import periods, processes, trackers, unlisted
from diagnosis.model.folds import SPLIT, folds
from diagnosis.model.groups import AXES, Group, build_rival, group_of, list_candidates
from diagnosis.model.gyro_array import ArrayModel
from diagnosis.model.linear import SETTINGS as LINEAR
from diagnosis.model.linear import Candidate, ColumnStore, LinearModel, Member, spaced
from diagnosis.model.nonlinear import build_delay_column, with_true_rates
from diagnosis.model.recording import RecordingModel
from diagnosis.model.steps import StepTimes, step_times, switched_columns, with_finer_times
from diagnosis.settings import DEFAULT, DiagnosisSettings
from simulator.effects.base import Effect, Surroundings, Trial

Array = NDArray[np.float64]


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
    found = periods.scan_periods(model) if scan else None

    store = ColumnStore(model.nuisance)

    def made() -> Iterator[Group]:
        others = unlisted_groups(model, found or {}, effects) if rivals else ()
        for count, group in enumerate(chain(listed(model, effects, found), further, others)):
            tell(count)
            yield replace(group, columns=[store.add(part) for part in group.columns])

    candidates = list_candidates(list(made()), lambda projected: projected, settings)
    return of_columns(model, candidates, store, {effect.name: effect for effect in effects}, settings)


def of_columns(
    model: RecordingModel,
    candidates: tuple[Candidate, ...],
    store: ColumnStore,
    effects: Mapping[str, Effect],
    settings: DiagnosisSettings,
) -> LinearModel:
    """The linear model of a recording, by the columns of all candidates side by side."""
    W = store.restore()

    def refine(linear: LinearModel, member: Member) -> LinearModel:
        effect = effects.get(linear.candidate(member).effect)
        if effect is None or effect.of_trackers:
            return linear
        if effect.scanned:
            return periods.add_finer_periods(model, linear, member, effect)
        if linear.candidate(member).process:
            return processes.with_finer_process(model, linear, member, effect)
        finer = with_finer_times if effect.switched else with_true_rates
        return finer(model, linear, member, effect)

    def whole(linear: LinearModel, member: Member) -> LinearModel:
        effect = effects.get(linear.candidate(member).effect)
        if effect is None or effect.of_trackers or not linear.candidate(member).process:
            return linear
        return processes.with_whole_process(model, linear, member, effect)

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
        room=store.room,
        refine=refine,
        whole=whole,
    )


# ---- listed effects ------------------------------------------------------------------------------------------------------


def listed(
    model: RecordingModel, effects: Sequence[Effect], found: periods.Found | None, steps: StepTimes | None = None
) -> Iterator[Group]:
    """The effects that have columns or a covariance and can be seen in this recording.

    Parameters
    ----------
    model, effects : the recording and what may be named
    found : by a scan for periods
    steps : times that steps are tried at; those of `step_times` by default
    """
    around = model.around
    for effect in effects:
        if effect.missing(around) is not None:
            continue
        if effect.of_trackers:
            yield from trackers.list_tracker_groups(model, effect)
        elif effect.has_columns:
            for axis in effect.axes or (None,):
                if effect.scanned and found is not None:
                    if found:
                        yield scanned_group(model, effect, str(axis), found)
                elif effect.switched:
                    yield switched_group(model, effect, axis, around, steps)
                else:
                    yield plain_group(model, effect, axis, around)
        elif effect.is_process:
            yield from process_groups(model, effect, around)


def plain_group(model: RecordingModel | ArrayModel, effect: Effect, axis: str | None, around: Surroundings) -> Group:
    """An effect whose columns are there throughout, with an option for each set of parameters worth trying."""
    trials = list(effect.trials(around))
    columns = [periods.make_columns(model, effect, axis, trial.parameters) for trial in trials]
    if isinstance(model, RecordingModel) and effect.stage == "clock" and effect.unit == "s":  # one delay, of any length
        long = build_delay_column(model, columns[0], effect.prior)
        columns, trials = (columns, trials) if long is None else ([columns[0], long], [Trial({}, 0.5), Trial({}, 0.5)])
    return group_of(effect, axis, columns, trials)


def switched_group(
    model: RecordingModel | ArrayModel, effect: Effect, axis: str | None, around: Surroundings, steps: StepTimes | None = None
) -> Group:
    """An effect that is switched on at some time, with an option for each time that is tried."""
    times, widths, weights, firsts = steps or step_times(model)
    columns: list[Array] = []
    trials: list[Trial] = []
    for trial in effect.trials(around):
        columns += np.split(switched_columns(model, effect, axis, trial.parameters, firsts), times.size, axis=1)
        for time, width, weight in zip(times.tolist(), widths.tolist(), weights.tolist(), strict=True):
            trials.append(Trial({**trial.parameters, "time_s": time, "time_sigma_s": width}, trial.weight * weight))
    return group_of(effect, axis, columns, trials)


def process_groups(model: RecordingModel, effect: Effect, around: Surroundings) -> Iterator[Group]:
    """A random process about each axis."""
    trials = effect.trials(around)
    covariance, places = processes.process_places(model, effect)
    columns: dict[str, list[Array]] = {axis: [] for axis in effect.axes}
    for trial in trials:
        K = covariance(trial.parameters)  # one at a time: there may be two thousand times
        for place, made in zip(places, columns.values(), strict=True):
            made.append(processes.usual(place, K))
    for axis, made in columns.items():
        yield group_of(effect, axis, made, trials, process=True)


def scanned_group(model: RecordingModel, effect: Effect, axis: str, found: periods.Found) -> Group:
    """An effect that swings with any period, with an option for each period that a scan of the data has kept."""
    options = found[effect.on_references, AXES.index(axis)]
    columns = periods.make_effect_columns(model, effect, axis, np.array([one.frequency for one in options]))
    group = group_of(effect, axis, columns, [Trial(one.parameters, float(np.exp(one.log_weight))) for one in options])
    # What a size shows grows with the period: the scales are those of all options, not only of the strongest.
    norms = np.array([max(np.linalg.norm(model.projected(part), axis=0).max(), 1e-300) for part in columns])
    low, high = max(effect.prior[0], LINEAR.visible[0] / norms.max()), min(effect.prior[1], LINEAR.visible[1] / norms.min())
    return replace(group, scanned=True, scales=spaced(low, high))


# ---- unlisted rivals -----------------------------------------------------------------------------------------------------


def unlisted_groups(model: RecordingModel, found: periods.Found, effects: Sequence[Effect]) -> Iterator[Group]:
    """Every discrepancy that is on no list, with an amplitude of any size."""
    yield from periods.list_repeating(model, found, [effect.on_references for effect in effects if effect.scanned])
    yield from unlisted.build_families(model)
    cells, around = processes.cell_times(model), model.around
    known = [
        effect.covariance(cells, trial.parameters)
        for effect in effects
        if effect.is_process and not effect.on_references and not effect.of_trackers and effect.missing(around) is None
        for trial in effect.trials(around)
    ]
    between = steps_between(model, effects)
    for process in processes.unlisted(model, known):
        others = [one for one in process.columns if not _is_within(model.projected(one), between[str(process.axis)])]
        if others:
            yield build_rival(process.effect, process.axis, others, True)
    yield from trackers.list_tracker_rivals(model)


def steps_between(model: RecordingModel, effects: Sequence[Effect]) -> dict[str, list[Array]]:
    """Orthonormal bases (N, k) of what steps of listed effects about each axis look like between two intervals.

    Where there are just two, what has a value of its own in each is a step between them, and no rival of it.
    """
    found: dict[str, list[Array]] = {axis: [] for axis in AXES}
    if len(model.blocks) != 2:
        return found
    second = np.array([model.blocks[1].steps.start])
    for effect in effects:
        if effect.switched and effect.has_columns and not effect.on_references and effect.missing(model.around) is None:
            for axis in AXES:
                steps = [switched_columns(model, effect, axis, one.parameters, second) for one in effect.trials(model.around)]
                found[axis].append(scipy.linalg.orth(model.projected(np.hstack(steps))))
    return found


def _is_within(columns: Array, bases: Sequence[Array]) -> bool:
    """Whether some projected columns (N, r) lie in the span of one of the bases, but for a small part of their power."""
    power = float(np.sum(columns**2))
    return any(float(np.sum((basis.T @ columns) ** 2)) > processes.SETTINGS.alike * power for basis in bases)
