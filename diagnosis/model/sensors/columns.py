"""Columns of the listed sensor effects, and of discrepancies that are on no list, along one arc.

The column of an effect is the derivative of its error by an amplitude, which each effect gives exactly
(`simulator.effects.sensor.SensorEffect.error`). The unlisted rivals have amplitudes of any size that the recording could show:

- a smooth error of either angle of a sun sensor, a polynomial of third degree in (α, β), as from a transfer function that is
  not the assumed one;
- errors of the quadrants at one, two and three times the orbit's rate;
- errors of the Earth sensor near the Sun, by the angle from it and by whether it comes or goes;
- a rate error of the gyro at orbit rate or twice that, which is no matter of the sensors.

Sensors that sit differently each day, or drift through the months, are rivals too. Their columns are those of a listed
misalignment or of biases, taken day by day (`diagnosis.model.sensors.tables`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.linear import Parameters
from diagnosis.model.sensors.arcs import FittedArc
from simulator.effects.base import Value
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect, Sightings
from simulator.sensors.horizon import AZIMUTHS, Horizon

Array = NDArray[np.float64]

STEP = 1e-3  # of an amplitude, for the derivative of an effect's error
DEGREE = 3
HARMONICS = 3
GYRO_HARMONICS = 2
SUN_EDGES = np.deg2rad([0.0, 5.0, 7.0, 10.0, 15.0, 25.0, 40.0])  # angles from the Sun
SUN_SENSORS = (1, 2)
GYRO = "gyro rate at orbit harmonics"


@dataclass(frozen=True)
class Held:
    """Amplitudes (k,) of an effect about which its error is linearised, and its other parameters.

    Attributes
    ----------
    amplitudes, parameters : as `SensorEffect.error` takes them
    others : further parameters that are tried beside them, in place of the effect's own options
    """

    amplitudes: Array
    parameters: Mapping[str, Value]
    others: tuple[Mapping[str, Value], ...] = ()


@dataclass(frozen=True)
class Choice:
    """One option of a family: some neighbouring columns of it, with the parameters and the prior share that belong to them."""

    columns: slice
    parameters: Parameters
    weight: float


@dataclass(frozen=True)
class Family:
    """Columns of one candidate along an arc, and the options among them.

    Attributes
    ----------
    effect, axis : name of a listed effect and its axis; of a rival, what it does in words and None
    listed : whether it is an effect of the list
    columns : from an arc to (r, p) columns, in sigmas per unit of the amplitude
    choices : the options
    finding : signal and words for residuals that follow the columns, None where they are not tested by themselves
    """

    effect: str
    axis: str | None
    listed: bool
    columns: Callable[[FittedArc], Array]
    choices: tuple[Choice, ...]
    finding: tuple[str, str] | None = None

    @property
    def label(self) -> str:
        """effect:axis, or the name."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"

    @property
    def count(self) -> int:
        """Number of its columns."""
        return max(choice.columns.stop for choice in self.choices)


# ---- listed effects ------------------------------------------------------------------------------------------------------


def effect_of(label: str) -> tuple[SensorEffect, str | None]:
    """The effect of a label, and its axis."""
    name, _, axis = label.partition(":")
    return SENSOR_EFFECTS[name], axis or None


def listed_families(effects: Iterable[SensorEffect], about: Mapping[str, Held]) -> list[Family]:
    """The effects of the list, linearised about given amplitudes by label, or about zero."""
    return [_listed(effect, axis, about) for effect in effects for axis in effect.axes or (None,)]


def _listed(effect: SensorEffect, axis: str | None, about: Mapping[str, Held]) -> Family:
    label = effect.name if axis is None else f"{effect.name}:{axis}"
    at = about.get(label, Held(np.zeros(effect.count), {}))
    options, share = effect.options, 1.0
    if label in about and effect.refined:
        # Parameters that were found between the options are tried there only, with the prior share of one option.
        options, share = (at.parameters, *at.others), 1 / len(effect.options)
    held = [replace(at, parameters=option) for option in options]
    choices = [
        Choice(slice(k * effect.count, (k + 1) * effect.count), dict(option), share / len(options))
        for k, option in enumerate(options)
    ]
    return Family(
        effect.name, axis, True, partial(_listed_columns, effect=effect, axis=axis, held=held), tuple(choices), effect.finding
    )


def _listed_columns(fitted: FittedArc, effect: SensorEffect, axis: str | None, held: Sequence[Held]) -> Array:
    return np.hstack([_derivatives(fitted, effect, axis, one) for one in held])


def _derivatives(fitted: FittedArc, effect: SensorEffect, axis: str | None, held: Held) -> Array:
    """(r, k) derivatives of an effect's error by its amplitudes."""
    arc, columns = fitted.arc, []
    for step in STEP * np.eye(effect.count):
        high, low = (effect.error(arc.sightings, axis, held.amplitudes + way * step, held.parameters) for way in (1, -1))
        columns.append(arc.vector((high[0] - low[0]) / (2 * STEP), (high[1] - low[1]) / (2 * STEP)))
    return np.column_stack(columns)


def held_columns(fitted: FittedArc, held: Mapping[str, Held]) -> Array:
    """(r, p) derivatives of the errors of some effects by their amplitudes, in their order."""
    return np.hstack([_derivatives(fitted, *effect_of(label), one) for label, one in held.items()])


def held_error(sightings: Sightings, held: Mapping[str, Held]) -> tuple[Array, Array]:
    """Errors (n, 2) and (m, 4) of some effects together, rad; held by label."""
    sun, earth = sightings.nothing
    for label, one in held.items():
        effect, axis = effect_of(label)
        more = effect.error(sightings, axis, one.amplitudes, one.parameters)
        sun, earth = sun + more[0], earth + more[1]
    return sun, earth


