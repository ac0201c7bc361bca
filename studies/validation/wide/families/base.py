"""What the unlisted effects share: a family is a function with a sentence of physics, declared by its stage's decorator.

    @rate("deg/h")
    def warm_up(look: Look) -> Array:
        "The bias relaxes after power-on …"
        return np.exp(-look.since_start / look.between(0.05, 0.5))

The function's name is the effect's, its first sentence the summary. A law gets a `Look`: the samples, the axis and three
numbers that are drawn for a case, a phase, a share of one and a pace of one, from which time constants follow. It returns what
is added per unit of the size, or, at the stages that change samples or their timing, what comes out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import lfilter

from simulator.effects import Effect, Parameter, References, Setting, Stream, Surroundings
from simulator.effects.base import Array, Value
from simulator.effects.common import DEG, DEG_H, PHASE, PPM, index, number
from simulator.effects.housekeeping import COLUMN
from simulator.truth.integration import accumulate
from simulator.truth.rotation import matrix, separation

UNITS = {
    "deg/h": (DEG_H, (1e-7, 1e6)),
    "deg/s": (DEG, (1e-10, 1e2)),
    "deg": (DEG, (1e-7, 1e2)),
    "ppm": (PPM, (1e-3, 5e5)),
    "s": (1.0, (1e-8, 1e3)),
    "share": (1.0, (1e-7, 0.95)),
}
"""What a unit is in rad, rad/s or s, and which sizes are plausible."""

TURNS_DEG_S = 1e-3  # a body that nowhere turns faster does not turn
DENSE_RAD = 0.5  # between two references, up to which their difference is the rate


def _any_share(rng: np.random.Generator, around: Surroundings) -> Value:
    return float(rng.random())


NUMBERS = (
    PHASE,
    Parameter("share", "", 0.5, "of one, what the family makes of it", 0.0, 1.0, draw=_any_share),
    Parameter("pace", "", 0.5, "of one, how slow it is", 0.0, 1.0, draw=_any_share),
)


@dataclass(frozen=True)
class Drawn:
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
class Look(Drawn):
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
        """What a law gives for each interval by itself, joined."""
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
        return self.each(lambda p: matrix(accumulate(begin, self.w[p] * self.stream.duration_s[p, None])[1:]))

    @cached_property
    def temperature(self) -> Array:
        """(n,) of the gyro, K above its mean."""
        found = self.stream.housekeeping[COLUMN]
        return np.asarray(found - found.mean())

    def smooth(self, values: Array, time_s: float) -> Array:
        """Values (n,) behind a first-order low-pass, which starts settled in each interval."""
        a = float(np.exp(-self.sample_s / time_s))
        return self.each(lambda p: lfilter([1 - a], [1, -a], values[p], zi=[a * values[p.start]])[0])


@dataclass(frozen=True)
class View(Drawn):
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
        return matrix(self.references.quaternions)

    @cached_property
    def rates(self) -> Array:
        """(m, 3) body rate from one reference to the next, rad/s; the last of an interval has that before."""
        return reference_rates(self.references)

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


def reference_rates(references: References) -> Array:
    """(m, 3) rate from each reference to the next of its interval, rad/s."""
    q, t, interval = references.quaternions, references.t_s, references.interval
    turns = -separation(q[:-1], q[1:]) / np.diff(t)[:, None]
    rates = np.vstack([turns, turns[-1:]])
    last = np.flatnonzero(np.append(np.diff(interval) != 0, True))
    rates[last] = rates[np.maximum(last - 1, 0)]
    return rates


Needs = tuple[str, ...]


@dataclass(frozen=True)
class Family(Effect):
    """An unlisted effect; `law` is its physics, `needs` what a recording must have: orbit, temperature, turns, dense."""

    law: Callable[..., Array] = field(default=np.zeros, compare=False)
    needs: Needs = ()

    def look(
        self, stream: Stream, axis: str | None, parameters: Mapping[str, Value], rng: np.random.Generator | None = None
    ) -> Look:
        """The samples for the law; without a source of randomness the numbers are one."""
        return Look(*_numbers(axis, parameters, rng), stream)

    def missing(self, around: Surroundings) -> str | None:
        """What of its needs a recording lacks."""
        stream, references = around.stream, around.references
        gaps = np.diff(references.t_s)[np.diff(references.interval) == 0]
        lacks = {
            "orbit": not np.isfinite(stream.orbit_period_s),
            "temperature": COLUMN not in stream.housekeeping,
            "turns": np.abs(stream.rates).max() < TURNS_DEG_S * DEG,
            "dense": gaps.size == 0 or float(gaps.max() * np.linalg.norm(stream.rates, axis=1).max()) > DENSE_RAD,
        }
        return next((f"the recording has no {need}" for need in self.needs if lacks[need]), None)

    @property
    def factor(self) -> float:
        """Of its unit, in rad, rad/s or s."""
        return UNITS[self.unit][0]


def _numbers(
    axis: str | None, parameters: Mapping[str, Value], rng: np.random.Generator | None
) -> tuple[int, float, float, float, np.random.Generator]:
    phase, share, pace = (number(parameters, name) for name in ("phase_deg", "share", "pace"))
    seed = [int(1e6 * (phase + 360)), int(1e9 * share), int(1e9 * pace)]
    return index(axis), float(np.deg2rad(phase)), share, pace, rng or np.random.default_rng(seed)


class _Rate(Family):
    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        return self.factor * _three(self.law(self.look(stream, axis, parameters)), index(axis))[:, :, None]


class _RandomRate(Family):
    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        look = self.look(stream, setting.axis, setting.parameters, rng)
        return self.factor * setting.size * _three(self.law(look), look.k)


class _Timing(Family):
    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        if setting.size == 0:
            return raw
        return self.law(self.look(stream, setting.axis, setting.parameters), raw, self.factor * setting.size)


class _Samples(Family):
    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        if setting.size == 0:
            return samples
        return self.law(self.look(stream, setting.axis, setting.parameters, rng), samples, self.factor * setting.size)


class _Reference(Family):
    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        view = View(*_numbers(axis, parameters, None), references)
        return self.factor * _three(self.law(view), view.k)[:, :, None]


class _RandomReference(Family):
    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        view = View(*_numbers(setting.axis, setting.parameters, rng), references)
        return self.factor * setting.size * _three(self.law(view), view.k)


def _three(values: Array, k: int) -> Array:
    """Values on one axis, unless they are on all already; (n, 3)."""
    if values.ndim == 2:
        return values
    out = np.zeros((len(values), 3))
    out[:, k] = values
    return out


Declared = Callable[[Callable[..., Array]], Family]


def _declared(kind: type[Family], stage: str, unit: str, needs: Needs, **more: Any) -> Declared:
    def declare(law: Callable[..., Array]) -> Family:
        text = " ".join((law.__doc__ or "").split())
        name = "wide_" + law.__name__
        values: dict[str, Any] = {
            "name": name,
            "summary": text.partition(". ")[0].rstrip("."),
            "meaning": text,
            "unit": unit,
            "stage": stage,
        }
        assert set(more) <= {one.name for one in fields(kind)}
        return kind(**values, prior=UNITS[unit][1], parameters=NUMBERS, law=law, needs=needs, **more)

    return declare


def rate(unit: str, *needs: str, **more: Any) -> Declared:
    """An error of the rate that is fixed by its numbers: law(look) → (n,) about the axis, or (n, 3)."""
    return _declared(_Rate, "rate", unit, needs, **more)


def random_rate(unit: str, *needs: str, **more: Any) -> Declared:
    """A random error of the rate: law(look) → (n,) or (n, 3)."""
    return _declared(_RandomRate, "random_rate", unit, needs, **more)


def timing(stage: str, unit: str, *needs: str, **more: Any) -> Declared:
    """A fault in the samples' timing: law(look, raw, size) → (n, 3)."""
    return _declared(_Timing, stage, unit, needs, **more)


def samples(stage: str, unit: str, *needs: str, **more: Any) -> Declared:
    """A change of the samples: law(look, samples, size) → (n, 3)."""
    return _declared(_Samples, stage, unit, needs, **more)


def reference(unit: str, *needs: str, **more: Any) -> Declared:
    """An error of the references that is fixed by its numbers: law(view) → (m,) about the axis, or (m, 3)."""
    return _declared(_Reference, "reference", unit, needs, **more)


def random_reference(unit: str, *needs: str, **more: Any) -> Declared:
    """A random error of the references: law(view) → (m,) or (m, 3)."""
    return _declared(_RandomReference, "random_reference", unit, needs, **more)


def families(names: Mapping[str, object]) -> list[Family]:
    """The families that a module declares, from its ``globals()``."""
    return [one for one in names.values() if isinstance(one, Family)]


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
