"""The linear model of a recording: every effect that could be named, and every unlisted rival, as groups of columns.

An effect says itself which columns or which covariance it has, which options are worth trying and how plausible it is
(`simulator.effects.base.Effect`); here its columns become observations of the recording. Unlisted rivals are those of
`diagnosis.model.unlisted` and `diagnosis.model.processes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import periods, processes, repeating, trackers, unlisted
from diagnosis.model.folds import SPLIT, folds
from diagnosis.model.late_tags import delays
from diagnosis.model.linear import (
    EVERY,
    VISIBLE,
    Candidate,
    LinearModel,
    Member,
    Option,
    Parameters,
    Restored,
    Room,
    Wanted,
    exactly,
    finer,
    first_amplitude,
    scales_of,
    spaced,
)
from diagnosis.model.periods import Found
from diagnosis.model.recording import RecordingModel
from diagnosis.model.steps import step_times, switched_columns, with_finer_times, with_moments
from diagnosis.model.swings import columns_of, period_parameters, swing_columns, with_finer_periods
from diagnosis.settings import DEFAULT, DiagnosisSettings
from simulator.effects.base import Effect, Surroundings, Value

Array = NDArray[np.float64]

AXES = "xyz"
AT_ONCE = 512  # columns that are projected together
BLOCK = 6_000_000  # numbers; what is as large is memory of its own to the system
SPARE = 8  # share of all columns that there is room for beside them


@dataclass(frozen=True)
class Group:
    """A candidate before its place in the model is known.

    Attributes
    ----------
    effect, axis, listed, unit, process, positive, log_odds, read, size_sigma, shifted, scanned : as in `Candidate`
    columns : per option (N, k) whitened columns
    parameters : per option
    weights : (o,) prior share of each option
    limits : plausible range of the size
    weight : prior of its effect beside that of the others
    scales : as in `Candidate`; by default those within the limits that the columns can show
    loudest : largest signal-to-noise ratio of interest, where the scales are those by default
    """

    effect: str
    axis: str | None
    listed: bool
    columns: Sequence[Array]
    parameters: Sequence[Parameters]
    weights: Array
    limits: tuple[float, float]
    unit: str
    process: bool = False
    positive: bool = False
    weight: float = 1.0
    log_odds: float = 0.0
    read: Callable[[Array], tuple[float, Parameters]] = first_amplitude
    size_sigma: Callable[[float], float] = exactly
    shifted: bool = False
    scales: Array | None = None
    scanned: bool = False
    loudest: float = VISIBLE[1]


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
    found = periods.swings(model) if scan else None

    def made() -> Iterator[Group]:
        others = unlisted_groups(model, found or {}, effects) if rivals else ()
        for count, group in enumerate(packed(chain(listed(model, effects, found), further, others), model.size)):
            tell(count)
            yield group

    return assembled(
        model,
        list(made()),
        {effect.name: effect for effect in effects},
        settings,
    )


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
    visible: tuple[float, float] = VISIBLE,
) -> tuple[tuple[Candidate, ...], Array]:
    """Candidates with their places and priors, and all columns side by side; see `ordered`."""
    candidates, columns = ordered(groups, projected, settings, visible)
    return candidates, np.hstack(columns) if columns else np.empty((size, 0))


def ordered(
    groups: Sequence[Group],
    projected: Callable[[Array], Array],
    settings: DiagnosisSettings,
    visible: tuple[float, float] = VISIBLE,
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
                group.positive, group.log_odds, group.read, group.size_sigma, group.shifted, group.scanned,
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
    room = Room(np.empty((model.size, count + max(count // SPARE, AT_ONCE)), order="F"))
    basis, hidden = model.nuisance, np.empty((model.nuisance.shape[1], count))
    columns.reverse()
    while columns:
        some: list[Array] = []
        while columns and sum(part.shape[1] for part in some) < AT_ONCE:
            some.append(columns.pop())
        part, start = np.hstack(some), room.used
        room.used += part.shape[1]
        np.matmul(basis.T, part, out=hidden[:, start : room.used])
        np.subtract(part, basis @ hidden[:, start : room.used], out=room.memory[:, start : room.used])
    return room, Restored(room.memory[:, :count], basis, hidden)


def assembled(
    model: RecordingModel, groups: Sequence[Group], effects: Mapping[str, Effect], settings: DiagnosisSettings
) -> LinearModel:
    """Groups side by side, as the linear model of a recording."""
    candidates, columns = ordered(groups, model.projected, settings)
    del groups  # whose columns are hundreds of megabytes
    room, W = _projected(model, columns)

    def refine(linear: LinearModel, member: Member) -> LinearModel:
        effect = effects.get(linear.candidate(member).effect)
        if effect is None or effect.of_trackers:
            return linear
        if effect.scanned:
            return with_finer_periods(model, linear, member, effect)
        finer = with_finer_process if linear.candidate(member).process else with_finer_times
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


# ---- listed effects ------------------------------------------------------------------------------------------------------


def listed(model: RecordingModel, effects: Sequence[Effect], found: Found | None) -> Iterator[Group]:
    """The effects that have columns or a covariance and can be seen in this recording; `found` by a scan for periods."""
    around = model.around
    for effect in effects:
        if effect.missing(around) is not None:
            continue
        if effect.of_trackers:
            yield from (
                replace(group_of(effect, one.tracker, one.columns, one.parameters, one.weights.tolist()), process=one.process)
                for one in trackers.listed(model, effect)
            )
            continue
        if effect.has_columns:
            for axis in effect.axes or (None,):
                if effect.scanned and found is not None:
                    if found:
                        yield scanned_group(model, effect, str(axis), found)
                elif effect.switched:
                    yield switched_group(model, effect, axis, around)
                else:
                    yield plain_group(model, effect, axis, around)
        elif effect.is_process:
            yield from process_groups(model, effect, around)


def plain_group(model: RecordingModel, effect: Effect, axis: str | None, around: Surroundings) -> Group:
    """An effect whose columns are there throughout, with an option for each set of parameters worth trying."""
    trials = effect.trials(around)
    columns = [columns_of(model, effect, axis, trial.parameters) for trial in trials]
    parameters, weights = [dict(trial.parameters) for trial in trials], [trial.weight for trial in trials]
    if effect.stage == "clock":
        long = delays(model, columns[0], effect.prior)
        columns += [one.columns for one in long]
        parameters += [{} for _ in long]
        weights = [0.5, *(0.5 * one.weight for one in long)] if long else weights
    return group_of(effect, axis, columns, parameters, weights)


def switched_group(model: RecordingModel, effect: Effect, axis: str | None, around: Surroundings) -> Group:
    """An effect that is switched on at some time, with an option for each time that is tried."""
    times, widths, weights, firsts = step_times(model)
    columns: list[Array] = []
    parameters: list[Parameters] = []
    shares: list[float] = []
    for trial in effect.trials(around):
        block = switched_columns(model, effect, axis, trial.parameters, firsts)
        columns += [block[:, [k]] for k in range(times.size)]
        parameters += [
            {**trial.parameters, "time_s": float(time), "time_sigma_s": float(width)}
            for time, width in zip(times, widths, strict=True)
        ]
        shares += (trial.weight * weights).tolist()
    return group_of(effect, axis, columns, parameters, shares)


def process_places(
    model: RecordingModel, effect: Effect
) -> tuple[Callable[[Mapping[str, Value]], Array], Callable[..., Array]]:
    """Covariance of a random process where it is seen, by its parameters, and what makes columns of a factor of that."""
    if effect.on_references:
        nodes, first = processes.reference_nodes(model)
        if model.turns_in_observations:
            return lambda parameters: effect.covariance(nodes, parameters), processes.on_nodes
        return lambda parameters: processes.averaged(effect.covariance(nodes, parameters), first), processes.on_references
    cells = processes.cell_times(model)
    return lambda parameters: effect.covariance(cells, parameters), processes.on_cells


def process_groups(model: RecordingModel, effect: Effect, around: Surroundings) -> Iterator[Group]:
    """A random process about each axis."""
    trials = effect.trials(around)
    covariance, make = process_places(model, effect)
    factors = [processes.factor(covariance(trial.parameters)) for trial in trials]
    for number, axis in enumerate(effect.axes):
        columns = [make(model, number, factor) for factor in factors]
        group = group_of(effect, axis, columns, [dict(t.parameters) for t in trials], [t.weight for t in trials])
        yield replace(group, process=True)


def group_of(
    effect: Effect, axis: str | None, columns: Sequence[Array], parameters: Sequence[Parameters], weights: Sequence[float]
) -> Group:
    """An effect as a group, by its columns at each set of parameters."""
    return Group(
        effect=effect.name,
        axis=axis,
        listed=True,
        columns=columns,
        parameters=parameters,
        weights=np.array(weights),
        limits=effect.prior,
        unit=effect.unit,
        positive=effect.sign == "positive",
        weight=effect.weight,
        read=effect.from_amplitudes,
    )


# ---- the period of a swing -----------------------------------------------------------------------------------------------


def scanned_group(model: RecordingModel, effect: Effect, axis: str, found: Found) -> Group:
    """An effect that swings with any period, with an option for each period that a scan of the data has kept."""
    options = found[effect.on_references, AXES.index(axis)].options
    columns = swing_columns(model, effect, axis, np.array([one.frequency for one in options]))
    parameters = [period_parameters(one.frequency, one.width) for one in options]
    group = group_of(effect, axis, columns, parameters, [float(np.exp(one.log_weight)) for one in options])
    # What a size shows grows with the period: the scales are those of all options, not only of the strongest.
    norms = np.array([max(np.linalg.norm(model.projected(part), axis=0).max(), 1e-300) for part in columns])
    low, high = max(effect.prior[0], VISIBLE[0] / norms.max()), min(effect.prior[1], VISIBLE[1] / norms.min())
    return replace(group, scanned=True, scales=spaced(low, high))


# ---- the time constant of a process --------------------------------------------------------------------------------------


def with_finer_process(model: RecordingModel, linear: LinearModel, member: Member, effect: Effect) -> LinearModel:
    """The linear model with a random process as a whole at the option where a member is held, and at those beside it.

    Between them, halfway in log between its parameter and its neighbours', are further ones that share its prior; an effect
    whose options differ in more than one number, or not in numbers, has no neighbours. Between the scale at which it is held
    and its neighbours are further ones, too: what a variance that is off by half leaves of hundreds of amplitudes would be
    another effect.
    """
    entry, held = linear.candidate(member), linear.option(member)
    beside = _beside(entry, held)
    halfway = [_between(held.parameters, entry.options[one].parameters) for one in beside]
    covariance, make = process_places(model, effect)
    number, weight, start = AXES.index(str(entry.axis)), held.log_weight - float(np.log(1 + len(halfway))), linear.W.shape[1]
    options, columns, least = list(entry.options), [], processes.WHOLE / float(entry.scales[member.scale]) ** 2
    wanted = [
        (member.option, held.parameters, weight),
        *((one, entry.options[one].parameters, entry.options[one].log_weight) for one in beside),
        *((None, parameters, weight) for parameters in halfway),
    ]
    for place, parameters, own in wanted:
        columns.append(make(model, number, processes.factor(covariance(parameters)), least))
        window = held.window if place is None else options[place].window
        made = Option(start, columns[-1].shape[1], own, dict(parameters), window)
        if place is None:
            options.append(made)
        else:
            options[place] = made
        start += columns[-1].shape[1]
    W = np.hstack(columns)
    return linear.with_options(member.candidate, options, W, model.projected(W), finer(entry.scales, member.scale))


def with_whole_process(model: RecordingModel, linear: LinearModel, member: Member, effect: Effect) -> LinearModel:
    """The linear model with all columns of a random process that can be seen at a member's scale, at each of its options."""
    entry = linear.candidate(member)
    covariance, make = process_places(model, effect)
    number, start = AXES.index(str(entry.axis)), linear.W.shape[1]
    options, columns, least = [], [], processes.WHOLE / float(entry.scales[member.scale]) ** 2
    for one in entry.options:
        columns.append(make(model, number, processes.factor(covariance(one.parameters)), least))
        options.append(replace(one, start=start, count=columns[-1].shape[1]))
        start += columns[-1].shape[1]
    W = np.hstack(columns)
    return linear.with_options(member.candidate, options, W, linear.projected(W))


