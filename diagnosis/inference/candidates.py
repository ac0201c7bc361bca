"""The bank of candidates: every effect that could be named, and every rival, as groups of columns of one linear model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.deadzone import DeadStretches, missing
from diagnosis.inference.evidence import Option, scales_of
from diagnosis.model import processes as random_effects
from diagnosis.model import unlisted as generic
from diagnosis.model.recording import Model
from simulator.effects import EFFECTS, Effect

Array = NDArray[np.float64]

AXES = "xyz"
UNLISTED_SHARE = 0.2  # prior of all rivals together
LONGEST_STEP_GAP = 300.0  # s between the times a step is tried at, before refinement
MOST_STEPS = 14  # times a step is tried at inside an interval
MOST_ODDS = 4.0  # what the samples may say for a dead zone that is not certain from them
LIKELIHOOD = {"rate_lag": 0.75}  # prior of an effect beside that of the others: late tags are commoner than a slow gyro
SPLIT_TIMES = 0.5  # prior of a step in a gap between intervals


@dataclass(frozen=True)
class Candidate:
    """An effect about an axis, or a rival.

    Attributes
    ----------
    effect : its name; for a rival, what it is in words
    axis : body axis, or None
    listed : whether it may be named as a cause
    log_prior : log of its prior share among all candidates
    options : ways it can be
    scales : standard deviations of the amplitudes to average over, in its unit
    unit : of its size
    log_odds : evidence from outside of the linear model; it tells causes apart, and cannot make a gap
    """

    effect: str
    axis: str | None
    listed: bool
    log_prior: float
    options: tuple[Option, ...]
    scales: Array
    unit: str
    log_odds: float = 0.0

    @property
    def label(self) -> str:
        """The name with its axis."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"


@dataclass(frozen=True)
class Bank:
    """Candidates and their columns.

    Attributes
    ----------
    W : (N, p) whitened columns
    X : (N, p) the same with what M0 leaves free projected out
    candidates : who owns which
    """

    W: Array
    X: Array
    candidates: tuple[Candidate, ...]

    def find(self, label: str) -> int | None:
        """Index of a candidate by its label."""
        return next((k for k, candidate in enumerate(self.candidates) if candidate.label == label), None)


@dataclass(frozen=True)
class _Entry:
    """A candidate before its place in the bank is known."""

    effect: str
    axis: str | None
    listed: bool
    columns: Sequence[Array]
    parameters: Sequence[dict[str, float | str]]
    weights: Array
    limits: tuple[float, float]
    unit: str
    log_odds: float = 0.0


def build(model: Model, library: Sequence[str] | None = None, rivals: bool = True, dead: Sequence[DeadStretches] = ()) -> Bank:
    """The bank of a recording.

    Parameters
    ----------
    model : the linear model
    library : names of the effects that may be named; all by default
    rivals : whether to add the discrepancies that are no listed effect
    dead : gyros that read zero for long, which may have a dead zone
    """
    allowed = set(EFFECTS if library is None else library)
    entries = list(_listed(model, allowed))
    if "rate_deadzone" in allowed:
        entries += [_dead_zone(model, one) for one in dead]
    if rivals:
        entries += _unlisted(model)
    return _assembled(model, entries)


def _assembled(model: Model, entries: list[_Entry]) -> Bank:
    listed = {entry.effect for entry in entries if entry.listed}
    rivals = {entry.effect for entry in entries if not entry.listed}
    share = UNLISTED_SHARE if rivals and listed else 1.0
    axes = {name: sum(entry.effect == name for entry in entries) for name in listed | rivals}
    candidates, columns = [], []
    start = 0
    for entry in entries:
        largest = max(float(np.linalg.norm(model.projected(part), axis=0).max()) for part in entry.columns)
        scales = scales_of(largest, entry.limits)
        if not scales.size:
            continue
        family = (1 - share) / len(listed) if entry.listed and rivals else share / max(len(rivals), 1)
        if not rivals:
            family = 1.0 / len(listed)
        options = []
        for part, weight, parameters in zip(entry.columns, entry.weights, entry.parameters, strict=True):
            options.append(Option(start, part.shape[1], float(np.log(weight)), parameters))
            columns.append(part)
            start += part.shape[1]
        prior = float(np.log(LIKELIHOOD.get(entry.effect, 1.0) * family / axes[entry.effect]))
        candidates.append(
            Candidate(entry.effect, entry.axis, entry.listed, prior, tuple(options), scales, entry.unit, entry.log_odds)
        )
    W = np.hstack(columns)
    return Bank(W, model.projected(W), tuple(candidates))


