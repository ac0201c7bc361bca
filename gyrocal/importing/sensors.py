"""Attitudes of several sensors in a user's tables: their noise, and the body's motion by all of them.

A sensor's own noise is told by second differences of its attitude over a lag L,

    x(t − L) − 2 x(t) + x(t + L),    variance 6 σ² of noise that is white over L

about its own axes, so that the large error about one sensor's boresight does not hide the small ones of the other. A body that
speeds up, and jitters, adds to it: it is an upper bound of that noise, and says nothing of errors that last longer than L.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array, Indices
from gyrocal.errors import InputError
from gyrocal.importing.column_mapping import Mapping
from gyrocal.importing.estimates import estimate_reference_sigma, estimate_sensor_sigma
from gyrocal.importing.intervals import select_rows
from gyrocal.importing.reference_join import JoinedReferences, SensorReferences, join_references
from gyrocal.importing.streams import BodyAttitudes, Sensor, Streams
from gyrocal.recording import Attitudes, GyroStream

FEWEST_ROWS = 10
SAME_S = 1e-6
NEAREST_STEP = 0.75  # of a usual step: between two rows the nearest is half a step away


def join_sensors(sensors: tuple[Sensor, ...], stated: dict[str, Array] | None, mapping: Mapping) -> BodyAttitudes:
    """Attitudes of the body at the first sensor's times, and at those of others where it has dropped out.

    The first one's axes are the body's unless its mounting is stated.

    stated: 1-sigma about each one's own axes, rad, by name; None estimates it
    """
    names, known = [one.name for one in sensors], mapping.build_mountings()
    first = sensors[0]
    if stated is not None and set(stated) != set(names):
        raise InputError(f"sigma_deg: give it for {', '.join(name or 'the attitudes' for name in names)}")
    if len(sensors) == 1 and first.name not in known:
        return BodyAttitudes(first.t_s, first.q)
    if len(sensors) > 1 and (unknown := sorted(set(known) - set(names))):
        raise InputError(f"mountings: no sensor {', '.join(unknown)}; there are {', '.join(names)}")
    references = []
    for sensor in sensors:
        sigma = sensor.sigma
        if sigma is None:
            own = _estimate_scatter(sensor, mapping.spacing_s or 0.0) if stated is None else stated[sensor.name]
            sigma = np.tile(own, (sensor.t_s.size, 1))
        references.append(SensorReferences(sensor.name, sensor.t_s, sensor.q, sigma, *known.get(sensor.name, (None, None))))
    body = join_references(references).attitudes
    return BodyAttitudes(body.t_s, body.quaternions, tuple(references))


def _estimate_scatter(sensor: Sensor, lag_s: float) -> Array:
    """Estimate the 1-sigma noise (3,) about the sensor's own axes, rad, from second differences at a spacing of lag_s."""
    step = float(np.median(np.diff(sensor.t_s)))
    lag = max(round(lag_s / step), 1)
    q = Rotation.from_quat(sensor.q)
    if sensor.t_s.size < 2 * lag + FEWEST_ROWS:
        raise InputError(f"attitude {sensor.name}: too few rows to take its noise from; give sigma_deg")
    middle = q[lag:-lag].inv()
    turns = (middle * q[2 * lag :]).as_rotvec() + (middle * q[: -2 * lag]).as_rotvec()
    span = sensor.t_s[2 * lag :] - sensor.t_s[: -2 * lag]
    even = np.abs(span - 2 * lag * step) < 0.1 * step
    return np.asarray(np.sqrt(np.mean(np.square(turns[even]), axis=0) / 6))


def read_stated_sigma(mapping: Mapping, sensors: tuple[Sensor, ...]) -> dict[str, Array] | None:
    """(3,) 1-sigma of each sensor as the mapping states it, rad, by name."""
    stated = mapping.sigma_deg
    if stated is None:
        return None
    if isinstance(stated, str):
        return {one.name: np.sqrt(np.mean(np.square(one.sigma), axis=0)) for one in sensors if one.sigma is not None}
    by_name = stated if isinstance(stated, dict) else dict.fromkeys((one.name for one in sensors), stated)
    return {sensor.name: np.deg2rad(np.broadcast_to(by_name[sensor.name], 3)) for sensor in sensors if sensor.name in by_name}


def build_references(
    streams: Streams,
    body: BodyAttitudes,
    chosen: list[Indices],
    mapping: Mapping,
    stated: dict[str, Array] | None,
    gyro: GyroStream,
    said: list[str],
) -> tuple[Attitudes, JoinedReferences | None]:
    """Build the references that are used, and join those of several sensors.

    Parameters
    ----------
    body : of all sensors
    chosen : rows of these in each interval
    stated : 1-sigma of each sensor, by name
    gyro : body rates
    """
    if body.sensors:
        return _join_references(body, chosen, mapping, gyro, said)
    sigma, degrees = streams.sensors[0].sigma, np.inf
    if stated is None:
        sigma, degrees = estimate_reference_sigma(gyro, body, chosen, said)
    elif sigma is None:
        sigma = next(iter(stated.values()))
    used = np.unique(np.concatenate(chosen))  # two intervals that touch share a reference
    references = Attitudes(body.t_s[used], body.q[used], np.broadcast_to(sigma, body.q[:, :3].shape)[used])
    return replace(references, sigma_estimated=stated is None, sigma_degrees=degrees), None


def _join_references(
    body: BodyAttitudes, chosen: list[Indices], mapping: Mapping, gyro: GyroStream, said: list[str]
) -> tuple[Attitudes, JoinedReferences]:
    """References of several sensors: of each those nearest to the chosen rows, or in stated intervals all at the spacing."""
    sensors, counts = list(body.sensors), list[float]()
    if mapping.sigma_deg is None:
        found = join_references(sensors, gyro).sensors
        for k, (one, joined) in enumerate(zip(sensors, found, strict=True)):
            rows = [_find_nearest(one.t_s, body.t_s[own]) for own in chosen]
            sigma, degrees = estimate_sensor_sigma(gyro, one, joined.mounting, rows, said)
            counts += [degrees] if degrees > 0 else []
            sensors[k] = replace(one, sigma=np.tile(sigma, (one.t_s.size, 1)))
    joined_references = join_references(sensors, gyro)
    said += joined_references.describe()
    t_s, used = joined_references.attitudes.t_s, list[Indices]()
    for held in joined_references.holds.T:
        own = np.flatnonzero(held)
        if mapping.interval is not None:
            used += [own[rows] for rows in select_rows(t_s[own], mapping.interval, mapping.spacing_s or 0.0)]
        else:
            used += [own[_find_nearest(t_s[own], body.t_s[rows])] for rows in chosen]
    attitudes = joined_references.attitudes.select_rows(np.unique(np.concatenate(used)))
    degrees = min(counts, default=np.inf if mapping.sigma_deg is not None else 0.0)
    return replace(attitudes, sigma_estimated=mapping.sigma_deg is None, sigma_degrees=degrees), joined_references


def _find_nearest(t_s: Array, wanted: Array) -> Indices:
    """Rows of some times from the first to the last of the wanted ones, of each the nearest, if it is less than a row away."""
    inside = np.flatnonzero((t_s >= wanted[0] - SAME_S) & (t_s <= wanted[-1] + SAME_S))
    if inside.size < 2:
        return inside
    nearest = inside[pd.Index(t_s[inside]).get_indexer(pd.Index(wanted), method="nearest")]
    return np.unique(nearest[np.abs(t_s[nearest] - wanted) < NEAREST_STEP * np.median(np.diff(t_s))])
