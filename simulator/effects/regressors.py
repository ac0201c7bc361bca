"""Regressors: known quantities that an error of the gyro, or of the references, may follow.

A draft of a diagnosis (`diagnosis.draft`) is a tabulated function of one regressor. The file it is written to computes the
regressor by this module, so that a simulation and a diagnosis use the same definition.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.errors import InputError
from simulator.effects.base import AXIS_NAMES, Array, References, Stream
from simulator.effects.common import DAY, HOUR

SLEW_RATE_SHARE = 0.1  # of the largest rate, above which the body slews


@dataclass(frozen=True)
class Regressor:
    """A known quantity."""

    name: str  # as in the name of a draft
    unit: str  # of its values
    words: str  # for people, such as "the rate about x"
    compute: Callable[[], Array]  # returns its values at each sample or reference, (n,)


def list_regressors(seen: Stream | References) -> dict[str, Regressor]:
    """List the regressors of gyro samples, or of references, by name."""
    found = _list_stream_regressors(seen) if isinstance(seen, Stream) else _list_reference_regressors(seen)
    return {one.name: one for one in found}


def compute_regressor(seen: Stream | References, name: str) -> Array:
    """Compute one regressor at each sample or reference, (n,); an `InputError` where the recording does not have it."""
    known = list_regressors(seen)
    if name not in known:
        raise InputError(f"the recording has no {name}; there are {', '.join(known)}")
    return known[name].compute()


def tabulate(values: Array, knots: Array, table: Array) -> Array:
    """Interpolate a table (k, c) over knots (k,) linearly at some values, constant beyond them; (n,) → (n, c)."""
    return np.column_stack([np.interp(values, knots, column) for column in np.asarray(table, dtype=float).T])


def _list_stream_regressors(stream: Stream) -> Iterator[Regressor]:
    w = np.rad2deg(stream.rates)
    for k, axis in enumerate(AXIS_NAMES):
        words = f"the angular acceleration about {axis}", f"the angle turned about {axis} in the interval"
        yield Regressor(f"rate_{axis}", "deg/s", f"the rate about {axis}", partial(np.asarray, w[:, k]))
        yield Regressor(f"acceleration_{axis}", "deg/s²", words[0], partial(_differentiate_rate, stream, w[:, k]))
        yield Regressor(f"turned_{axis}", "deg", words[1], partial(_integrate_turn, stream, w[:, k]))
    yield Regressor("speed", "deg/s", "the size of the rate", lambda: np.linalg.norm(w, axis=1))
    yield Regressor(
        "since_start",
        "s",
        "the time since the start of the interval",
        partial(_apply_by_interval, stream, lambda p: stream.t_s[p] - stream.t_s[p.start]),
    )
    yield Regressor("since_slew", "s", "the time since the last slew", lambda: _compute_time_since_slew(stream))
    yield Regressor("mission", "h", "the time since the start", lambda: (stream.t_s - stream.span_s[0]) / HOUR)
    yield from _list_orbit_regressors(stream.t_s, stream.orbit_period_s)
    for name, values in stream.housekeeping.items():
        yield Regressor(name, "as recorded", f"the housekeeping column {name}", partial(np.asarray, values))
        changes = partial(_differentiate_rate, stream, HOUR * values)
        said = f"the rate of change of the housekeeping column {name}"
        yield Regressor(f"change_of_{name}", "as recorded, per hour", said, changes)


def _list_reference_regressors(references: References) -> Iterator[Regressor]:
    t_s = references.t_s
    yield Regressor(
        "since_start", "s", "the time since the start of the interval", lambda: _compute_time_since_start(references)
    )
    yield Regressor("mission", "h", "the time since the start", lambda: (t_s - t_s.min()) / HOUR)
    for k, axis in enumerate(AXIS_NAMES):
        words = f"the angle turned about {axis} in the interval"
        yield Regressor(f"turned_{axis}", "deg", words, partial(_compute_reference_turn, references, k))
    yield from _list_orbit_regressors(t_s, references.orbit_period_s)


def _list_orbit_regressors(t_s: Array, period_s: float) -> Iterator[Regressor]:
    # Beyond a day's orbit no phase repeats in a recording.
    if np.isfinite(period_s) and period_s < DAY:
        yield Regressor("orbit_phase", "deg", "the phase of the orbit", lambda: 360.0 * np.mod(t_s / period_s, 1.0))


def _apply_by_interval(stream: Stream, law: Callable[[slice], Array]) -> Array:
    out = np.zeros(stream.t_s.size)
    for part in stream.intervals:
        out[part] = law(part)
    return out


def _differentiate_rate(stream: Stream, values: Array) -> Array:
    """(n,) time derivative inside the intervals, per second."""
    return _apply_by_interval(
        stream, lambda p: np.gradient(values[p], stream.t_s[p]) if p.stop - p.start > 1 else 0 * values[p]
    )


def _integrate_turn(stream: Stream, rate: Array) -> Array:
    return _apply_by_interval(stream, lambda p: np.cumsum(rate[p] * stream.duration_s[p]))


def _compute_time_since_slew(stream: Stream) -> Array:
    """(n,) time since the rate was last that of a slew, or since the start of the interval, s."""
    speed = np.linalg.norm(stream.rates, axis=1)
    fast = speed > SLEW_RATE_SHARE * speed.max(initial=0.0)

    def compute_since(part: slice) -> Array:
        t_s = stream.t_s[part]
        last = np.maximum.accumulate(np.where(fast[part], np.arange(t_s.size), 0))
        return t_s - t_s[last]

    return _apply_by_interval(stream, compute_since)


def _compute_time_since_start(references: References) -> Array:
    out = np.zeros(references.t_s.size)
    for number in np.unique(references.interval):
        own = references.interval == number
        out[own] = references.t_s[own] - references.t_s[own].min()
    return out


def _compute_reference_turn(references: References, axis: int) -> Array:
    """(m,) component of the rotation vector from the first reference of the interval along a body axis, deg."""
    out = np.zeros((references.t_s.size, 3))
    for number in np.unique(references.interval):
        own = np.flatnonzero(references.interval == number)
        turns = Rotation.from_quat(references.quaternions[own])  # body axes seen from inertial ones are its inverse
        out[own] = np.rad2deg((turns[int(np.argmin(references.t_s[own]))].inv() * turns).as_rotvec())
    return np.asarray(out[:, axis])
