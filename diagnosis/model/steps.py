"""The moment at which an effect is switched on: the times that are tried, and finer ones around the likeliest.

A step is tried at some times beforehand. Around a time that explains the data it gets further options, close enough together to
be told apart. Their prior is that of the time they span.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.gyro_array import ArrayModel
from diagnosis.model.linear import LinearModel, Member, Option, Parameters
from diagnosis.model.recording import RecordingModel
from simulator.effects.base import Effect, Value
from simulator.effects.gyros import columns_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
StepTimes = tuple[Array, Array, Array, Indices]  # of `step_times`


@dataclass(frozen=True)
class StepSettings:
    """Constants of `diagnosis.model.steps`."""

    longest_step_gap: float = 300.0  # s between the times a step is tried at, before refinement
    most_step_times: int = 14  # times a step is tried at inside an interval
    fine_step_times: int = 48  # times around one that was found
    between_intervals: float = 0.5  # prior of a step in a gap between intervals
    already_on: float = 1.0  # s before the first sample, when a switched column is on throughout
    rounding: int = 6  # decimals of a duration in s


SETTINGS = StepSettings()


def step_times(model: RecordingModel | ArrayModel, spacing_s: float = SETTINGS.longest_step_gap) -> StepTimes:
    """Times a step is tried at, how far each may be off where that is not known, their prior weights, and their first steps.

    Between two intervals only the fact can be seen, so the middle of the gap stands for all of it.
    """
    times, widths, weights, firsts = [], [], [], []
    stream, t_s = model.stream, model.stream.t_s
    parts = [part for part in stream.intervals if part.stop > part.start]
    durations = [round(float(stream.duration_s[part].sum()), SETTINGS.rounding) for part in parts]
    gaps = len(parts) - 1
    for number, (part, duration) in enumerate(zip(parts, durations, strict=True)):
        if number:
            end, begin = float(t_s[parts[number - 1].stop - 1]), float(t_s[part.start])
            times.append(0.5 * (end + begin))
            widths.append((begin - end) / np.sqrt(12))
            weights.append(SETTINGS.between_intervals / gaps)
            firsts.append(part.start)
        count = int(np.clip(duration / spacing_s, 3, SETTINGS.most_step_times))
        inside = part.start + (np.arange(1, count + 1) / (count + 1) * (part.stop - part.start)).astype(int)
        times += t_s[inside].tolist()
        widths += [0.0] * count
        weights += [(1 - SETTINGS.between_intervals if gaps else 1.0) * duration / sum(durations) / count] * count
        firsts += inside.tolist()
    return np.array(times), np.array(widths), np.array(weights), np.array(firsts)


def switched_columns(
    model: RecordingModel | ArrayModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value], firsts: Indices
) -> Array:
    """(N, s) whitened columns of an effect that is switched on at each of several steps."""
    stream = model.stream
    begin = float(stream.t_s[0]) - SETTINGS.already_on - float(stream.duration_s[0])
    on = columns_of(effect, stream, axis, {**parameters, "time_s": begin})[:, :, 0]
    return model.whitened(model.reading_steps(on, firsts))


def with_finer_times(model: RecordingModel | ArrayModel, linear: LinearModel, member: Member, effect: Effect) -> LinearModel:
    """The linear model with more times for a step of any element, close together around the one at which a member is held.

    They take over half the prior of the times between which they lie; a gap between intervals keeps its own.
    """
    entry, parameters = linear.candidate(member), linear.option(member).parameters
    if "time_s" not in parameters:
        return linear
    times = sorted({float(o.parameters["time_s"]) for o in entry.options})
    place = times.index(float(parameters["time_s"]))
    low, high = times[max(place - 2, 0)], times[min(place + 2, len(times) - 1)]
    firsts = np.unique(np.searchsorted(model.stream.t_s, np.linspace(low, high, SETTINGS.fine_step_times)))
    firsts = firsts[(firsts > 0) & (firsts < model.stream.t_s.size)]
    if not firsts.size:
        return linear
    known = [o for o in entry.options if not float(o.parameters["time_sigma_s"])]
    inside = [o for o in known if low <= float(o.parameters["time_s"]) <= high]
    # Of elements of one row, the one whose tried time is nearest to the true one would win over the true one.
    for fixed in _fixed(option.parameters for option in entry.options):
        givers = [one for one in inside if _without_time(one.parameters) == fixed]
        if not givers:
            continue
        start, W = linear.W.shape[1], switched_columns(model, effect, entry.axis, fixed, firsts)
        weight = float(np.log(0.5 * sum(np.exp(one.log_weight) for one in givers) / firsts.size))
        finer = [
            Option(start + k, 1, weight, {**fixed, "time_s": float(model.stream.t_s[first]), "time_sigma_s": 0.0})
            for k, first in enumerate(firsts)
        ]
        options = linear.candidates[member.candidate].options
        coarse = [replace(one, log_weight=one.log_weight - float(np.log(2))) if one in givers else one for one in options]
        linear = linear.with_options(member.candidate, [*coarse, *finer], W, model.projected(W))
    return linear


def _without_time(parameters: Parameters) -> Parameters:
    return {name: value for name, value in parameters.items() if not name.startswith("time_")}


def _fixed(parameters: Iterable[Parameters]) -> list[Parameters]:
    """Each set of parameters but the time, once."""
    found: list[Parameters] = []
    for one in parameters:
        fixed = _without_time(one)
        if fixed not in found:
            found.append(fixed)
    return found