def _beside(entry: Candidate, held: Option) -> list[int]:
    """Options whose one parameter is next to that of an option, below and above it."""
    if len(held.parameters) != 1 or any(isinstance(value, str) for value in held.parameters.values()):
        return []
    (name,) = held.parameters
    order = sorted(range(len(entry.options)), key=lambda one: float(entry.options[one].parameters[name]))
    place = next(k for k, one in enumerate(order) if entry.options[one] is held)
    return [order[k] for k in (place - 1, place + 1) if 0 <= k < len(order)]


def _between(one: Parameters, other: Parameters) -> Parameters:
    """The parameter halfway in log between two."""
    ((name, low),), ((_, high),) = one.items(), other.items()
    return {name: float(np.sqrt(float(low) * float(high)))}


# ---- unlisted rivals -----------------------------------------------------------------------------------------------------


def unlisted_groups(model: RecordingModel, found: Found, effects: Sequence[Effect]) -> Iterator[Group]:
    """Every discrepancy that is on no list, with an amplitude of any size."""
    named = [effect.on_references for effect in effects if effect.scanned]
    for one in repeating.families(model, found, named):
        yield replace(_rival(one.name, one.axis, one.columns, False), weights=one.weights, scanned=True)
    for family in unlisted.families(model):
        yield _rival(family.name, family.axis, family.columns, False)
    cells, around = processes.cell_times(model), model.around
    known = [
        effect.covariance(cells, trial.parameters)
        for effect in effects
        if effect.is_process and not effect.on_references and not effect.of_trackers and effect.missing(around) is None
        for trial in effect.trials(around)
    ]
    for process in processes.unlisted(model, known):
        yield _rival(process.name, process.axis, process.columns, True)
    for error in trackers.unlisted(model):
        yield _rival(error.name, error.tracker, error.columns, error.process)


def _rival(name: str, axis: str, columns: Sequence[Array], process: bool) -> Group:
    count = len(columns)
    return Group(name, axis, False, columns, [{}] * count, np.full(count, 1 / count), (0.0, np.inf), "", process)
