"""Unlisted rivals whose error follows what is around the gyro, or what it went through before.

A random process explains anything that is slow. Before one is named, what acts on gyros by physics has to have had its chance:

- *directions*: sunlight and magnetic fields come from directions that are fixed inertially, or turn with the orbit. An error
  about body axis i that follows the component of such a direction along body axis k is a_jk(t) of the attitude matrix A times
  amplitudes for the inertial axes j; times cos nu and sin nu of the orbit angle u for directions that turn with it (the field
  of a dipole has n = 2 and a constant part);
- *temperatures*: besides themselves, which a listed effect has, their rate of change, their square, and what lags behind them;
  and scale factors and misalignments that follow them;
- *the past*: hysteresis keeps the sign of the last turn, or of the last change of the rate, and what a slew has heated or
  charged decays after it, so that an error follows the rate, or its size, through a low-pass filter.

References have star catalogues, aberration and temperatures of their own, signals that come by two ways (an error of twice the
heading), and mounts that bend, settle after a slew and have play.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.signal
from numpy.typing import NDArray

from diagnosis.model.bins import Bins, Family, on_references, several
from diagnosis.model.in_progress import bins_at_references, steps_at_references
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]

LARGE = 0.1  # of the largest rate, or change of it, from which on its sign is kept
MEMORY = (30.0, 100.0, 300.0, 1000.0)  # s, after which what a slew has done decays
LAGS = (300.0, 1000.0, 3000.0)  # s, by which something follows a temperature


def families(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    """All of them, about each axis."""
    yield from _directions(model, bins)
    yield from _temperatures(model, bins)
    yield from _past(model, bins)
    yield from _of_references(model, bins)


# ---- directions ----------------------------------------------------------------------------------------------------------


def _directions(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    A = (bins.turned / bins.dt[:, None, None]).transpose(0, 2, 1)
    name = "bias follows the direction to something in inertial space"
    yield from several(model, bins, name, [A[:, axis] for axis in range(3)])
    orbit = model.stream.orbit_period_s
    if np.isfinite(orbit):
        name = "bias follows a direction that turns with the orbit"
        yield from several(model, bins, name, [_turning(A[:, axis], bins.t_s, orbit, n) for axis in range(3) for n in (1, 2)])


def second_harmonics(components: Array) -> Array:
    """(n, 5) of what is even in a direction (n, 3), such as twice a heading: its products without their trace."""
    x, y, z = components.T
    return np.column_stack([x * y, x * z, y * z, x**2 - y**2, 2 * z**2 - x**2 - y**2])


def _turning(components: Array, t_s: Array, orbit: float, order: int) -> Array:
    """(n, 6 or 9) components (n, 3) of inertial axes along a body axis, of directions at a multiple of the orbit's rate."""
    angle = 2 * np.pi / orbit * order * t_s[:, None]
    waves = [components * np.cos(angle), components * np.sin(angle)]
    return np.hstack(waves if order == 1 else [components, *waves])


# ---- temperatures --------------------------------------------------------------------------------------------------------


def _temperatures(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    rates, errors = [], []
    for values in model.stream.housekeeping.values():
        known = np.interp(bins.t_s, model.t_s, values)
        centred = (known - known.mean())[:, None]
        if not centred.any():
            continue
        lagging = [centred - _low_pass(centred, bins, lag) for lag in LAGS]
        errors += [_changes(centred, bins), centred**2, *lagging]
        rates += [centred * bins.rates[:, [k]] for k in range(3)]
    kept = [one for one in errors if np.isfinite(one).all() and one.any()]
    if kept:
        yield from several(model, bins, "bias follows a housekeeping value's change, its square or what lags behind it", kept)
        yield from several(model, bins, "scale factor or misalignment follows a housekeeping value", rates)


def _changes(values: Array, bins: Bins) -> Array:
    """(n, 1) time derivative inside the intervals."""
    out = np.zeros_like(values)
    for number in np.unique(bins.interval):
        own = bins.interval == number
        if own.sum() > 1:
            out[own, 0] = np.gradient(values[own, 0], bins.t_s[own])
    return out


# ---- the past ------------------------------------------------------------------------------------------------------------


def _past(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    signs = [_last_sign(values[:, axis], bins) for values in (bins.rates, bins.acceleration) for axis in range(3)]
    kept = [one for one in signs if np.ptp(one) > 0]
    if kept:
        yield from several(model, bins, "bias keeps the sign of the last turn, or of the last change of a rate", kept)
    options = []
    for memory in MEMORY:
        slow = np.column_stack([_low_pass(bins.rates, bins, memory), _low_pass(np.abs(bins.rates), bins, memory)])
        options += [slow[:, [k]] for k in range(6) if slow[:, k].any()]
    if options:
        yield from several(model, bins, "bias follows the rates of the past", options)


def _last_sign(values: Array, bins: Bins) -> Array:
    """(n, 1) sign of the last of values (n,) that is large; zero before the first one of each interval."""
    large = np.abs(values) > LARGE * np.abs(values).max(initial=0.0)
    begins = np.diff(bins.interval, prepend=-1) != 0
    last = np.maximum.accumulate(np.where(large | begins, np.arange(values.size), 0))
    return np.where(large[last], np.sign(values[last]), 0.0)[:, None]


def _low_pass(values: Array, bins: Bins, memory: float) -> Array:
    """(n, k) values through a first-order filter that is at rest when each interval begins."""
    out = np.zeros_like(values)
    for number in np.unique(bins.interval):
        own = np.flatnonzero(bins.interval == number)
        share = 1 - np.exp(-float(np.median(bins.dt[own])) / memory)
        out[own] = scipy.signal.lfilter([share], [1, share - 1], values[own], axis=0)
    return out


# ---- references ----------------------------------------------------------------------------------------------------------


def _of_references(model: RecordingModel, bins: Bins) -> Iterator[Family]:
    """Errors about each body axis: of what is seen in a direction, of a temperature, of a mount that bends or has play."""
    A = model.at_reference.transpose(0, 2, 1)
    t_s, orbit = model.references.t_s, model.stream.orbit_period_s
    directions = [A[:, axis] for axis in range(3)]
    directions += [second_harmonics(A[:, axis]) for axis in range(3)]
    if np.isfinite(orbit):  # as the velocity, whose aberration it is
        directions += [_turning(A[:, axis], t_s, orbit, 1) for axis in range(3)]
    place = steps_at_references(model)
    known = [(values - values.mean())[place, None] for values in model.stream.housekeeping.values()]
    now = bins_at_references(model, bins)
    loads = [one[now] for axis in range(3) for one in (_last_sign(bins.rates[:, axis], bins), bins.acceleration[:, [axis]])]
    past = [_low_pass(rates, bins, memory)[now] for memory in MEMORY for rates in (bins.rates, np.abs(bins.rates))]
    for name, options in (
        ("references follow a direction", directions),
        ("references follow a housekeeping value", known),
        ("references follow the torque or the sign of the last turn", loads),
        ("references follow the rates of the past", [one[:, [axis]] for one in past for axis in range(3)]),
    ):
        yield from on_references(model, name, [one for one in options if np.ptp(one, axis=0).any()])
