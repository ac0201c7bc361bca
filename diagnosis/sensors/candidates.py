"""Columns of the listed sensor effects, and of what is on no list, along one stretch.

Rivals, each with amplitudes of any size that the recording could show:

- a smooth error of either angle of a sun sensor, a polynomial of third degree in (α, β) — what a transfer function that is not
  the assumed one does;
- errors of the quadrants at one, two and three times the orbit's rate;
- errors of the Earth sensor near the Sun, by the angle from it and by whether it comes or goes;
- sensors that sit differently each day, or drift through the months: DSS-2 and the Earth sensor's four angles;
- a rate error of the gyro at orbit rate or twice, which is no matter of the sensors.

Those of the days are made of the columns of the listed misalignment and biases, see `diagnosis.sensors.reduced`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.sensors.spans import Fitted
from simulator.effects.base import Value
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect, Sightings
from simulator.sensors.horizon import AZIMUTHS, Horizon

Array = NDArray[np.float64]

STEP = 1e-3  # of an amplitude, for the derivative of an effect's error
DEGREE = 3
HARMONICS = 3
GYRO_HARMONICS = 2
SUN_EDGES = np.deg2rad([0.0, 5.0, 7.0, 10.0, 15.0, 25.0, 40.0])  # angles from the Sun
GYRO = "gyro rate at orbit harmonics"


@dataclass(frozen=True)
class Group:
    """Neighbouring columns that belong together.

    Attributes
    ----------
    effect, axis : of a listed effect; a rival's name and None
    listed : whether it may be named
    start, count : its columns
    parameters : what they take for granted
    weight : prior among the options of the effect
    """

    effect: str
    axis: str | None
    listed: bool
    start: int
    count: int
    parameters: dict[str, Value]
    weight: float

    @property
    def label(self) -> str:
        """effect:axis, or the name."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"


@dataclass(frozen=True)
class Held:
    """Amplitudes (k,) of an effect, and its other parameters."""

    amplitudes: Array
    parameters: Mapping[str, Value]


def effect_of(label: str) -> tuple[SensorEffect, str | None]:
    """The effect of a label, and its axis."""
    name, _, axis = label.partition(":")
    return SENSOR_EFFECTS[name], axis or None


def held_error(sightings: Sightings, held: Mapping[str, Held]) -> tuple[Array, Array]:
    """Errors (n, 2) and (m, 4) of some effects together, rad; held by label."""
    sun, earth = sightings.nothing
    for label, one in held.items():
        effect, axis = effect_of(label)
        more = effect.error(sightings, axis, one.amplitudes, one.parameters)
        sun, earth = sun + more[0], earth + more[1]
    return sun, earth


def labels_of(library: Sequence[str]) -> list[str]:
    """Labels of the listed effects, one for each axis."""
    return [name if axis is None else f"{name}:{axis}" for name in library for axis in SENSOR_EFFECTS[name].axes or (None,)]


def _options(label: str, about: Mapping[str, Held]) -> tuple[Mapping[str, Value], ...]:
    """Parameters to try: those held, where they were found between the options."""
    effect, _ = effect_of(label)
    return (about[label].parameters,) if effect.refined and label in about else effect.options


def listed_groups(library: Sequence[str], about: Mapping[str, Held]) -> list[Group]:
    """Groups of the listed effects in the order of their columns; about as in `listed_columns`."""
    groups: list[Group] = []
    start = 0
    for label in labels_of(library):
        effect, axis = effect_of(label)
        for option in _options(label, about):
            groups.append(Group(effect.name, axis, True, start, effect.count, dict(option), 1 / len(effect.options)))
            start += effect.count
    return groups


def listed_columns(fitted: Fitted, library: Sequence[str], about: Mapping[str, Held]) -> Array:
    """(r, p) derivatives of the effects' errors by their amplitudes, at given amplitudes by label, in sigmas per unit."""
    parts = [np.zeros((len(fitted.rows.z), 0))]
    for label in labels_of(library):
        held = about[label].amplitudes if label in about else np.zeros(effect_of(label)[0].count)
        parts += [_columns(fitted, label, Held(held, option)) for option in _options(label, about)]
    return np.hstack(parts)


def held_columns(fitted: Fitted, held: Mapping[str, Held]) -> Array:
    """(r, p) the same of some effects, in their order."""
    return np.hstack([_columns(fitted, label, one) for label, one in held.items()])


def _columns(fitted: Fitted, label: str, held: Held) -> Array:
    effect, axis = effect_of(label)
    span = fitted.span
    steps = range(effect.count)
    return np.column_stack([span.vector(*_derivative(effect, span.sightings, axis, held, k)) for k in steps])


