"""Attitudes of several sensors in a user's tables: their noise, and the body's motion by all of them.

A sensor's own noise is estimated by second differences of its attitude over a lag L,

    x(t − L) − 2 x(t) + x(t + L),    variance 6 σ² of noise that is white over L

about its own axes, so that the large error about one sensor's boresight does not hide the small ones of the other. An
acceleration or jitter of the body adds to it: the estimate is an upper bound of that noise. Errors that last longer than L are
not in it.
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
from gyrocal.importing.intervals import select_spaced_rows
from gyrocal.importing.reference_join import JoinedReferences, SensorReferences, join_references
from gyrocal.importing.streams import BodyAttitudes, Sensor, Streams
from gyrocal.recording import Attitudes, GyroStream

FEWEST_ROWS = 10
SAME_S = 1e-6
NEAREST_STEP = 0.75  # of a usual step: largest distance of a nearest row, which between two rows is half a step


def join_sensors(sensors: tuple[Sensor, ...], stated: dict[str, Array] | None, mapping: Mapping) -> BodyAttitudes:
    """Join the attitudes of the body at the first sensor's times, and at those of others where the first has none.

    The first sensor's axes are the body's unless its mounting is stated.

    stated: 1-sigma about each sensor's own axes, rad, by name; None estimates it
    """
    names, known = [sensor.name for sensor in sensors], mapping.build_mountings()
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
            scatter = _estimate_scatter(sensor, mapping.spacing_s or 0.0) if stated is None else stated[sensor.name]
            sigma = np.tile(scatter, (sensor.t_s.size, 1))
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
    """Read the stated 1-sigma (3,) of each sensor, rad, by name; None if the mapping states none."""
    stated = mapping.sigma_deg
    if stated is None:
        return None
    if isinstance(stated, str):
        return {s.name: np.sqrt(np.mean(np.square(s.sigma), axis=0)) for s in sensors if s.sigma is not None}
    by_name = stated if isinstance(stated, dict) else dict.fromkeys([sensor.name for sensor in sensors], stated)
    return {sensor.name: np.deg2rad(np.broadcast_to(by_name[sensor.name], 3)) for sensor in sensors if sensor.name in by_name}


def build_references(
    streams: Streams,
    body: BodyAttitudes,
    interval_rows: list[Indices],
    mapping: Mapping,
    stated: dict[str, Array] | None,
    gyro: GyroStream,
    notes: list[str],
) -> tuple[Attitudes, JoinedReferences | None]:
    """Build the references of the recording; those of several sensors are joined.

    Parameters
    ----------
    body : attitudes of all sensors
    interval_rows : their rows in each interval
    stated : 1-sigma of each sensor, by name
    gyro : body rates
    """
    if body.sensors:
        return _join_references(body, interval_rows, mapping, gyro, notes)
    sigma, degrees = streams.sensors[0].sigma, np.inf
    if stated is None:
        sigma, degrees = estimate_reference_sigma(gyro, body, interval_rows, notes)
    elif sigma is None:
        sigma = next(iter(stated.values()))
    used = np.unique(np.concatenate(interval_rows))  # two intervals that touch share a reference
    references = Attitudes(body.t_s[used], body.q[used], np.broadcast_to(sigma, body.q[:, :3].shape)[used])
    return replace(references, sigma_estimated=stated is None, sigma_degrees=degrees), None


def _join_references(
    body: BodyAttitudes, interval_rows: list[Indices], mapping: Mapping, gyro: GyroStream, notes: list[str]
) -> tuple[Attitudes, JoinedReferences]:
    """Join references of several sensors: of each the nearest to the rows of the intervals, or all of stated intervals."""
    sensors, counts = list(body.sensors), list[float]()
    if mapping.sigma_deg is None:
        joined_sensors = join_references(sensors, gyro).sensors
        for k, (sensor, joined) in enumerate(zip(sensors, joined_sensors, strict=True)):
            nearest = [_find_nearest(sensor.t_s, body.t_s[rows]) for rows in interval_rows]
            sigma, degrees = estimate_sensor_sigma(gyro, sensor, joined.mounting, nearest, notes)
            counts += [degrees] if degrees > 0 else []
            sensors[k] = replace(sensor, sigma=np.tile(sigma, (sensor.t_s.size, 1)))
    joined_references = join_references(sensors, gyro)
    notes += joined_references.describe()
    t_s, used = joined_references.attitudes.t_s, list[Indices]()
    for has_row in joined_references.holds.T:
        sensor_rows = np.flatnonzero(has_row)
        if mapping.interval is not None:
            spaced = select_spaced_rows(t_s[sensor_rows], mapping.interval, mapping.spacing_s or 0.0)
            used += [sensor_rows[rows] for rows in spaced]
        else:
            used += [sensor_rows[_find_nearest(t_s[sensor_rows], body.t_s[rows])] for rows in interval_rows]
    attitudes = joined_references.attitudes.select_rows(np.unique(np.concatenate(used)))
    degrees = min(counts, default=np.inf if mapping.sigma_deg is not None else 0.0)
    return replace(attitudes, sigma_estimated=mapping.sigma_deg is None, sigma_degrees=degrees), joined_references


def _find_nearest(t_s: Array, wanted: Array) -> Indices:
    """Find the rows nearest to wanted times, between the first and the last of them, and less than a usual step away."""
    inside = np.flatnonzero((t_s >= wanted[0] - SAME_S) & (t_s <= wanted[-1] + SAME_S))
    if inside.size < 2:
        return inside
    nearest = inside[pd.Index(t_s[inside]).get_indexer(pd.Index(wanted), method="nearest")]
    return np.unique(nearest[np.abs(t_s[nearest] - wanted) < NEAREST_STEP * np.median(np.diff(t_s))])
