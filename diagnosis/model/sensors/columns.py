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

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from diagnosis.model.candidates import build_group
from diagnosis.model.linear import CandidateColumns, build_rival
from diagnosis.model.sensors.arcs import FittedArc
from gyrocal.arrays import Array
from simulator.effects.base import Value
from simulator.effects.sensor import SENSOR_EFFECTS, SensorEffect, Sightings
from simulator.sensors.horizon import AZIMUTHS, Horizon

STEP = 1e-3  # of an amplitude, for the derivative of an effect's error
DEGREE = 3  # of polynomials in the measured direction
HARMONICS = 3  # of the orbit rate
GYRO_HARMONICS = 2  # the same, of a rate error of the gyro

FIELD = float(np.deg2rad(48.0))  # half width of a sun sensor's field of view
SUN_EDGES = np.deg2rad([0.0, 5.0, 7.0, 10.0, 15.0, 25.0, 40.0])  # angles from the Sun
GYRO_RIVAL = "gyro rate at orbit harmonics"


@dataclass(frozen=True)
class HeldAmplitudes:
    """Amplitudes (k,) of an effect about which its error is linearised, and its other parameters."""

    amplitudes: Array  # amplitudes, parameters: as `SensorEffect.error` takes them
    parameters: Mapping[str, Value]
    # further parameters that are tried beside them, in place of the effect's own options
    others: tuple[Mapping[str, Value], ...] = ()


def build_groups(
    fitted: FittedArc, effects: Iterable[SensorEffect], amplitudes: Mapping[str, HeldAmplitudes]
) -> list[CandidateColumns]:
    """Build all candidates along an arc, their columns (r, k) in sigmas per unit of the amplitude.

    The errors are linearised about the amplitudes by label, or about zero.
    """
    listed = [_build_listed(fitted, effect, axis, amplitudes) for effect in effects for axis in effect.axes or (None,)]
    return [*listed, *(build_rival(name, None, build(fitted)) for name, build in RIVAL_BUILDERS.items())]


def find_sensor_effect(label: str) -> tuple[SensorEffect, str | None]:
    """Find the effect of a label, and its axis."""
    name, _, axis = label.partition(":")
    return SENSOR_EFFECTS[name], axis or None


def _build_listed(
    fitted: FittedArc, effect: SensorEffect, axis: str | None, amplitudes: Mapping[str, HeldAmplitudes]
) -> CandidateColumns:
    label = effect.name if axis is None else f"{effect.name}:{axis}"
    linearised = amplitudes.get(label, HeldAmplitudes(np.zeros(effect.count), {}))
    options, share = effect.options, 1.0
    if label in amplitudes and effect.refined:
        # Parameters that were found between the options are tried there only, with the prior share of one option.
        options, share = (linearised.parameters, *linearised.others), 1 / len(effect.options)
    columns = [_differentiate_error(fitted, effect, axis, replace(linearised, parameters=option)) for option in options]
    return build_group(effect, axis, columns, [dict(option) for option in options], [share / len(options)] * len(options))


def _differentiate_error(fitted: FittedArc, effect: SensorEffect, axis: str | None, setting: HeldAmplitudes) -> Array:
    """Differentiate an effect's error by its amplitudes, (r, k)."""
    arc, columns = fitted.arc, []
    for step in STEP * np.eye(effect.count):
        high, low = (
            effect.error(arc.sightings, axis, setting.amplitudes + sign * step, setting.parameters) for sign in (1, -1)
        )
        columns.append(arc.vector((high[0] - low[0]) / (2 * STEP), (high[1] - low[1]) / (2 * STEP)))
    return np.column_stack(columns)


def build_held_columns(fitted: FittedArc, amplitudes: Mapping[str, HeldAmplitudes]) -> Array:
    """Build the derivatives (r, p) of the errors of some effects by their amplitudes, in their order."""
    parts = [_differentiate_error(fitted, *find_sensor_effect(label), setting) for label, setting in amplitudes.items()]
    return np.hstack(parts)


def compute_held_error(sightings: Sightings, amplitudes: Mapping[str, HeldAmplitudes]) -> tuple[Array, Array]:
    """Compute the errors (n, 2) and (m, 4) of some effects together, rad; amplitudes by label."""
    sun, earth = sightings.nothing
    for label, setting in amplitudes.items():
        effect, axis = find_sensor_effect(label)
        errors = effect.error(sightings, axis, setting.amplitudes, setting.parameters)
        sun, earth = sun + errors[0], earth + errors[1]
    return sun, earth