# ---- unlisted rivals -----------------------------------------------------------------------------------------------------


def rival_families() -> list[Family]:
    """Every discrepancy that is on no list, but for sensors that sit differently each day."""
    terms, near = len(_powers()), 2 * (len(SUN_EDGES) - 1)
    each = [(8 * k, 8) for k in range(HARMONICS)]
    return [
        *(
            _rival(
                f"smooth error of DSS-{number}",
                partial(_smooth, number=number),
                [(0, terms), (terms, terms), (0, 2 * terms)],
                (f"DSS-{number}", f"residuals of DSS-{number} follow where the Sun is in its field of view"),
            )
            for number in SUN_SENSORS
        ),
        _rival(
            "Earth sensor at orbit harmonics",
            _quadrant_harmonics,
            [*each, (0, 8 * HARMONICS)],
            ("ESA", "quadrants of the Earth sensor are off at the orbit's harmonics"),
        ),
        _rival(
            "Earth sensor near the Sun", _near_sun, [(0, near)], ("ESA", "quadrants of the Earth sensor are off near the Sun")
        ),
        _rival(GYRO, _gyro_harmonics, [(6 * k, 6) for k in range(GYRO_HARMONICS)]),
    ]


def _rival(
    name: str,
    columns: Callable[[FittedArc], Array],
    parts: Sequence[tuple[int, int]],
    finding: tuple[str, str] | None = None,
) -> Family:
    choices = tuple(Choice(slice(start, start + count), {}, 1 / len(parts)) for start, count in parts)
    return Family(name, None, False, columns, choices, finding)


def _powers() -> list[tuple[int, int]]:
    return [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]


def _smooth(fitted: FittedArc, number: int) -> Array:
    """(r, 2q) Legendre products in (α, β) for α, then for β of one sun sensor, 1 deg each."""
    sightings = fitted.arc.sightings
    x = sightings.sun_angles / np.deg2rad(48.0)
    values = [np.polynomial.legendre.legvander(x[:, k], DEGREE) for k in range(2)]
    terms = np.deg2rad(np.stack([values[0][:, i] * values[1][:, j] for i, j in _powers()], axis=-1))  # (n, q)
    q = terms.shape[1]
    own = sightings.sun_sensor == number
    sun = np.zeros((len(x), 2, 2 * q))
    sun[own, 0, :q] = terms[own]
    sun[own, 1, q:] = terms[own]
    return fitted.arc.vector(sun, np.zeros((*sightings.used.shape, 2 * q)))


def orbit_phase(sightings: Sightings) -> Array:
    """(m,) argument of latitude of the Earth sensor's measurements, rad."""
    position = sightings.position
    normal = np.cross(position[:-1], position[1:]).sum(axis=0)
    normal = normal / np.linalg.norm(normal)
    node = np.cross([0.0, 0.0, 1.0], normal)
    length = np.linalg.norm(node)
    node = node / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.asarray(np.unwrap(np.arctan2(position @ np.cross(normal, node), position @ node)))


def _of_quadrants(fitted: FittedArc, earth: Array) -> Array:
    """(r, p) columns of errors (m, 4, p) of the Earth sensor."""
    return fitted.arc.vector(np.zeros((*fitted.arc.sightings.sun_angles.shape, earth.shape[2])), earth)


def _quadrant_harmonics(fitted: FittedArc) -> Array:
    """(r, 8h) sin and cos(k u) of each quadrant, 1 rad."""
    phase = orbit_phase(fitted.arc.sightings)
    waves = np.stack([f(k * phase) for k in range(1, HARMONICS + 1) for f in (np.sin, np.cos)], axis=-1)  # (m, 2h)
    return _of_quadrants(fitted, np.einsum("mw,qr->mqwr", waves, np.eye(4)).reshape(len(waves), 4, -1))


def _near_sun(fitted: FittedArc) -> Array:
    """(r, 2k) in which range of angles from the Sun a quadrant looks, coming and going, 1 deg."""
    sightings = fitted.arc.sightings
    nominal = Horizon().nominal
    directions = np.column_stack(
        [np.sin(nominal) * np.cos(AZIMUTHS), np.sin(nominal) * np.sin(AZIMUTHS), np.full(4, np.cos(nominal))]
    )
    body = np.einsum("mij,mj->mi", sightings.A, sightings.sun)
    away = np.arccos(np.clip(body @ directions.T, -1, 1))
    coming = np.gradient(away, axis=0) < 0
    rings = np.digitize(away, SUN_EDGES) - 1
    out = np.zeros((*away.shape, 2 * (len(SUN_EDGES) - 1)))
    for ring in range(len(SUN_EDGES) - 1):
        out[..., 2 * ring] = (rings == ring) & coming
        out[..., 2 * ring + 1] = (rings == ring) & ~coming
    return _of_quadrants(fitted, np.deg2rad(out))


def _gyro_harmonics(fitted: FittedArc) -> Array:
    """(r, 6h) of rate errors sin and cos(k u) about each axis, 1 deg/h: γ_n = −Σ f(u) ΔS, f constant between nodes."""
    path, sightings = fitted.path, fitted.arc.sightings
    middle = np.interp((path.t[:-1] + path.t[1:]) / 2, sightings.t_s, orbit_phase(sightings))
    steps = np.diff(fitted.S, axis=0)
    parts = []
    for k in range(1, GYRO_HARMONICS + 1):
        for wave in (np.sin, np.cos):
            gamma = np.concatenate([np.zeros((1, 3, 3)), -np.cumsum(wave(k * middle)[:, None, None] * steps, axis=0)])
            parts.append(np.einsum("ri,rij->rj", fitted.rows.attitude, gamma[fitted.rows.node]))
    return np.asarray(np.deg2rad(np.hstack(parts)) / 3600)
