"""What an import makes of several attitude sensors in a recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.importing.column_mapping import Mapping
from gyrocal.importing.estimates import estimate_sensor_sigma
from gyrocal.importing.intervals import select_rows
from gyrocal.importing.sensors import BodyAttitudes
from gyrocal.importing.streams import Sensor
from gyrocal.recording import Attitudes, GyroStream
from gyrocal.recording.reference_join import JoinedReferences, join_references

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SAME_S = 1e-6
NEAREST_STEP = 0.75  # of a usual step: between two rows the nearest is half a step away


def read_stated_sigma(mapping: Mapping, sensors: tuple[Sensor, ...]) -> dict[str, Array] | None:
    """(3,) 1-sigma of each sensor as the mapping states it, rad, by name."""
    stated = mapping.sigma_deg
    if stated is None:
        return None
    if isinstance(stated, str):
        return {one.name: np.sqrt(np.mean(np.square(one.sigma), axis=0)) for one in sensors if one.sigma is not None}
    by_name = stated if isinstance(stated, dict) else dict.fromkeys((one.name for one in sensors), stated)
    return {one.name: np.deg2rad(np.broadcast_to(by_name[one.name], 3)) for one in sensors if one.name in by_name}


def build_references(
    body: BodyAttitudes, chosen: list[Indices], mapping: Mapping, gyro: GyroStream, said: list[str]
) -> tuple[Attitudes, JoinedReferences]:
    """Join the references of several sensors.

    Parameters
    ----------
    body : of all sensors
    chosen : rows of these in each interval; of the joined references those nearest to them are used, of each sensor, or in
        stated intervals all that are not nearer than the spacing
    mapping : what is known beyond the columns
    gyro : body rates
    said : what is assumed, to which it is added

    Returns
    -------
    The references that are used, and all of them.
    """
    sensors = list(body.sensors)
    if mapping.sigma_deg is None:
        found = join_references(sensors, gyro).sensors
        for k, (one, joined) in enumerate(zip(sensors, found, strict=True)):
            rows = [_find_nearest(one.t_s, body.t_s[own]) for own in chosen]
            sigma = estimate_sensor_sigma(gyro, one, joined.mounting, rows, said)
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
    return replace(attitudes, sigma_estimated=mapping.sigma_deg is None), joined_references


def _find_nearest(t_s: Array, wanted: Array) -> Indices:
    """Rows of some times from the first to the last of the wanted ones, of each the nearest, if it is less than a row away."""
    inside = np.flatnonzero((t_s >= wanted[0] - SAME_S) & (t_s <= wanted[-1] + SAME_S))
    if inside.size < 2:
        return inside
    nearest = inside[pd.Index(t_s[inside]).get_indexer(pd.Index(wanted), method="nearest")]
    return np.unique(nearest[np.abs(t_s[nearest] - wanted) < NEAREST_STEP * np.median(np.diff(t_s))])