def _build_smooth(fitted: FittedArc, number: int) -> list[Array]:
    """Build Legendre products in (α, β) for α, for β, and for both of one sun sensor, 1 deg each."""
    sightings = fitted.arc.sightings
    values = [np.polynomial.legendre.legvander(angle / FIELD, DEGREE) for angle in sightings.sun_angles.T]
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    is_of_sensor = (sightings.sun_sensor == number)[:, None]
    terms = np.deg2rad(np.stack([values[0][:, i] * values[1][:, j] for i, j in powers], axis=-1)) * is_of_sensor  # (n, q)
    nothing = np.zeros_like(terms)
    earth = np.zeros((*sightings.used.shape, len(powers)))
    alpha, beta = (fitted.arc.vector(np.stack(parts, axis=1), earth) for parts in ([terms, nothing], [nothing, terms]))
    return [alpha, beta, np.hstack([alpha, beta])]


def compute_orbit_phase(sightings: Sightings) -> Array:
    """Compute the argument of latitude (m,) of the Earth sensor's measurements, rad."""
    position = sightings.position
    normal = np.cross(position[:-1], position[1:]).sum(axis=0)
    normal = normal / np.linalg.norm(normal)
    node = np.cross([0.0, 0.0, 1.0], normal)
    length = np.linalg.norm(node)
    node = node / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return np.asarray(np.unwrap(np.arctan2(position @ np.cross(normal, node), position @ node)))


def _build_quadrant_columns(fitted: FittedArc, earth: Array) -> Array:
    """Build the columns (r, p) of errors (m, 4, p) of the Earth sensor."""
    return fitted.arc.vector(np.zeros((*fitted.arc.sightings.sun_angles.shape, earth.shape[2])), earth)


def _build_quadrant_harmonics(fitted: FittedArc) -> list[Array]:
    """Build sin and cos(k u) of each quadrant, 1 rad, for each k and for all."""
    phase = compute_orbit_phase(fitted.arc.sightings)
    by_order = []
    for k in range(1, HARMONICS + 1):
        waves = np.column_stack([np.sin(k * phase), np.cos(k * phase)])
        by_order.append(_build_quadrant_columns(fitted, np.einsum("mw,qr->mqwr", waves, np.eye(4)).reshape(len(waves), 4, -1)))
    return [*by_order, np.hstack(by_order)]


def _build_near_sun(fitted: FittedArc) -> list[Array]:
    """Mark the 1 deg range of angles from the Sun in which a quadrant looks; approaching and receding ranges are apart."""
    sightings = fitted.arc.sightings
    nominal = Horizon().nominal
    directions = np.column_stack(
        [np.sin(nominal) * np.cos(AZIMUTHS), np.sin(nominal) * np.sin(AZIMUTHS), np.full(4, np.cos(nominal))]
    )
    body = np.einsum("mij,mj->mi", sightings.A, sightings.sun)
    sun_distance = np.arccos(np.clip(body @ directions.T, -1, 1))
    coming = np.gradient(sun_distance, axis=0) < 0
    rings = np.digitize(sun_distance, SUN_EDGES) - 1
    indicators = np.zeros((*sun_distance.shape, 2 * (len(SUN_EDGES) - 1)))
    for ring in range(len(SUN_EDGES) - 1):
        indicators[..., 2 * ring] = (rings == ring) & coming
        indicators[..., 2 * ring + 1] = (rings == ring) & ~coming
    return [_build_quadrant_columns(fitted, np.deg2rad(indicators))]


def _build_gyro_harmonics(fitted: FittedArc) -> list[Array]:
    """Build rate errors sin and cos(k u) about each axis, 1 deg/h, for each k: γ_n = −Σ f(u) ΔS, f constant between nodes."""
    path, sightings = fitted.path, fitted.arc.sightings
    middle = np.interp((path.t[:-1] + path.t[1:]) / 2, sightings.t_s, compute_orbit_phase(sightings))
    steps = np.diff(fitted.S, axis=0)
    parts = []
    for k in range(1, GYRO_HARMONICS + 1):
        waves = []
        for wave in (np.sin, np.cos):
            gamma = np.concatenate([np.zeros((1, 3, 3)), -np.cumsum(wave(k * middle)[:, None, None] * steps, axis=0)])
            waves.append(np.einsum("ri,rij->rj", fitted.rows.attitude, gamma[fitted.rows.node]))
        parts.append(np.deg2rad(np.hstack(waves)) / 3600)
    return parts


RIVAL_BUILDERS: Mapping[str, Callable[[FittedArc], list[Array]]] = {
    "smooth error of DSS-1": partial(_build_smooth, number=1),
    "smooth error of DSS-2": partial(_build_smooth, number=2),
    "Earth sensor at orbit harmonics": _build_quadrant_harmonics,
    "Earth sensor near the Sun": _build_near_sun,
    GYRO_RIVAL: _build_gyro_harmonics,
}
