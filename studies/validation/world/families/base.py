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
from typing import Any

import numpy as np

from simulator.effects import Effect, Parameter, References, Setting, Stream, Surroundings
from simulator.effects.base import Array, Value
from simulator.effects.common import DEG, DEG_H, PHASE, PPM, index, number
from simulator.effects.housekeeping_columns import TEMPERATURE_COLUMN
from studies.validation.world.families.look import Look, View

SIZE_UNITS = {
    "deg/h": (DEG_H, (1e-7, 1e6)),
    "deg/s": (DEG, (1e-10, 1e2)),
    "deg": (DEG, (1e-7, 1e2)),
    "ppm": (PPM, (1e-3, 5e5)),
    "s": (1.0, (1e-8, 1e3)),
    "share": (1.0, (1e-7, 0.95)),
}
"""What a unit is in rad, rad/s or s, and which sizes are plausible."""

UNLISTED_PREFIX = "unlisted_"  # of the names, so that none is that of a listed effect
TURNS_DEG_S = 1e-3  # a body that nowhere turns faster does not turn
DENSE_RAD = 0.5  # between two references, up to which their difference is the rate


def _draw_share(rng: np.random.Generator, around: Surroundings) -> Value:
    return float(rng.random())


FAMILY_PARAMETERS = (
    PHASE,
    Parameter("share", "", 0.5, "of one, what the family makes of it", 0.0, 1.0, draw=_draw_share),
    Parameter("pace", "", 0.5, "of one, how slow it is", 0.0, 1.0, draw=_draw_share),
)


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
        return Look(*_read_numbers(axis, parameters, rng), stream)

    def missing(self, around: Surroundings) -> str | None:
        """Name the quantities that a recording lacks."""
        stream, references = around.stream, around.references
        gaps = np.diff(references.t_s)[np.diff(references.interval) == 0]
        lacks = {
            "orbit": not np.isfinite(stream.orbit_period_s),
            "temperature": TEMPERATURE_COLUMN not in stream.housekeeping,
            "turns": np.abs(stream.rates).max() < TURNS_DEG_S * DEG,
            "dense": gaps.size == 0 or float(gaps.max() * np.linalg.norm(stream.rates, axis=1).max()) > DENSE_RAD,
        }
        return next((f"the recording has no {need}" for need in self.needs if lacks[need]), None)

    @property
    def factor(self) -> float:
        """Factor from its unit to rad, rad/s or s."""
        return SIZE_UNITS[self.unit][0]


def _read_numbers(
    axis: str | None, parameters: Mapping[str, Value], rng: np.random.Generator | None
) -> tuple[int, float, float, float, np.random.Generator]:
    phase, share, pace = (number(parameters, name) for name in ("phase_deg", "share", "pace"))
    seed = [int(1e6 * (phase + 360)), int(1e9 * share), int(1e9 * pace)]
    return index(axis), float(np.deg2rad(phase)), share, pace, rng or np.random.default_rng(seed)


class _Rate(Family):
    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        return self.factor * _expand_to_axes(self.law(self.look(stream, axis, parameters)), index(axis))[:, :, None]


class _RandomRate(Family):
    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        look = self.look(stream, setting.axis, setting.parameters, rng)
        return self.factor * setting.size * _expand_to_axes(self.law(look), look.k)


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
        view = View(*_read_numbers(axis, parameters, None), references)
        return self.factor * _expand_to_axes(self.law(view), view.k)[:, :, None]


class _RandomReference(Family):
    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        view = View(*_read_numbers(setting.axis, setting.parameters, rng), references)
        return self.factor * setting.size * _expand_to_axes(self.law(view), view.k)


def _expand_to_axes(values: Array, k: int) -> Array:
    """Values on one axis, unless they are on all already; (n, 3)."""
    if values.ndim == 2:
        return values
    out = np.zeros((len(values), 3))
    out[:, k] = values
    return out


Declared = Callable[[Callable[..., Array]], Family]


def _make_decorator(kind: type[Family], stage: str, unit: str, needs: Needs, **more: Any) -> Declared:
    def declare(law: Callable[..., Array]) -> Family:
        text = " ".join((law.__doc__ or "").split())
        name = UNLISTED_PREFIX + law.__name__
        values: dict[str, Any] = {
            "name": name,
            "summary": text.partition(". ")[0].rstrip("."),
            "meaning": text,
            "unit": unit,
            "stage": stage,
        }
        assert set(more) <= {one.name for one in fields(kind)}
        return kind(**values, prior=SIZE_UNITS[unit][1], parameters=FAMILY_PARAMETERS, law=law, needs=needs, **more)

    return declare


def rate(unit: str, *needs: str, **more: Any) -> Declared:
    """An error of the rate that is fixed by its numbers: law(look) → (n,) about the axis, or (n, 3)."""
    return _make_decorator(_Rate, "rate", unit, needs, **more)


def random_rate(unit: str, *needs: str, **more: Any) -> Declared:
    """A random error of the rate: law(look) → (n,) or (n, 3)."""
    return _make_decorator(_RandomRate, "random_rate", unit, needs, **more)


def timing(stage: str, unit: str, *needs: str, **more: Any) -> Declared:
    """A fault in the samples' timing: law(look, raw, size) → (n, 3)."""
    return _make_decorator(_Timing, stage, unit, needs, **more)


def samples(stage: str, unit: str, *needs: str, **more: Any) -> Declared:
    """A change of the samples: law(look, samples, size) → (n, 3)."""
    return _make_decorator(_Samples, stage, unit, needs, **more)


def reference(unit: str, *needs: str, **more: Any) -> Declared:
    """An error of the references that is fixed by its numbers: law(view) → (m,) about the axis, or (m, 3)."""
    return _make_decorator(_Reference, "reference", unit, needs, **more)


def random_reference(unit: str, *needs: str, **more: Any) -> Declared:
    """A random error of the references: law(view) → (m,) or (m, 3)."""
    return _make_decorator(_RandomReference, "random_reference", unit, needs, **more)


def families(names: Mapping[str, object]) -> list[Family]:
    """The families that a module declares, from its ``globals()``."""
    return [one for one in names.values() if isinstance(one, Family)]
