"""Every effect that could be named, and every unlisted rival, as a group of columns of a recording.

An effect says itself which columns or which covariance it has, which options are worth trying and how plausible it is
(`simulator.effects.base.Effect`); here its columns become observations of the recording. Unlisted rivals are those of
`diagnosis.model.deterministic_alternatives`, `diagnosis.model.periodic_alternatives` and `diagnosis.model.processes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model import deterministic_alternatives, periodic_alternatives, processes
from diagnosis.model.linear import VISIBLE, Parameters, add_no_sigma, build_scales, read_first_amplitude
from diagnosis.model.periods import Found, make_columns, make_effect_columns
from diagnosis.model.process_projection import ProcessProjection
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.steps import StepTimes, build_switched_columns, step_times
from diagnosis.model.time_offset import fit_delays
from simulator.effects.base import Effect, Surroundings, Value

Array = NDArray[np.float64]

AXES = "xyz"


@dataclass(frozen=True)
class CandidateColumns:
    """A candidate before its place in the model is known."""

    # effect, axis, listed, unit, process, positive, log_odds, read, size_sigma, shifted, scanned: as in
    # `Candidate`
    effect: str
    axis: str | None
    listed: bool
    columns: Sequence[Array]  # per option (N, k) whitened columns
    parameters: Sequence[Parameters]  # per option
    weights: Array  # (o,) prior share of each option
    limits: tuple[float, float]  # plausible range of the size
    unit: str
    process: bool = False
    positive: bool = False
    weight: float = 1.0  # prior of its effect beside that of the others
    log_odds: float = 0.0
    read: Callable[[Array], tuple[float, Parameters]] = read_first_amplitude
    size_sigma: Callable[[float], float] = add_no_sigma
    shifted: bool = False
    scales: Array | None = None  # as in `Candidate`; by default those within the limits that the columns can show
    scanned: bool = False


# ---- listed effects ------------------------------------------------------------------------------------------------------


def list_effect_groups(
    model: RecordingModel, effects: Sequence[Effect], found: Found | None, steps: StepTimes | None = None
) -> Iterator[CandidateColumns]:
    """The effects that have columns or a covariance and can be seen in this recording.

    Parameters
    ----------
    model, effects : the recording and what may be named
    found : by a scan for periods
    steps : times that steps are tried at; those of `step_times` by default
    """
    around = model.surroundings
    for effect in effects:
        if effect.missing(around) is not None:
            continue
        if effect.has_columns:
            for axis in effect.axes or (None,):
                if effect.scanned and found is not None:
                    if found:
                        yield build_scanned_group(model, effect, str(axis), found)
                elif effect.switched:
                    yield build_switched_group(model, effect, axis, around, steps)
                else:
                    yield build_plain_group(model, effect, axis, around)
        elif effect.is_process:
            yield from list_process_groups(model, effect, around)


def build_plain_group(model: RecordingModel, effect: Effect, axis: str | None, around: Surroundings) -> CandidateColumns:
    """An effect whose columns are there throughout, with an option for each set of parameters worth trying."""
    trials = effect.trials(around)
    columns = [make_columns(model, effect, axis, trial.parameters) for trial in trials]
    parameters, weights = [dict(trial.parameters) for trial in trials], [trial.weight for trial in trials]
    if effect.stage == "clock" and effect.unit == "s":  # one delay, of any length
        long = fit_delays(model, columns[0], effect.prior)
        columns += [one.columns for one in long]
        parameters += [{} for _ in long]
        weights = [0.5, *(0.5 * one.weight for one in long)] if long else weights
    return build_group(effect, axis, columns, parameters, weights)


def build_switched_group(
    model: RecordingModel, effect: Effect, axis: str | None, around: Surroundings, steps: StepTimes | None = None
) -> CandidateColumns:
    """An effect that is switched on at some time, with an option for each time that is tried."""
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


def list_process_places(
    model: RecordingModel, effect: Effect
) -> tuple[Callable[[Mapping[str, Value]], Array], tuple[ProcessProjection, ...]]:
    """Covariance of a random process at the times it is taken at, by its parameters; and where it acts, about each axis."""
    times = processes.compute_node_times(model) if effect.on_references else processes.compute_part_times(model)
    return partial(effect.covariance, times), model.reference_places if effect.on_references else model.cell_places


def list_process_groups(model: RecordingModel, effect: Effect, around: Surroundings) -> Iterator[CandidateColumns]:
    """A random process about each axis."""
    trials = effect.trials(around)
    covariance, places = list_process_places(model, effect)
    columns: dict[str, list[Array]] = {axis: [] for axis in effect.axes}
    for trial in trials:
        K = covariance(trial.parameters)  # one at a time: there may be two thousand times
        for place, made in zip(places, columns.values(), strict=True):
            made.append(processes.build_usual_columns(place, K))
    for axis, made in columns.items():
        group = build_group(effect, axis, made, [dict(t.parameters) for t in trials], [t.weight for t in trials])
        yield replace(group, process=True)


def build_group(
    effect: Effect, axis: str | None, columns: Sequence[Array], parameters: Sequence[Parameters], weights: Sequence[float]
) -> CandidateColumns:
    """An effect as a group, by its columns at each set of parameters."""
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


# ---- the period of a swing -----------------------------------------------------------------------------------------------


def build_scanned_group(model: RecordingModel, effect: Effect, axis: str, found: Found) -> CandidateColumns:
    """An effect that swings with any period, with an option for each period that a scan of the data has kept."""
    options = found[effect.on_references, AXES.index(axis)]
    columns = make_effect_columns(model, effect, axis, np.array([one.frequency for one in options]))
    parameters = [one.parameters for one in options]
    group = build_group(effect, axis, columns, parameters, [float(np.exp(one.log_weight)) for one in options])
    # What a size shows grows with the period: the scales are those of all options, not only of the strongest.
    norms = np.array([max(np.linalg.norm(model.project_out_nuisance(part), axis=0).max(), 1e-300) for part in columns])
    low, high = max(effect.prior[0], VISIBLE[0] / norms.max()), min(effect.prior[1], VISIBLE[1] / norms.min())
    return replace(group, scanned=True, scales=build_scales(low, high))


# ---- unlisted rivals -----------------------------------------------------------------------------------------------------


def list_alternative_groups(model: RecordingModel, found: Found, effects: Sequence[Effect]) -> Iterator[CandidateColumns]:
    """Build the candidates for effects outside the library: periodic, deterministic and random misfits of any amplitude."""
    named = [effect.on_references for effect in effects if effect.scanned]
    for one in periodic_alternatives.list_families(model, found, named):
        yield replace(build_rival(one.name, one.axis, one.columns, False, one.weights), scanned=True)
    for family in deterministic_alternatives.build_families(model):
        yield build_rival(family.name, family.axis, family.columns, False)
    between = build_interval_steps(model, effects)
    for process in processes.list_process_alternatives(model):
        bases = between.get(process.axis or "", [])
        kept = [k for k, one in enumerate(process.columns) if not _is_within(model.project_out_nuisance(one), bases)]
        parameters: list[Parameters] = [
            {"time_constant_s": process.time_constants_s[k]} if process.time_constants_s else {} for k in kept
        ]
        if kept:
            yield build_rival(process.name, process.axis, [process.columns[k] for k in kept], True, parameters=parameters)


def build_interval_steps(model: RecordingModel, effects: Sequence[Effect]) -> dict[str, list[Array]]:
    """Orthonormal bases (N, k) of what steps of listed effects about each axis look like between two intervals.

    Where there are just two, what has a value of its own in each is a step between them, and no rival of it.
    """
    found: dict[str, list[Array]] = {axis: [] for axis in AXES}
    if len(model.blocks) != 2:
        return found
    second = np.array([model.blocks[1].steps.start])
    for effect in effects:
        if effect.switched and effect.has_columns and not effect.on_references and effect.missing(model.surroundings) is None:
            for axis in AXES:
                steps = [
                    build_switched_columns(model, effect, axis, one.parameters, second)
                    for one in effect.trials(model.surroundings)
                ]
                found[axis].append(scipy.linalg.orth(model.project_out_nuisance(np.hstack(steps))))
    return found


def _is_within(columns: Array, bases: Sequence[Array]) -> bool:
    """Whether some projected columns (N, r) lie in the span of one of the bases, but for a small part of their power."""
    power = float(np.sum(columns**2))
    return any(float(np.sum((basis.T @ columns) ** 2)) > processes.ALIKE * power for basis in bases)


def build_rival(
    name: str,
    axis: str | None,
    columns: Sequence[Array],
    process: bool,
    weights: Array | None = None,
    parameters: Sequence[Parameters] | None = None,
) -> CandidateColumns:
    """Build a discrepancy that is on no list, with options of equal prior unless their weights are given."""
    count = len(columns)
    shares = np.full(count, 1 / count) if weights is None else weights
    return CandidateColumns(name, axis, False, columns, parameters or [{}] * count, shares, (0.0, np.inf), "", process)
