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
from diagnosis.model.periods import make_columns
from diagnosis.model.process_projection import ProcessProjection
from diagnosis.model.recording_model import RecordingModel
from simulator.effects.base import Effect, ProcessTimes, Trackers
from simulator.effects.common import harmonic, markov
from simulator.effects.tracker.base import TrackerEffect

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class RivalSettings:
    """Assumed courses of rivals."""

    warm_up_s: tuple[float, ...] = (600.0, 1800.0)  # time constants after the start of an interval, s
    steps: int = 5  # times of a step in each interval
    harmonics: tuple[int, ...] = (1, 2, 3)  # of the orbit
    slow: tuple[float, ...] = (20.0, 6.0)  # of the longest interval, time constants of rivals that wander
    across: int = 2  # axes across the boresight, on which an error in the field of view acts


SETTINGS = RivalSettings()


def list_tracker_columns(model: RecordingModel, effect: Effect) -> Iterator[tuple[str, list[Array]]]:
    """List one effect on each tracker that it may act on: the tracker's name, and (N, k) whitened columns at each trial."""
    seen = model.references.trackers
    if seen is None or not isinstance(effect, TrackerEffect) or not (effect.has_columns or effect.is_process):
        return
    trials = effect.trials(model.surroundings)
    for name in effect.trackers(seen):
        if effect.has_columns:
            yield name, [make_columns(model, effect, name, trial.parameters) for trial in trials]
            continue
        number = seen.names.index(name)
        at, own = _find_times(model, seen, number)
        if own.size:
            places = [_build_place(model, number, axis, own) for axis in range(SETTINGS.across)]
            covariances = [effect.covariance(at, trial.parameters) for trial in trials]
            yield name, [np.hstack([processes.build_all_columns(place, K) for place in places]) for K in covariances]


def list_tracker_rivals(model: RecordingModel) -> Iterator[tuple[str, str, list[Array], bool]]:
    """List the rivals of every tracker: words, the tracker's name, whitened columns, and whether it is a random process."""
    seen = model.references.trackers
    for number, name in enumerate(() if seen is None else seen.names):
        assert seen is not None
        at, own = _find_times(model, seen, number)
        if own.size < 2:
            continue
        longest = max(float(np.ptp(at.t_s[at.interval == k])) for k in np.unique(at.interval))
        apart = processes.match_labels(at.interval)
        wander = [apart * markov(at.t_s, max(longest, 1.0) / part) for part in SETTINGS.slow]
        for axis in range(3):
            place = _build_place(model, number, axis, own)
            for words, covariances in (
                ("errors of a star tracker correlate in time", wander),
                ("a star tracker is turned differently in each interval", [apart]),
            ):
                yield words, name, [processes.build_usual_columns(place, K) for K in covariances], True
            for words, courses in _list_courses(model, seen, own, at):
                yield words, name, [place.columns @ _scale(course) for course in courses], False


def _list_courses(model: RecordingModel, seen: Trackers, own: Indices, at: ProcessTimes) -> Iterator[tuple[str, list[Array]]]:
    """List courses (own, k) of an error."""
    first = model.reference_rows_of_observations[own]
    begin = np.array([model.t_s[block.steps.start] for block in model.blocks])
    since, mission = (at.t_s - begin[at.interval])[:, None], (at.t_s - at.t_s.mean())[:, None]
    w = np.einsum("mij,mj->mi", seen.to_axes[first], seen.rates[first])
    yield "a star tracker's error runs with the time since an interval's start", [
        since, *(np.exp(-since / tau) for tau in SETTINGS.warm_up_s)
    ]  # fmt: skip
    yield "a star tracker's error runs with mission time", [mission, mission**2]
    yield "a star tracker's error follows a rate", [f(w[:, [k]]) for k in range(3) for f in (np.asarray, np.abs)]
    if np.isfinite(model.references.orbit_period_s):
        waves = [harmonic(at.t_s, model.references.orbit_period_s / k) for k in SETTINGS.harmonics]
        yield "a star tracker's error repeats with the orbit", waves
    edges = [at.t_s[at.interval == k] for k in np.unique(at.interval)]
    times = np.concatenate([np.linspace(one[0], one[-1], SETTINGS.steps + 2)[1:-1] for one in edges])
    yield "a star tracker turns at a time", [(at.t_s[:, None] > time).astype(float) for time in times]


def _scale(values: Array) -> Array:
    """Scale a course to a root mean square of one."""
    size = float(np.sqrt(np.mean(values**2)))
    return values / size if size > 0 else values


def _find_times(model: RecordingModel, seen: Trackers, number: int) -> tuple[ProcessTimes, Indices]:
    """Find times and paths of a tracker's observations, and which these are among all."""
    first = model.reference_rows_of_observations
    own = np.flatnonzero(seen.sensor[first] == number)
    every = processes.compute_reference_times(model)
    return ProcessTimes(every.t_s[own], every.run_s[own], every.interval[own], seen.path[first[own]]), own


def _build_place(model: RecordingModel, number: int, axis: int, own: Indices) -> ProcessProjection:
    """Build the place of errors about one of a tracker's axes at each of its observations."""
    along = model.recording.attitudes.sensors[number].M[axis]  # in body axes
    unit = np.asarray(sum(model.reference_columns[k][:, own] * along[k] for k in range(3)))
    return ProcessProjection.build_projection(unit, unit.T @ model.project_out_nuisance(unit))
