"""What an import makes of several attitude sensors, and of their names, in a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.importing.column_mapping import Mapping
from gyrocal.importing.estimates import estimate_sensor_sigma
from gyrocal.importing.intervals import select_rows
from gyrocal.importing.sensors import JoinedAttitudes
from gyrocal.importing.streams import Sensor
from gyrocal.recording import Attitudes, GyroStream
from gyrocal.recording.parts import AttitudeSensor
from gyrocal.recording.trackers import NAME, convert_to_body

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SAME_S = 1e-6


def rename_sensors(sensors: tuple[Sensor, ...], said: list[str]) -> tuple[Sensor, ...]:
    """Several sensors by names that a recording may have: their own, or numbers where these will not do."""
    if len(sensors) == 1 or all(NAME.fullmatch(one.name) for one in sensors):
        return sensors
    numbers = [f"s{k + 1}" for k in range(len(sensors))]
    said.append(f"the attitude sensors {', '.join(one.name for one in sensors)} are named {', '.join(numbers)}")
    return tuple(replace(one, name=name) for one, name in zip(sensors, numbers, strict=True))


def read_stated_sigma(mapping: Mapping, sensors: tuple[Sensor, ...]) -> dict[str, Array] | None:
    """(3,) 1-sigma of each sensor as the mapping states it, rad, by name."""
    stated = mapping.sigma_deg
    if stated is None:
        return None
    if isinstance(stated, str):
        return {one.name: np.sqrt(np.mean(np.square(one.sigma), axis=0)) for one in sensors if one.sigma is not None}
    by_name = stated if isinstance(stated, dict) else dict.fromkeys((one.name for one in sensors), stated)
    return {name: np.deg2rad(np.broadcast_to(values, 3)) for name, values in by_name.items()}


def build_references(
    sensors: tuple[Sensor, ...],
    joined: JoinedAttitudes,
    chosen: list[Indices],
    mapping: Mapping,
    gyro: GyroStream,
    said: list[str],
) -> Attitudes:
    """References of several sensors: each one's own rows nearest to the chosen times of the joined attitudes, or in stated
    intervals all that are not nearer than the spacing.

    A mounting that is not stated is estimated by a calibration, but for the first sensor's; so is a sigma here.
    """
    rows_of: list[list[Indices]] = []
    for one in sensors:
        if mapping.interval is not None:
            rows_of.append(select_rows(one.t_s, mapping.interval, mapping.spacing_s or 0.0))
        else:
            rows_of.append([_find_nearest(one.t_s, joined.t_s[rows]) for rows in chosen])
    sigma = joined.sigma
    if mapping.sigma_deg is None:
        sigma = {
            one.name: estimate_sensor_sigma(gyro, one, joined.mounting[one.name].T, sigma[one.name], rows, said)
            for one, rows in zip(sensors, rows_of, strict=True)
        }
    used = [np.unique(np.concatenate(rows)) for rows in rows_of]  # two intervals that touch share a reference
    row = np.concatenate(used)
    sensor = np.repeat(np.arange(len(sensors)), [rows.size for rows in used])
    t_s = np.concatenate([one.t_s for one in sensors])
    start = np.cumsum([0, *(one.t_s.size for one in sensors)])[sensor]
    order = np.lexsort((sensor, t_s[start + row]))
    place, sensor = (start + row)[order], sensor[order]
    known = _build_sensors(sensors, joined, mapping)
    measured = np.concatenate([one.q for one in sensors])[place]
    each = [np.tile(sigma[one.name], (one.t_s.size, 1)) if one.sigma is None else one.sigma for one in sensors]
    return Attitudes(
        t_s=t_s[place],
        quaternions=convert_to_body(measured, sensor, known),
        sigma=np.concatenate(each)[place],
        sensor=sensor,
        sensors=known,
        sigma_estimated=mapping.sigma_deg is None,
    )


def _find_nearest(t_s: Array, wanted: Array) -> Indices:
    """Rows of some times from the first to the last of the wanted ones, of each the nearest."""
    inside = np.flatnonzero((t_s >= wanted[0] - SAME_S) & (t_s <= wanted[-1] + SAME_S))
    if not inside.size:
        return inside
    return np.asarray(inside[np.unique(pd.Index(t_s[inside]).get_indexer(pd.Index(wanted), method="nearest"))])


def _build_sensors(sensors: tuple[Sensor, ...], joined: JoinedAttitudes, mapping: Mapping) -> tuple[AttitudeSensor, ...]:
    out = []
    for number, one in enumerate(sensors):
        prior = (mapping.mounting_sigma_deg or {}).get(one.name)
        free = number > 0 if mapping.mountings is None else one.name in (mapping.estimated_mountings or [])
        q = Rotation.from_matrix(joined.mounting[one.name]).as_quat()
        out.append(AttitudeSensor(one.name, q, free or prior is not None, None if prior is None else np.deg2rad(prior)))
    return tuple(out)
