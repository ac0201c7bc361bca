"""Attitudes of several sensors in a user's tables: their noise, and the body's motion by all of them.

A sensor's own noise is told by second differences of its attitude over a lag L,

    x(t − L) − 2 x(t) + x(t + L),    variance 6 σ² of noise that is white over L

about its own axes, so that the large error about one sensor's boresight does not hide the small ones of the other. A body that
speeds up, and jitters, adds to it: it is an upper bound of that noise, and says nothing of errors that last longer than L.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal.errors import InputError
from gyrocal.importing.streams import Sensor
from gyrocal.recording.reference_join import SensorReferences, join_references

Array = NDArray[np.float64]

FEWEST_ROWS = 10


@dataclass(frozen=True)
class BodyAttitudes:
    """Attitudes of the body as far as an import asks of its motion.

    Attributes
    ----------
    t_s, q : (m,) s and (m, 4) inertial to body, scalar last
    sensors : where there are several, each one's attitudes with what is known of its noise and mounting
    """

    t_s: Array
    q: Array
    sensors: tuple[SensorReferences, ...] = ()


def join_sensors(
    sensors: tuple[Sensor, ...],
    stated: Mapping[str, Array] | None,
    lag_s: float = 0.0,
    mountings: Mapping[str, tuple[Array, Array | None]] | None = None,
) -> BodyAttitudes:
    """Attitudes of the body at the first sensor's times, and at those of others where it has dropped out.

    Parameters
    ----------
    sensors : the first one's axes are the body's unless its mounting is stated
    stated : 1-sigma about each one's own axes, rad, by name; None estimates it
    lag_s : of the second differences that it is estimated from; one step of a sensor at least
    mountings : (3, 3) body to sensor as stated, and its 1-sigma (3,) or None, by name
    """
    names, known = [one.name for one in sensors], mountings or {}
    first = sensors[0]
    if stated is not None and set(stated) != set(names):
        raise InputError(f"sigma_deg: give it for {', '.join(name or 'the attitudes' for name in names)}")
    if len(sensors) == 1 and first.name not in known:
        return BodyAttitudes(first.t_s, first.q)
    if len(sensors) > 1 and (unknown := sorted(set(known) - set(names))):
        raise InputError(f"mountings: no sensor {', '.join(unknown)}; there are {', '.join(names)}")
    references = []
    for one in sensors:
        sigma = one.sigma
        if sigma is None:
            own = estimate_scatter(one, lag_s) if stated is None else stated[one.name]
            sigma = np.tile(own, (one.t_s.size, 1))
        references.append(SensorReferences(one.name, one.t_s, one.q, sigma, *known.get(one.name, (None, None))))
    body = join_references(references).attitudes
    return BodyAttitudes(body.t_s, body.quaternions, tuple(references))


def estimate_scatter(sensor: Sensor, lag_s: float) -> Array:
    """(3,) 1-sigma about the sensor's own axes, rad, from second differences over a lag."""
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