def _listed(model: Model, library: set[str]) -> Iterator[_Entry]:
    for name in sorted(library):
        effect = EFFECTS[name]
        if effect.has_columns and available(model, effect):
            yield from _steps(model, effect) if _has_time(effect) else _plain(model, effect)
    for process in random_effects.processes(model, rivals=False):
        if process.name in library:
            effect = EFFECTS[process.name]
            count = len(process.columns)
            weights = np.full(count, 1 / count)
            yield _Entry(
                process.name, process.axis, True, process.columns, process.parameters, weights, effect.prior, effect.unit
            )


def _dead_zone(model: Model, one: DeadStretches) -> _Entry:
    """A missing rate of its own in each slow stretch."""
    effect = EFFECTS["rate_deadzone"]
    known: dict[str, float | str] = {
        "_size": float(np.rad2deg(one.size)),
        "_sigma": float(np.rad2deg(one.sigma)),
        "_alive": float(np.rad2deg(one.alive)),
    }
    columns = [model.whitened(missing(model, one))]
    return _Entry(
        effect.name, AXES[one.axis], True, columns, [known], np.ones(1), effect.prior, effect.unit, min(one.log_odds, MOST_ODDS)
    )


def available(model: Model, effect: Effect) -> bool:
    """Whether the recording has what the effect needs."""
    return effect.missing(model.around) is None


def _has_time(effect: Effect) -> bool:
    return any(parameter.name == "time_s" for parameter in effect.parameters)


def columns_of(model: Model, effect: Effect, axis: str | None, parameters: dict[str, float | str]) -> Array:
    """(N, k) whitened columns of an effect per unit of its amplitudes."""
    if effect.on_references:
        return model.whitened(model.reference_error(effect.reference_columns(model.references, axis, parameters)))
    return model.whitened(model.reading(effect.columns(model.stream, axis, parameters)))


def _plain(model: Model, effect: Effect) -> Iterator[_Entry]:
    for axis in effect.axes or (None,):
        columns = columns_of(model, effect, axis, {})
        yield _Entry(effect.name, axis, True, [columns], [{}], np.ones(1), effect.prior, effect.unit)


def step_times(model: Model, spacing_s: float = LONGEST_STEP_GAP) -> tuple[Array, Array, NDArray[np.intp]]:
    """Times a step is tried at, their prior weights, and the step of the stream each begins with.

    Between two intervals only the fact can be seen, so the middle of the gap stands for all of it.
    """
    times, weights, firsts = [], [], []
    blocks = model.blocks
    total = sum(float(block.elapsed_s[-1]) for block in blocks)
    gaps = len(blocks) - 1
    for number, block in enumerate(blocks):
        duration = float(block.elapsed_s[-1])
        if number:
            end = float(model.t_s[blocks[number - 1].steps.stop - 1])
            times.append(0.5 * (end + float(model.t_s[block.steps.start])))
            weights.append(SPLIT_TIMES / gaps)
            firsts.append(block.steps.start)
        count = int(np.clip(duration / spacing_s, 3, MOST_STEPS))
        inside = block.steps.start + (np.arange(1, count + 1) / (count + 1) * (block.steps.stop - block.steps.start)).astype(
            int
        )
        times += [float(model.t_s[k]) for k in inside]
        weights += [(1 - SPLIT_TIMES if gaps else 1.0) * duration / total / count] * count
        firsts += inside.tolist()
    return np.array(times), np.array(weights), np.array(firsts)