def _derivative(effect: SensorEffect, sightings: Sightings, axis: str | None, held: Held, k: int) -> tuple[Array, Array]:
    step = np.zeros(effect.count)
    step[k] = STEP
    high, low = (effect.error(sightings, axis, held.amplitudes + way * step, held.parameters) for way in (1, -1))
    return (high[0] - low[0]) / (2 * STEP), (high[1] - low[1]) / (2 * STEP)


def rival_groups(start: int) -> list[Group]:
    """Groups of the rivals in the order of their columns."""
    groups: list[Group] = []

    def add(name: str, at: int, counts: Sequence[tuple[int, int]]) -> None:
        for offset, count in counts:
            groups.append(Group(name, None, False, at + offset, count, {}, 1 / len(counts)))

    smooth = len(_powers())
    for number in (1, 2):
        add(f"smooth error of DSS-{number}", start, ((0, smooth), (smooth, smooth), (0, 2 * smooth)))
        start += 2 * smooth
    add("Earth sensor at orbit harmonics", start, (*((8 * k, 8) for k in range(HARMONICS)), (0, 8 * HARMONICS)))
    start += 8 * HARMONICS
    near = 2 * (len(SUN_EDGES) - 1)
    add("Earth sensor near the Sun", start, ((0, near),))
    start += near
    add(GYRO, start, tuple((6 * k, 6) for k in range(GYRO_HARMONICS)))
    return groups


def rival_columns(fitted: Fitted) -> Array:
    """(r, p) columns of the rivals, in the order of their groups."""
    span = fitted.span
    sun, earth = _smooth(span.sightings)
    phase = orbit_phase(span.sightings)
    waves = np.stack([f(k * phase) for k in range(1, HARMONICS + 1) for f in (np.sin, np.cos)], axis=-1)  # (m, 2h)
    quadrants = np.einsum("mw,qr->mqwr", waves, np.eye(4)).reshape(len(waves), 4, -1)
    near = _near_sun(span.sightings)
    none = np.zeros(sun.shape[:2])
    parts = [
        span.vector(sun, earth),
        span.vector(np.zeros((*none.shape, quadrants.shape[2])), quadrants),
        span.vector(np.zeros((*none.shape, near.shape[2])), near),
        _gyro(fitted, phase),
    ]
    return np.hstack(parts)


def _powers() -> list[tuple[int, int]]:
    return [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]


def _smooth(sightings: Sightings) -> tuple[Array, Array]:
    """Legendre products in (α, β) for each sensor's α, then β; (n, 2, p), and zeros (m, 4, p)."""
    x = sightings.sun_angles / np.deg2rad(48.0)
    values = [np.polynomial.legendre.legvander(x[:, k], DEGREE) for k in range(2)]
    terms = np.stack([values[0][:, i] * values[1][:, j] for i, j in _powers()], axis=-1)  # (n, q)
    q = terms.shape[1]
    out = np.zeros((len(x), 2, 4 * q))
    for number in (1, 2):
        own = sightings.sun_sensor == number
        for angle in (0, 1):
            at = (2 * (number - 1) + angle) * q
            out[own, angle, at : at + q] = np.deg2rad(terms[own])
    return out, np.zeros((*sightings.used.shape, 4 * q))


def orbit_phase(sightings: Sightings) -> Array:
    """(m,) argument of latitude of the Earth sensor's measurements, rad."""
    position = sightings.position
    normal = np.cross(position[:-1], position[1:]).sum(axis=0)
    normal = normal / np.linalg.norm(normal)
    node = np.cross([0.0, 0.0, 1.0], normal)
    length = np.linalg.norm(node)
    node = node / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.asarray(np.unwrap(np.arctan2(position @ np.cross(normal, node), position @ node)))


def _near_sun(sightings: Sightings) -> Array:
    """(m, 4, 2k) in which range of angles from the Sun a quadrant looks, coming and going."""
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
    return np.asarray(np.deg2rad(out))


def _gyro(fitted: Fitted, phase: Array) -> Array:
    """(r, 6h) of rate errors sin and cos(k u) about each axis, 1 deg/h: γ_n = −Σ f(u) ΔS, f constant between nodes."""
    path = fitted.path
    sightings = fitted.span.sightings
    middle = np.interp((path.t[:-1] + path.t[1:]) / 2, sightings.t_s, phase)
    steps = np.diff(fitted.S, axis=0)
    parts = []
    for k in range(1, GYRO_HARMONICS + 1):
        for wave in (np.sin, np.cos):
            gamma = np.concatenate([np.zeros((1, 3, 3)), -np.cumsum(wave(k * middle)[:, None, None] * steps, axis=0)])
            parts.append(np.einsum("ri,rij->rj", fitted.rows.attitude, gamma[fitted.rows.node]))
    return np.asarray(np.deg2rad(np.hstack(parts)) / 3600)
