"""What a law sees: the samples or the references, an axis, and the numbers that are drawn for a case."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import lfilter

from simulator.effects import References, Stream
from simulator.effects.base import Array
from simulator.effects.housekeeping_columns import TEMPERATURE_COLUMN
from simulator.truth.integration import accumulate
from simulator.truth.rotation import convert_to_matrix, separation


@dataclass(frozen=True)
class LawNumbers:
    """The numbers of a case: axis, phase in rad, share and pace of one, and a source of randomness."""

    k: int
    phase: float
    share: float
    pace: float
    rng: np.random.Generator

    @property
    def other(self) -> int:
        """Another axis."""
        return (self.k + 1 + (self.share > 0.5)) % 3

    def scaled(self, low: float, high: float) -> float:
        """A number between two, by pace, uniform in its logarithm."""
        return float(low * (high / low) ** self.pace)

    def direction(self) -> Array:
        """A unit vector that the numbers fix, (3,)."""
        z, angle = 2 * self.share - 1, self.phase
        return np.array([*(np.sqrt(1 - z * z) * np.array([np.cos(angle), np.sin(angle)])), z])


@dataclass(frozen=True)
class Look(LawNumbers):
    """The samples as a law sees them."""

    stream: Stream

    @property
    def t(self) -> Array:
        """(n,) s since the epoch."""
        return self.stream.t_s

    @property
    def sample_s(self) -> float:
        """Length of a sample, s."""
        return float(np.median(self.stream.duration_s))

    @property
    def w(self) -> Array:
        """(n, 3) body rates, rad/s."""
        return self.stream.rates

    @property
    def own(self) -> Array:
        """(n,) rate about the axis, rad/s."""
        return self.w[:, self.k]

    @property
    def fastest(self) -> float:
        """Largest rate about any axis, rad/s."""
        return float(np.abs(self.w).max())

    @cached_property
    def length(self) -> float:
        """Median length of an interval, s."""
        return float(np.median([self.t[p.stop - 1] - self.t[p.start] + self.sample_s for p in self.stream.intervals]))

    def between(self, low: float, high: float) -> float:
        """A time between two shares of an interval, s, not below two samples."""
        return max(self.length * self.scaled(low, high), 2 * self.sample_s)

    def cycle(self, low: float = 0.05, high: float = 0.6) -> Array:
        """(n,) phase, rad, of something that repeats with such a period."""
        return 2 * np.pi * self.t / self.between(low, high) + self.phase

    def each(self, law: Callable[[slice], Array]) -> Array:
        """Join the values that a law gives for each interval by itself."""
        return np.concatenate([law(part) for part in self.stream.intervals])

    @cached_property
    def since_start(self) -> Array:
        """(n,) since the first sample of the interval, s."""
        return self.each(lambda p: self.t[p] - self.t[p.start])

    @cached_property
    def elapsed(self) -> Array:
        """(n,) from 0 at the first sample of all to 1 at the last."""
        return np.asarray((self.t - self.t[0]) / max(self.t[-1] - self.t[0], self.sample_s))

    @cached_property
    def acceleration(self) -> Array:
        """(n, 3) rad/s²."""
        return self.each(lambda p: np.gradient(self.w[p], self.sample_s, axis=0) if p.stop - p.start > 1 else 0 * self.w[p])

    @cached_property
    def turned(self) -> Array:
        """(n, 3) angle turned about each axis since the interval's start, rad."""
        return self.each(lambda p: np.cumsum(self.w[p] * self.stream.duration_s[p, None], axis=0))

    @cached_property
    def attitude(self) -> Array:
        """(n, 3, 3) attitude against that at the interval's start."""
        begin = np.array([0.0, 0.0, 0.0, 1.0])
        return self.each(lambda p: convert_to_matrix(accumulate(begin, self.w[p] * self.stream.duration_s[p, None])[1:]))

    @cached_property
    def temperature(self) -> Array:
        """(n,) of the gyro, K above its mean."""
        found = self.stream.housekeeping[TEMPERATURE_COLUMN]
        return np.asarray(found - found.mean())

    def smooth(self, values: Array, time_s: float) -> Array:
        """Values (n,) behind a first-order low-pass, which starts settled in each interval."""
        a = float(np.exp(-self.sample_s / time_s))
        return self.each(lambda p: lfilter([1 - a], [1, -a], values[p], zi=[a * values[p.start]])[0])


@dataclass(frozen=True)
class View(LawNumbers):
    """The references as a law sees them."""

    references: References

    @property
    def t(self) -> Array:
        """(m,) s since the epoch."""
        return self.references.t_s

    @cached_property
    def length(self) -> float:
        """Median time from the first to the last reference of an interval, s."""
        times = [self.t[self.references.interval == k] for k in np.unique(self.references.interval)]
        return float(max(np.median([t[-1] - t[0] for t in times]), 1e-3))

    def between(self, low: float, high: float) -> float:
        """A time between two shares of an interval, s."""
        return self.length * self.scaled(low, high)

    @cached_property
    def since_start(self) -> Array:
        """(m,) since the interval's first reference, s."""
        begin = {k: self.t[self.references.interval == k][0] for k in np.unique(self.references.interval)}
        return np.asarray(self.t - np.array([begin[k] for k in self.references.interval]))

    @cached_property
    def body(self) -> Array:
        """(m, 3, 3) attitude matrices."""
        return convert_to_matrix(self.references.quaternions)

    @cached_property
    def rates(self) -> Array:
        """(m, 3) body rate from one reference to the next, rad/s; the last of an interval has that before."""
        return compute_reference_rates(self.references)

    def episodes(self, share: float, length: float) -> Array:
        """(m,) bool, inside stretches of such a mean length, s, that take such a share of the time."""
        out, inside = np.zeros(len(self.t), bool), False
        for row, step in enumerate(np.diff(self.t, prepend=self.t[0])):
            away = 1 - np.exp(-step / length)
            inside = self.rng.random() > away if inside else self.rng.random() < away * share / (1 - share)
            out[row] = inside
        return out

    def on(self, values: Array) -> Array:
        """(m,) about the axis, (m, 3)."""
        out = np.zeros((len(values), 3))
        out[:, self.k] = values
        return out


def compute_reference_rates(references: References) -> Array:
    """(m, 3) rate from each reference to the next of its interval, rad/s."""
    q, t, interval = references.quaternions, references.t_s, references.interval
    turns = -separation(q[:-1], q[1:]) / np.diff(t)[:, None]
    rates = np.vstack([turns, turns[-1:]])
    last = np.flatnonzero(np.append(np.diff(interval) != 0, True))
    rates[last] = rates[np.maximum(last - 1, 0)]
    return rates


def delayed(look: Look, raw: Array, delay: Array) -> Array:
    """Raw rates as they were a delay (n,) or (n, 3), s, before, within each interval; linear between the samples, (n, 3)."""
    delays = np.broadcast_to(delay.reshape(len(delay), -1), raw.shape)
    out = raw.copy()
    for p in look.stream.intervals:
        for axis in range(3):
            out[p, axis] = np.interp(look.t[p] - delays[p, axis], look.t[p], raw[p, axis])
    return out


def changed(values: Array, k: int, column: Array) -> Array:
    """Samples with one axis replaced."""
    out = values.copy()
    out[:, k] = column
    return out
