"""A random process beside what else is thought to be there: with finer time constants, or with all that can be seen of it.

The first search gives a process the columns in which it usually shows, at the options of its group; where it is likely it is
asked again as a whole.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import processes
from diagnosis.model.groups import AXES, list_process_places
from diagnosis.model.linear import Candidate, LinearModel, ParameterChoice, Parameters, SelectedCandidate, refine_scales
from diagnosis.model.recording_model import RecordingModel
from simulator.effects.base import Effect

Array = NDArray[np.float64]


def add_finer_process(model: RecordingModel, linear: LinearModel, member: SelectedCandidate, effect: Effect) -> LinearModel:
    """The linear model with a random process as a whole at the option where a member is held, and at those beside it.

    Between them, halfway in log between its parameter and its neighbours', are further ones that share its prior; an effect
    whose options differ in more than one number, or not in numbers, has no neighbours. Between the scale at which it is held
    and its neighbours are further ones, too: what a variance that is off by half leaves of hundreds of amplitudes would be
    another effect.
    """
    entry, held = linear.candidate(member), linear.option(member)
    beside = _find_neighbour_options(entry, held)
    weight = held.log_weight - float(np.log(1 + len(beside)))
    halfway = [_interpolate_parameter(held.parameters, entry.options[one].parameters) for one in beside]
    wanted = {member.option: replace(held, log_weight=weight), **{one: entry.options[one] for one in beside}}
    further = (replace(held, log_weight=weight, parameters=parameters) for parameters in halfway)
    wanted |= dict(enumerate(further, len(entry.options)))
    return _build_whole_options(model, linear, member, effect, wanted, refine_scales(entry.scales, member.scale))


def _build_whole_options(
    model: RecordingModel,
    linear: LinearModel,
    member: SelectedCandidate,
    effect: Effect,
    wanted: Mapping[int, ParameterChoice],
    scales: Array,
) -> LinearModel:
    """The linear model with all columns that can be seen at a member's scale at some options of it, by their numbers."""
    covariance, places = list_process_places(model, effect)
    place = places[AXES.index(str(linear.candidate(member).axis))]
    options, columns, start = dict(enumerate(linear.candidate(member).options)), [], linear.W.shape[1]
    for number, one in wanted.items():
        columns.append(
            processes.build_all_columns(place, covariance(one.parameters), processes.WHOLE / linear.scale(member) ** 2)
        )
        options[number] = replace(one, start=start, count=columns[-1].shape[1])
        start += columns[-1].shape[1]
    W = np.hstack(columns)
    return linear.replace_options(member.candidate, list(options.values()), W, model.project_out_nuisance(W), scales)


def _find_neighbour_options(entry: Candidate, held: ParameterChoice) -> list[int]:
    """Options whose one parameter is next to that of an option, below and above it."""
    if len(held.parameters) != 1 or any(isinstance(value, str) for value in held.parameters.values()):
        return []
    (name,) = held.parameters
    order = sorted(range(len(entry.options)), key=lambda one: float(entry.options[one].parameters[name]))
    place = next(k for k, one in enumerate(order) if entry.options[one] is held)
    return [order[k] for k in (place - 1, place + 1) if 0 <= k < len(order)]


def _interpolate_parameter(one: Parameters, other: Parameters) -> Parameters:
    """The parameter halfway in log between two."""
    ((name, low),), ((_, high),) = one.items(), other.items()
    return {name: float(np.sqrt(float(low) * float(high)))}