def _steps(model: Model, effect: Effect) -> Iterator[_Entry]:
    times, weights, firsts = step_times(model)
    toward = AXES if any(parameter.name == "toward" for parameter in effect.parameters) else ("",)
    begin = float(model.t_s[0]) - 1.0
    for axis in effect.axes:
        columns: list[Array] = []
        parameters: list[dict[str, float | str]] = []
        for other in toward:
            fixed: dict[str, float | str] = {"toward": other} if other else {}
            on = effect.columns(model.stream, axis, {**fixed, "time_s": begin})[:, :, 0]
            block = model.whitened(model.reading_steps(on, firsts))
            columns += [block[:, [k]] for k in range(times.size)]
            parameters += [{**fixed, "time_s": float(time)} for time in times]
        yield _Entry(
            effect.name, axis, True, columns, parameters, np.tile(weights, len(toward)) / len(toward), effect.prior, effect.unit
        )


def with_fine_steps(model: Model, bank: Bank, candidate: int, option: int, count: int = 48) -> Bank:
    """The bank with more times for a step, close together around the one it is tried at.

    They take over the prior of the times between which they lie; a gap between intervals keeps its own.
    """
    entry = bank.candidates[candidate]
    parameters = entry.options[option].parameters
    if "time_s" not in parameters:
        return bank
    same = [o for o in entry.options if o.parameters.get("toward") == parameters.get("toward")]
    times = sorted(float(o.parameters["time_s"]) for o in same)
    place = times.index(float(parameters["time_s"]))
    low, high = times[max(place - 2, 0)], times[min(place + 2, len(times) - 1)]
    trial = np.linspace(low, high, count)
    firsts = np.unique(np.searchsorted(model.t_s, trial))
    firsts = firsts[(firsts > 0) & (firsts < model.t_s.size)]
    fixed = {key: value for key, value in parameters.items() if key == "toward"}
    on = EFFECTS[entry.effect].columns(model.stream, entry.axis, {**fixed, "time_s": float(model.t_s[0]) - 1.0})[:, :, 0]
    W = model.whitened(model.reading_steps(on, firsts))
    start = bank.W.shape[1]
    inside = [o for o in same if low <= float(o.parameters["time_s"]) <= high and not _in_a_gap(model, o)]
    if not inside or not firsts.size:
        return bank
    weight = float(np.log(sum(np.exp(o.log_weight) for o in inside) / (2 * firsts.size)))
    fine = tuple(Option(start + k, 1, weight, {**fixed, "time_s": float(model.t_s[first])}) for k, first in enumerate(firsts))
    coarse = tuple(replace(o, log_weight=o.log_weight - np.log(2)) if o in inside else o for o in entry.options)
    candidates = list(bank.candidates)
    candidates[candidate] = replace(entry, options=coarse + fine)
    return Bank(np.hstack([bank.W, W]), np.hstack([bank.X, model.projected(W)]), tuple(candidates))


def _in_a_gap(model: Model, option: Option) -> bool:
    """Whether a step is tried between two intervals."""
    time_s = float(option.parameters["time_s"])
    return not any(model.t_s[block.steps.start] <= time_s <= model.t_s[block.steps.stop - 1] for block in model.blocks)


def _unlisted(model: Model) -> Iterator[_Entry]:
    for family in generic.families(model):
        yield _rival(family.name, family.axis, family.columns)
    for process in random_effects.processes(model):
        if not process.listed:
            yield _rival(process.name, process.axis, process.columns)


def _rival(name: str, axis: str, columns: Sequence[Array]) -> _Entry:
    count = len(columns)
    return _Entry(name, axis, False, columns, [{}] * count, np.full(count, 1 / count), (0.0, np.inf), "")
