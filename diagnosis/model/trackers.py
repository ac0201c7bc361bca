"""Errors of one of several star trackers in the linear model of a recording: listed ones, and rivals that are on no list.

What one tracker errs by is seen against the gyro and against the other trackers; only the latter shows an error that lasts.
Rivals act about each axis of each tracker: of any course in time, other in each interval, running with the time since its start
or with mission time, following a rate, at harmonics of the orbit, with a step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import processes
from diagnosis.model.linear import Parameters
from diagnosis.model.periods import make_columns
from diagnosis.model.places import Place
from diagnosis.model.recording import RecordingModel
from simulator.effects.base import Effect, ProcessTimes, Trackers
from simulator.effects.common import harmonic, markov
from simulator.effects.tracker.base import TrackerEffect

Array = NDArray[np.float64]

ACROSS = 2  # axes across the boresight, on which an error in the field of view acts
WARM_UP = (600.0, 1800.0)  # s
STEPS = 5  # times of a step in each interval
HARMONICS = (1, 2, 3)
SLOW = (20.0, 6.0)  # of the longest interval: time constants of rivals that wander


@dataclass(frozen=True)
class TrackerError:
    """An error of one tracker.

    Attributes
    ----------
    name : of the effect, or what the rival does in words
    tracker : its name
    columns : per option, (N, k) whitened columns
    parameters, weights : per option
    process : whether it is a random process
    """

    name: str
    tracker: str
    columns: list[Array]
    parameters: list[Parameters]
    weights: Array
    process: bool


def listed(model: RecordingModel, effect: Effect) -> Iterator[TrackerError]:
    """One effect, on each tracker that it may act on."""
    seen = model.references.trackers
    if seen is None or not isinstance(effect, TrackerEffect) or not (effect.has_columns or effect.is_process):
        return
    trials = effect.trials(model.around)
    parameters, weights = [dict(trial.parameters) for trial in trials], np.array([trial.weight for trial in trials])
    for name in effect.trackers(seen):
        if effect.has_columns:
            columns = [make_columns(model, effect, name, trial.parameters) for trial in trials]
        else:
            number = seen.names.index(name)
            at, own = _times(model, seen, number)
            if not own.size:
                continue
            units = [_unit(model, number, axis, own) for axis in range(ACROSS)]
            places = [Place.of(unit, unit.T @ model.projected(unit)) for unit in units]
            columns = [_of_process(places, effect.covariance(at, trial.parameters)) for trial in trials]
        yield TrackerError(effect.name, name, columns, parameters, weights, effect.is_process)


def unlisted(model: RecordingModel) -> Iterator[TrackerError]:
    """The rivals of every tracker."""
    seen = model.references.trackers
    for number, name in enumerate(() if seen is None else seen.names):
        assert seen is not None
        at, own = _times(model, seen, number)
        if own.size < 2:
            continue
        longest = max(float(np.ptp(at.t_s[at.interval == k])) for k in np.unique(at.interval))
        apart = processes.same(at.interval)
        wander = [apart * markov(at.t_s, max(longest, 1.0) / part) for part in SLOW]
        for axis in range(3):
            unit = _unit(model, number, axis, own)
            place = Place.of(unit, unit.T @ model.projected(unit))
            for words, covariances in (
                ("errors of a star tracker correlate in time", wander),
                ("a star tracker is turned differently in each interval", [apart]),
            ):
                columns = [processes.usual(place, K) for K in covariances]
                yield _rival(words, name, columns, True)
            for words, values in _families(model, seen, number, axis, own, at):
                yield _rival(words, name, [unit @ part for part in values], False)


def _rival(words: str, name: str, columns: list[Array], process: bool) -> TrackerError:
    return TrackerError(words, name, columns, [{} for _ in columns], np.full(len(columns), 1 / len(columns)), process)


def _families(
    model: RecordingModel, seen: Trackers, number: int, axis: int, own: NDArray[np.intp], at: ProcessTimes
) -> Iterator[tuple[str, list[Array]]]:
    """Courses (own, k) of an error, of a root mean square of one."""
    first = model.reference_rows_of_observations[own]
    begin = np.array([model.t_s[block.steps.start] for block in model.blocks])
    since, t = (at.t_s - begin[at.interval])[:, None], at.t_s[:, None]
    w = np.einsum("mij,mj->mi", seen.to_axes[first], seen.rates[first])
    yield "a star tracker's error runs with the time since an interval's start", [
        _scaled(since), *(_scaled(np.exp(-since / tau)) for tau in WARM_UP)
    ]  # fmt: skip
    yield "a star tracker's error runs with mission time", [_scaled(t - t.mean()), _scaled((t - t.mean()) ** 2)]
    yield "a star tracker's error follows a rate", [_scaled(f(w[:, [k]])) for k in range(3) for f in (np.asarray, np.abs)]
    if np.isfinite(model.references.orbit_period_s):
        waves = [harmonic(at.t_s, model.references.orbit_period_s / k) for k in HARMONICS]
        yield "a star tracker's error repeats with the orbit", [_scaled(wave) for wave in waves]
    edges = [at.t_s[at.interval == k] for k in np.unique(at.interval)]
    times = np.concatenate([np.linspace(one[0], one[-1], STEPS + 2)[1:-1] for one in edges])
    yield "a star tracker turns at a time", [_scaled((t > time).astype(float)) for time in times]


def _scaled(values: Array) -> Array:
    size = float(np.sqrt(np.mean(values**2)))
    return values / size if size > 0 else values


def _times(model: RecordingModel, seen: Trackers, number: int) -> tuple[ProcessTimes, NDArray[np.intp]]:
    """Times and paths of a tracker's observations, and which these are among all."""
    first = model.reference_rows_of_observations
    own = np.flatnonzero(seen.sensor[first] == number)
    every = processes.reference_times(model)
    path = seen.path[first[own]]
    return ProcessTimes(every.t_s[own], every.run_s[own], every.interval[own], path), own


def _unit(model: RecordingModel, number: int, axis: int, own: NDArray[np.intp]) -> Array:
    """(N, own) whitened observations of a unit error about one of a tracker's axes at each of its observations."""
    along = model.recording.attitudes.sensors[number].M[axis]  # in body axes
    return np.asarray(sum(model.reference_columns[k][:, own] * along[k] for k in range(3)))


def _of_process(places: list[Place], K: Array) -> Array:
    """Columns of a process about several axes, of one size and independent."""
    return np.hstack([processes.whole(place, K) for place in places])
