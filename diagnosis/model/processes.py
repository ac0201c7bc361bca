"""Random processes as groups of columns, and those of them that are unlisted rivals.

A process of variance s² K over the cells, or over the references, is a group of columns with equal, independent amplitudes of
variance s² (`diagnosis.model.process_projection`). They are orthogonal, and those that cannot be seen are left out, so that a
process is a group like any other (`diagnosis.inference.evidence`).

Listed processes bring their own covariance (`simulator.effects.base.Effect.covariance`). Those without a name are Markov errors
of the rates, of the references and of the time tags, of several time constants, a level of its own in each interval, processes
that follow the rate, and references that are off by another angle in each interval.

The first search gives a process the columns in which it usually shows, at the options of its group. Where it is likely it is
tested again with finer time constants and with all that can be seen of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from diagnosis.arrays import AXES
from diagnosis.model.linear import (
    Candidate,
    CandidateColumns,
    LinearModel,
    ParameterChoice,
    Parameters,
    SelectedCandidate,
    build_rival,
    refine_scales,
)
from diagnosis.model.process_projection import LEAST_SHARE, ProcessProjection, select_nodes, split_cells
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices
from simulator.effects.base import Effect, ProcessTimes, Value
from simulator.effects.common import markov

SEEN = 1e-4  # power relative to the strongest column, below which a column is left out
INFORMATION = 0.95  # share of Σ λ² that the columns have together at least
# variance of a column beside that of the noise, from which on it counts where the whole process is wanted
WHOLE = 0.1
USUAL_COLUMNS = 72  # that are kept whatever they share
MOST_COLUMNS = 400  # a bound of the time
ROUNDING = 1e-13  # power relative to the strongest column, below which a column is rounding
ALIKE = 0.95  # share of the power of a process that lies in the span of steps, from which on it is one of them
BIAS_WANDERS = "random bias, correlated in time"
REFERENCES_WANDER = "references wander"
TAGS_WANDER = "time tags wander"


# Near the smallest size that can be detected, a column of power λ adds to the expected evidence in proportion to λ². A larger
# process of slow variations shows in its weaker columns too.


def compute_part_times(model: RecordingModel) -> ProcessTimes:
    """Compute the times of the parts of the cells, see `diagnosis.model.process_projection`."""
    first, cell = split_cells(model)
    last = np.append(first[1:], 0)
    last[np.append(cell[1:] - 1, first.size - 1)] = model.cells.last
    counts = np.diff(np.append(cell, first.size))
    t_s = 0.5 * (model.t_s[first] + model.t_s[last - 1])
    began = np.repeat(model.cells.run_s - model.cells.t_s, counts)
    return ProcessTimes(t_s=t_s, run_s=began + t_s, interval=np.repeat(model.cells.interval, counts))


def compute_node_times(model: RecordingModel) -> ProcessTimes:
    """Compute the times of the nodes, see `diagnosis.model.process_projection`; run_s leaves out the gaps between intervals."""
    rows, _ = select_nodes(model)
    t_s, interval = model.references.t_s[rows], model.interval_of_reference[rows]
    ends = np.cumsum([0.0, *(float(block.elapsed_s[-1]) for block in model.blocks)])
    begins = np.array([t_s[interval == number][0] for number in range(len(model.blocks))])
    return ProcessTimes(t_s=t_s, run_s=t_s - begins[interval] + ends[interval], interval=interval)


def build_usual_columns(place: ProcessProjection, K: Array, share: float = LEAST_SHARE) -> Array:
    """Compute the strongest columns (N, r) of a process of covariance K; see `build_all_columns`."""
    powers, columns = place.powers(K, share)
    selected = _select_powers(powers, SEEN * _find_largest_power(powers))[:MOST_COLUMNS]
    enough = int(np.searchsorted(np.cumsum(powers[selected] ** 2), INFORMATION * float(np.sum(powers**2)))) + 1
    return columns(selected[: max(enough, USUAL_COLUMNS)])


def build_all_columns(place: ProcessProjection, K: Array, least: float | None = None) -> Array:
    """Build all columns (N, r) of a process of covariance K whose power reaches `least`, the strongest first.

    By default all columns that can be seen beside the strongest. There is at least one, but none of a process that cannot be
    seen at all, such as a random walk over cells of one time.
    """
    powers, columns = place.powers(K, least=least or 0.0)
    selected = _select_powers(powers, SEEN * _find_largest_power(powers) if least is None else least)
    return columns(selected if selected.size else _select_powers(powers, 0.0)[:1])


def build_course_columns(place: ProcessProjection, values: Array) -> Array:
    """Build the columns (N, k) of a sum of k courses (q, k) with independent amplitudes, the strongest first."""
    averaged = values if place.mean is None else place.mean @ values
    powers, turned = np.linalg.eigh(averaged.T @ place.gram @ averaged)
    return np.asarray(place.columns @ (averaged @ turned[:, _select_powers(powers, SEEN * _find_largest_power(powers))]))


def _find_largest_power(powers: Array) -> float:
    return float(powers.max(initial=0.0))


def _select_powers(powers: Array, least: float) -> Indices:
    """Select the indices of powers beyond `least` and beyond rounding, the strongest first."""
    return np.flatnonzero(powers > max(least, ROUNDING * _find_largest_power(powers)))[::-1]


def list_process_alternatives(model: RecordingModel) -> Iterator[CandidateColumns]:
    """List random errors outside the library about each axis; those of the time tags have no axis.

    Their time constants end at a sixth of the longest interval: what takes longer is a shape.
    """
    times, nodes = compute_part_times(model), compute_node_times(model)
    first, _ = split_cells(model)
    longest = max(float(block.elapsed_s[-1]) for block in model.blocks)
    w = np.add.reduceat(model.rates * model.dt[:, None], first, axis=0) / np.add.reduceat(model.dt, first)[:, None]
    taus = (longest / 60, longest / 20, longest / 6)
    separate, indicators = np.equal.outer(times.interval, times.interval).astype(float), _build_indicators(times.interval)
    slow, offsets = separate * markov(times.t_s, taus[-1]), np.deg2rad(1.0) * _build_indicators(nodes.interval)
    same = np.equal.outer(nodes.interval, nodes.interval).astype(float)

    def wander(place: ProcessProjection) -> list[Array]:
        return [build_usual_columns(place, same * markov(nodes.t_s, tau)) for tau in taus]

    constants: list[Parameters] = [{"time_constant_s": tau} for tau in taus]
    for axis, name in enumerate(AXES):
        place, references = model.cell_places[axis], model.reference_places[axis]
        # One at a time: a covariance is tens of megabytes. What follows rates is as rough as they are.
        columns = [build_usual_columns(place, separate * markov(times.t_s, tau)) for tau in taus]
        yield build_rival(BIAS_WANDERS, name, columns, True, parameters=constants)
        yield build_rival(REFERENCES_WANDER, name, wander(references), True, parameters=constants)
        yield build_rival("bias differs between intervals", name, [build_course_columns(place, indicators)], True)
        gains = [build_course_columns(place, u[:, None] * indicators) for u in w.T]
        yield build_rival("scale factor or misalignment differs between intervals", name, gains, True)
        gains = [build_usual_columns(place, slow * np.outer(u, u), 0.0) for u in w.T]
        yield build_rival("scale factor or misalignment wanders", name, gains, True)
        columns = [build_course_columns(references, offsets)]
        yield build_rival("references offset differently in each interval", name, columns, True)
    yield build_rival(TAGS_WANDER, None, wander(model.tag_place), True, parameters=constants)


def _build_indicators(interval: Indices) -> Array:
    """Build indicators (q, n) of the intervals."""
    return np.equal.outer(interval, np.unique(interval)).astype(float)


def list_process_places(
    model: RecordingModel, effect: Effect
) -> tuple[Callable[[Mapping[str, Value]], Array], tuple[ProcessProjection, ...]]:
    """Return the covariance of a random process as a function of its parameters, and its projections about each axis."""
    times = compute_node_times(model) if effect.on_references else compute_part_times(model)
    return partial(effect.covariance, times), model.reference_places if effect.on_references else model.cell_places


def add_finer_process(model: RecordingModel, linear: LinearModel, member: SelectedCandidate, effect: Effect) -> LinearModel:
    """Add a random process with all its columns at a member's option, at the neighbours of it and halfway to them.

    The options halfway in log between its parameter and its neighbours' share its prior; an effect whose options differ in more
    than one number, or not in numbers, has no neighbours. Scales are added between its scale and the neighbours', too: with a
    variance wrong by half, the residual of hundreds of amplitudes would look like another effect.
    """
    entry, current = linear.candidate(member), linear.option(member)
    neighbours = _find_neighbour_options(entry, current)
    weight = current.log_weight - float(np.log(1 + len(neighbours)))
    wanted = {member.option: replace(current, log_weight=weight), **{option: entry.options[option] for option in neighbours}}
    for number, neighbour in enumerate(neighbours, len(entry.options)):
        ((name, low),), ((_, high),) = current.parameters.items(), entry.options[neighbour].parameters.items()
        halfway: Parameters = {name: float(np.sqrt(float(low) * float(high)))}
        wanted[number] = replace(current, log_weight=weight, parameters=halfway)
    covariance, places = list_process_places(model, effect)
    place = places[AXES.index(str(entry.axis))]
    options, columns, start = dict(enumerate(entry.options)), [], linear.W.shape[1]
    for number, option in wanted.items():
        columns.append(build_all_columns(place, covariance(option.parameters), WHOLE / linear.scale(member) ** 2))
        options[number] = replace(option, start=start, count=columns[-1].shape[1])
        start += columns[-1].shape[1]
    W, scales = np.hstack(columns), refine_scales(entry.scales, member.scale)
    return linear.replace_options(member.candidate, list(options.values()), W, model.project_out_nuisance(W), scales)


def _find_neighbour_options(entry: Candidate, current: ParameterChoice) -> list[int]:
    """Find the options whose one parameter is next to that of an option, below and above it."""
    if len(current.parameters) != 1 or any(isinstance(value, str) for value in current.parameters.values()):
        return []
    (name,) = current.parameters
    order = sorted(range(len(entry.options)), key=lambda number: float(entry.options[number].parameters[name]))
    place = next(k for k, number in enumerate(order) if entry.options[number] is current)
    return [order[k] for k in (place - 1, place + 1) if 0 <= k < len(order)]
