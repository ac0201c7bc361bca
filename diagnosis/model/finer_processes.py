"""A random process beside what else is thought to be there: with finer time constants, or with all that can be seen of it.

The first search gives a process the columns in which it usually shows, at the options of its group; where it is likely it is
asked again as a whole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.model import processes
from diagnosis.model.groups import AXES, process_places
from diagnosis.model.linear import Candidate, LinearModel, Member, Option, Parameters, finer
from diagnosis.model.recording import RecordingModel
from simulator.effects.base import Effect


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
    covariance, places = process_places(model, effect)
    number, weight, start = AXES.index(str(entry.axis)), held.log_weight - float(np.log(1 + len(halfway))), linear.W.shape[1]
    options, columns, least = list(entry.options), [], processes.WHOLE / float(entry.scales[member.scale]) ** 2
    wanted = [
        (member.option, held.parameters, weight),
        *((one, entry.options[one].parameters, entry.options[one].log_weight) for one in beside),
        *((None, parameters, weight) for parameters in halfway),
    ]
    for place, parameters, own in wanted:
        columns.append(processes.whole(places[number], covariance(parameters), least))
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
    covariance, places = process_places(model, effect)
    number, start = AXES.index(str(entry.axis)), linear.W.shape[1]
    options, columns, least = [], [], processes.WHOLE / float(entry.scales[member.scale]) ** 2
    for one in entry.options:
        columns.append(processes.whole(places[number], covariance(one.parameters), least))
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
