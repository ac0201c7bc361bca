"""Build the linear model of a recording: columns of all effects that could be named and of all unlisted rivals.

An effect defines its columns or its covariance, the options to try and its prior weight (`simulator.effects.base.Effect`); this
module converts its columns to observations of the recording. Unlisted rivals are those of `diagnosis.model.alternatives` and
`diagnosis.model.processes`. All get their places, their scales and their priors, and the recording's nuisance parameters are
projected out of them.

The columns of an effect that is not linear in the rate are computed at the rates under M0, which contain the effect itself: for
raw = ω + s c(ω) they are about ω + s c(ω) − δ, with δ the part that G and b absorb, and c at these rates errs by s c'(ω) times
that. A scale factor that grows by some percent up to the fastest turn would be estimated too small by about the same
percentage. With the effect in the model, G and b differ from those of M0 by δG and δb. With these and s by least squares, the
true rate is

    ω = ω_M0 + δG ω_raw + δb − s (G + δG) c(ω),

whose last term is the effect's column. At the new ω all is estimated again, until the columns converge.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import scipy.linalg

from diagnosis.arrays import AXES, LEAST_POSITIVE
from diagnosis.model import alternatives, processes
from diagnosis.model.folds import RECORDING_SPLIT, build_folds
from diagnosis.model.linear import (
    UNBOUNDED_SCALES,
    VISIBLE,
    Candidate,
    CandidateColumns,
    ColumnStore,
    LinearModel,
    ParameterChoice,
    Parameters,
    SelectedCandidate,
    Wanted,
    build_rival,
    build_scales,
    find_scale_range,
)
from diagnosis.model.periods import Found, add_finer_periods, make_columns, make_effect_columns, scan_periods
from diagnosis.model.processes import add_finer_process
from diagnosis.model.recording_model import RANK, RecordingModel, build_parameter_errors
from diagnosis.model.steps import StepTimes, add_finer_times, add_step_times, build_switched_columns, step_times
from diagnosis.model.time_offset import fit_delays
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.arrays import Array
from simulator.effects.base import Effect, Surroundings

ROUNDS = 6  # at most
UNCHANGED = 0.03  # sigmas of all observations together, change of the effect below which the columns have converged
NONLINEAR = 0.3  # the same, from which on the columns are taken at the true rates


def build_linear_model(
    model: RecordingModel,
    effects: Sequence[Effect],
    settings: DiagnosisSettings = DEFAULT,
    rivals: bool = True,
    scan: bool = True,
    report_count: Callable[[int], None] = lambda count: None,
) -> LinearModel:
    """Build the linear model of a recording, linearised about its calibration under M0.

    Parameters
    ----------
    rivals : whether unlisted rivals compete
    scan : whether the data are scanned for sinusoids of any period; if not, some periods stand for all of them
    report_count : called with the number of groups built so far, before each
    """
    report_count(0)
    periods = scan_periods(model) if scan else None

    store = ColumnStore(model.nuisance)

    def store_groups() -> Iterator[CandidateColumns]:
        others = list_alternative_groups(model, periods or {}, effects) if rivals else ()
        for count, group in enumerate(chain(list_effect_groups(model, effects, periods), others)):
            report_count(count)
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

    Each effect has the same prior, shared by its axes, and so has each rival. Scales with signal-to-noise ratios outside the
    `visible` range are left out, and candidates without scales. `projected` projects the nuisance parameters out of columns.
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
        scales, windows = _choose_scales(group, norms, visible)
        if not scales.size:
            continue
        family = (1 - share) / len(names) if group.listed else share / len(rivals)
        options = []
        for end, norm, weight, parameters, window in zip(
            stops.tolist(), norms, group.weights, group.parameters, windows, strict=True
        ):
            if not window[0] < window[1] or (group.scales is None and not norm.size):  # the option cannot be seen here
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


def _choose_scales(
    group: CandidateColumns, norms: Sequence[Array], visible: tuple[float, float]
) -> tuple[Array, list[tuple[float, float]]]:
    """Choose the scales of a group by the norms of its columns per option; also the range of scales that each option has."""
    unbounded = [UNBOUNDED_SCALES] * len(norms)
    if group.scales is not None:
        return group.scales, unbounded
    largest = max((float(norm.max()) for norm in norms if norm.size), default=0.0)
    scales = build_scales(*find_scale_range(largest, group.limits, visible))
    if not (group.process and scales.size):
        return scales, unbounded
    # The signal-to-noise ratio of a random process differs between its options, each of which has its own scales.
    windows = [find_scale_range(float(norm.max(initial=0.0)), group.limits, visible) for norm in norms]
    shown = [(low, high) for low, high in windows if low < high]
    return build_scales(min(low for low, _ in shown), max(high for _, high in shown)), windows


def assemble_linear_model(
    model: RecordingModel,
    candidates: tuple[Candidate, ...],
    store: ColumnStore,
    effects: Mapping[str, Effect],
    settings: DiagnosisSettings,
) -> LinearModel:
    """Assemble the linear model of a recording from its candidates and their stored columns."""
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


def list_effect_groups(
    model: RecordingModel, effects: Sequence[Effect], periods: Found | None, steps: StepTimes | None = None
) -> Iterator[CandidateColumns]:
    """List the effects that have columns or a covariance and can be seen in this recording, as groups of columns.

    Steps are tried at the times of `step_times` unless others are given.
    """
    around = model.surroundings
    for effect in effects:
        if effect.missing(around) is not None:
            continue
        if effect.has_columns:
            for axis in effect.axes or (None,):
                if effect.scanned and periods is not None:
                    if periods:
                        yield build_scanned_group(model, effect, str(axis), periods)
                elif effect.switched:
                    yield build_switched_group(model, effect, axis, around, steps)
                else:
                    yield build_plain_group(model, effect, axis, around)
        elif effect.is_process:
            yield from list_process_groups(model, effect, around)


def build_plain_group(model: RecordingModel, effect: Effect, axis: str | None, around: Surroundings) -> CandidateColumns:
    """Build the group of an effect that acts throughout, with an option for each set of parameters that is tried."""
    trials = effect.trials(around)
    columns = [make_columns(model, effect, axis, trial.parameters) for trial in trials]
    parameters, weights = [dict(trial.parameters) for trial in trials], [trial.weight for trial in trials]
    if effect.stage == "clock" and effect.unit == "s":  # one delay, of any length
        long = fit_delays(model, columns[0], effect.prior)
        columns += [column for column, _ in long]
        parameters += [{} for _ in long]
        weights = [0.5, *(0.5 * weight for _, weight in long)] if long else weights  # longer ones have half of the prior
    return build_group(effect, axis, columns, parameters, weights)


def build_switched_group(
    model: RecordingModel, effect: Effect, axis: str | None, around: Surroundings, steps: StepTimes | None = None
) -> CandidateColumns:
    """Build the group of an effect that is switched on at some time, with an option for each time that is tried."""
    times, widths, weights, firsts = steps or step_times(model)
    columns: list[Array] = []
    parameters: list[Parameters] = []
    shares: list[float] = []
    for trial in effect.trials(around):
        block = build_switched_columns(model, effect, axis, trial.parameters, firsts)
        columns += [block[:, [k]] for k in range(times.size)]
        parameters += [
            {**trial.parameters, "time_s": float(time), "time_sigma_s": float(width)}
            for time, width in zip(times, widths, strict=True)
        ]
        shares += (trial.weight * weights).tolist()
    return build_group(effect, axis, columns, parameters, shares)


def list_process_groups(model: RecordingModel, effect: Effect, around: Surroundings) -> Iterator[CandidateColumns]:
    """List the groups of a random process, one about each axis."""
    trials = effect.trials(around)
    covariance, places = processes.list_process_places(model, effect)
    columns: dict[str, list[Array]] = {axis: [] for axis in effect.axes}
    for trial in trials:
        K = covariance(trial.parameters)  # one at a time: there may be two thousand times
        for place, axis_columns in zip(places, columns.values(), strict=True):
            axis_columns.append(processes.build_usual_columns(place, K))
    for axis, axis_columns in columns.items():
        group = build_group(effect, axis, axis_columns, [dict(t.parameters) for t in trials], [t.weight for t in trials])
        yield replace(group, process=True)


def build_group(
    effect: Effect, axis: str | None, columns: Sequence[Array], parameters: Sequence[Parameters], weights: Sequence[float]
) -> CandidateColumns:
    """Build the group of a listed effect from its columns at each set of parameters."""
    return CandidateColumns(
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


def build_scanned_group(model: RecordingModel, effect: Effect, axis: str, periods: Found) -> CandidateColumns:
    """Build the group of a sinusoidal effect, with an option for each period that a scan of the data has selected."""
    options = periods[effect.on_references, AXES.index(axis)]
    columns = make_effect_columns(model, effect, axis, np.array([period.frequency for period in options]))
    parameters = [option.parameters for option in options]
    group = build_group(effect, axis, columns, parameters, [float(np.exp(period.log_weight)) for period in options])
    # The signal-to-noise ratio of a size grows with the period: the scales cover all options, not only the strongest.
    norms = np.array([max(np.linalg.norm(model.project_out_nuisance(part), axis=0).max(), 1e-300) for part in columns])
    low, high = max(effect.prior[0], VISIBLE[0] / norms.max()), min(effect.prior[1], VISIBLE[1] / norms.min())
    return replace(group, scanned=True, scales=build_scales(low, high))


def list_alternative_groups(model: RecordingModel, periods: Found, effects: Sequence[Effect]) -> Iterator[CandidateColumns]:
    """Build the candidates for effects outside the library: periodic, deterministic and random misfits of any amplitude."""
    named = [effect.on_references for effect in effects if effect.scanned]
    yield from alternatives.list_periodic_rivals(model, periods, named)
    yield from alternatives.list_deterministic_rivals(model)
    between = build_interval_steps(model, effects)
    for alternative in processes.list_process_alternatives(model):
        bases = between.get(alternative.axis or "", [])
        selected = [
            k for k, columns in enumerate(alternative.columns) if not _is_within(model.project_out_nuisance(columns), bases)
        ]
        if selected:
            columns, parameters = [alternative.columns[k] for k in selected], [alternative.parameters[k] for k in selected]
            yield build_rival(alternative.effect, alternative.axis, columns, True, parameters=parameters)


def build_interval_steps(model: RecordingModel, effects: Sequence[Effect]) -> dict[str, list[Array]]:
    """Build orthonormal bases (N, k) of steps of listed effects about each axis between two intervals.

    With just two intervals, a different value in each is a step between them, and no rival of a step.
    """
    bases: dict[str, list[Array]] = {axis: [] for axis in AXES}
    if len(model.blocks) != 2:
        return bases
    second = np.array([model.blocks[1].steps.start])
    for effect in effects:
        if effect.switched and effect.has_columns and not effect.on_references and effect.missing(model.surroundings) is None:
            for axis in AXES:
                steps = [
                    build_switched_columns(model, effect, axis, trial.parameters, second)
                    for trial in effect.trials(model.surroundings)
                ]
                bases[axis].append(scipy.linalg.orth(model.project_out_nuisance(np.hstack(steps))))
    return bases


def _is_within(columns: Array, bases: Sequence[Array]) -> bool:
    """Check whether projected columns (N, r) lie in the span of one of the bases, but for a small part of their power."""
    power = float(np.sum(columns**2))
    return any(float(np.sum((basis.T @ columns) ** 2)) > processes.ALIKE * power for basis in bases)


def use_true_rates(model: RecordingModel, linear: LinearModel, member: SelectedCandidate, effect: Effect) -> LinearModel:
    """Replace the columns of a member's option by those at the true rates, where these differ enough.

    Only effects with columns that are not switched on are changed.
    """
    entry, option = linear.candidate(member), linear.option(member)
    if entry.process or effect.on_references or effect.switched or not effect.has_columns or effect.stage != "rate":
        return linear
    before = linear.X[:, option.columns]
    high, W, X = effect.columns(model.stream, entry.axis, option.parameters), linear.W[:, option.columns], before
    if high.shape[2] != option.count:  # with the rounding of a covariate
        return linear
    amplitudes = _fit_amplitudes(linear, member, X)
    for _ in range(ROUNDS):
        change = _change(model, W @ amplitudes)
        G = model.G + change[:9].reshape(3, 3)
        rates = model.rates + build_parameter_errors(model.raw) @ change - (high @ amplitudes) @ G.T
        high, last = effect.columns(replace(model.stream, rates=rates), entry.axis, option.parameters), X @ amplitudes
        W = model.whiten(model.observe_rate_error(-np.einsum("ij,njk->nik", G, high)))
        X = model.project_out_nuisance(W)
        amplitudes = _fit_amplitudes(linear, member, X)
        if np.linalg.norm(X @ amplitudes - last) < UNCHANGED:
            break
    if np.linalg.norm((X - before) @ amplitudes) < NONLINEAR:
        return linear
    options = list(entry.options)
    options[member.option] = replace(option, start=linear.X.shape[1])
    return linear.replace_options(member.candidate, options, W, X)


def _fit_amplitudes(linear: LinearModel, member: SelectedCandidate, X: Array) -> Array:
    """Fit the amplitudes (k,) of columns (N, k) under the prior of the member's scale."""
    return np.asarray(np.linalg.solve(X.T @ X + np.eye(X.shape[1]) / linear.scale(member) ** 2, X.T @ linear.y))


def _change(model: RecordingModel, explained_by_effect: Array) -> Array:
    """Fit the change (12,) of G_xx, …, G_zz and b, rad/s, from M0 beside the observations (N,) that an effect explains."""
    columns = np.hstack([model.calibration, model.starts])
    scale = 1 / np.maximum(np.linalg.norm(columns, axis=0), LEAST_POSITIVE)
    unexplained = model.whiten(model.zeta) - explained_by_effect
    return np.asarray((scale * np.linalg.lstsq(columns * scale, unexplained, rcond=RANK)[0])[:12])
