"""Attitudes of several sensors: how they sit towards each other, their noise, and what they say of the body together.

With A the body's attitude and A_k that of a sensor at the same time, D = A A_kᵀ takes the sensor's axes to the body's: a
constant M_kᵀ of its mounting, but for both errors. Where mountings are not stated, the first sensor's axes are the body's and
that of another one is the mean rotation; what is left is exp([d×]) = D M_k.

A sensor's own noise is told by second differences of its attitude over a lag L,

    x(t − L) − 2 x(t) + x(t + L),    variance 6 σ² of noise that is white over L

about its own axes, so that the large error about one sensor's boresight does not hide the small ones of the other. A body that
speeds up, and jitters, adds to it: it is an upper bound of that noise, and says nothing of errors that last longer than L.

At one time the sensors' attitudes together have the information Σ Mᵀ diag(σ_k⁻²) M, and the mean weighted by it. That mean is
for what an import asks of the motion; the references of the recording are each sensor's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from gyrocal import attitude
from gyrocal.errors import InputError
from gyrocal.importing.streams import Sensor

Array = NDArray[np.float64]

FEWEST_COMMON_TIMES = 10  # common times
GAP_STEPS = 1.5  # of a sensor's usual step: it has dropped out in a longer one
DIRECTION_SCATTER_RATIO = 0.5  # times the scatter as read: sensors of the other direction must stand so much stiller
MOUNTING_TOLERANCE = np.deg2rad(2.0)  # of a sensor from its stated mounting: more is another mounting


@dataclass(frozen=True)
class JoinedAttitudes:
    """Attitudes of one body by all sensors.

    Attributes
    ----------
    t_s, q : (m,) s and (m, 4) inertial to body, scalar last
    covariance : (3, 3) of one attitude's error that all sensors see, rad²; None for a single sensor whose sigma is not known
    mounting : each sensor's axes to the body's, (3, 3) by name
    sigma : (3,) 1-sigma about each sensor's own axes, rad, by name
    apart : (m, 3) of each further sensor from the first, exp([d×]) = A_k A_1ᵀ of their body attitudes, rad, by name; NaN where
        one of them has dropped out
    """

    t_s: Array
    q: Array
    covariance: Array | None
    mounting: dict[str, Array]
    sigma: dict[str, Array]
    apart: dict[str, Array]


def join_sensors(
    sensors: tuple[Sensor, ...],
    stated: dict[str, Array] | None,
    lag_s: float = 0.0,
    mountings: Mapping[str, Array] | None = None,
) -> JoinedAttitudes:
    """Join the sensors' attitudes at the first one's times, and at those of others where it has dropped out.

    Parameters
    ----------
    sensors : the first one's axes are the body's unless mountings are stated
    stated : 1-sigma about each one's own axes, rad, by name; None estimates it
    lag_s : of the second differences that it is estimated from; one step of a sensor at least
    mountings : (3, 3) body to sensor of each as stated, by name
    """
    first = sensors[0]
    if stated is not None and set(stated) != {one.name for one in sensors}:
        raise InputError(f"sigma_deg: give it for {', '.join(one.name or 'the attitudes' for one in sensors)}")
    if mountings is not None and set(mountings) != {one.name for one in sensors}:
        raise InputError(f"mountings: give it for {', '.join(one.name for one in sensors)}")
    if len(sensors) == 1:
        covariance = None if stated is None else np.diag(np.square(stated[first.name]))
        return JoinedAttitudes(first.t_s, first.q, covariance, {first.name: np.eye(3)}, dict(stated or {}), {})
    t_s = _merge_times(sensors)
    seen = [_has_attitude(one, t_s) for one in sensors]
    own = [_interpolate_attitudes(one, t_s) for one in sensors]  # inertial to sensor, (m, 3, 3)
    mounting = {first.name: np.eye(3) if mountings is None else mountings[first.name].T}
    A = mounting[first.name] @ own[0]
    for one, mask, values in zip(sensors[1:], seen[1:], own[1:], strict=True):
        common = seen[0] & mask
        if common.sum() < FEWEST_COMMON_TIMES:
            raise InputError(f"attitude: {int(common.sum())} common times of {first.name}, {one.name} are too few")
        mean, scatter = _compute_mean_turn(A[common], values[common])
        _, other = _compute_mean_turn(own[0][common].transpose(0, 2, 1), values[common].transpose(0, 2, 1))
        if other < DIRECTION_SCATTER_RATIO * scatter:
            raise InputError(
                f"attitude: {first.name} and {one.name} turn against each other by {np.rad2deg(scatter):.2g} deg RMS as read, "
                f"by {np.rad2deg(other):.2g} deg with the other direction (body-to-inertial for inertial-to-body, or back)"
            )
        mounting[one.name] = mean if mountings is None else mountings[one.name].T
        off = float(Rotation.from_matrix(mounting[one.name].T @ mean).magnitude())
        if off > MOUNTING_TOLERANCE:
            raise InputError(
                f"mountings: the attitudes of {first.name} and {one.name} say that {one.name} sits {np.rad2deg(off):.1f} deg "
                "from where it is stated; are they quaternions from body to sensor, scalar last?"
            )
    sigma = stated or {one.name: estimate_scatter(one, lag_s) for one in sensors}
    body = [mounting[one.name] @ values for one, values in zip(sensors, own, strict=True)]
    base = np.array(body[0])
    for mask, values in zip(seen[:0:-1], body[:0:-1], strict=True):  # of the first that sees
        base = np.where((seen[0] | ~mask)[:, None, None], base, values)
    weights = [
        np.linalg.inv(mounting[one.name] @ np.diag(np.square(sigma[one.name])) @ mounting[one.name].T) for one in sensors
    ]
    total = sum(mask[:, None, None] * W for mask, W in zip(seen, weights, strict=True))
    pulled = sum(
        mask[:, None] * (attitude.residual(values, base) @ W.T) for mask, values, W in zip(seen, body, weights, strict=True)
    )
    shift = np.linalg.solve(np.asarray(total), np.asarray(pulled)[:, :, None])[:, :, 0]
    apart = {
        one.name: np.where((seen[0] & mask)[:, None], attitude.residual(values, body[0]), np.nan)
        for one, mask, values in zip(sensors[1:], seen[1:], body[1:], strict=True)
    }
    q = attitude.quaternion_from_matrix(attitude.rotation_matrix(shift) @ base)
    return JoinedAttitudes(t_s, q, np.asarray(np.linalg.inv(sum(weights))), mounting, sigma, apart)


def _compute_mean_turn(A: Array, B: Array) -> tuple[Array, float]:
    """Mean rotation (3, 3) of A Bᵀ, and the RMS angle from it, rad."""
    turns = Rotation.from_matrix(A @ B.transpose(0, 2, 1))
    mean = turns.mean()
    return mean.as_matrix(), float(np.sqrt(np.mean(np.square((mean.inv() * turns).magnitude()))))


def _compute_spacing(sensor: Sensor) -> float:
    return float(np.median(np.diff(sensor.t_s)))


def _merge_times(sensors: tuple[Sensor, ...]) -> Array:
    """Times of the first, and of each further one where all before it have dropped out."""
    t_s = sensors[0].t_s
    for one in sensors[1:]:
        near = t_s[pd.Index(t_s).get_indexer(pd.Index(one.t_s), method="nearest")]
        away = np.abs(near - one.t_s) > GAP_STEPS * _compute_spacing(sensors[0])
        t_s = np.sort(np.concatenate([t_s, one.t_s[away]]))
    return t_s


def _has_attitude(sensor: Sensor, t_s: Array) -> NDArray[np.bool_]:
    """(m,) whether a sensor has an attitude at each time, or one soon before and after it."""
    after = np.clip(np.searchsorted(sensor.t_s, t_s), 1, sensor.t_s.size - 1)
    short = sensor.t_s[after] - sensor.t_s[after - 1] <= GAP_STEPS * _compute_spacing(sensor)
    inside = (t_s >= sensor.t_s[0]) & (t_s <= sensor.t_s[-1])
    return np.asarray(inside & (short | np.isin(t_s, sensor.t_s)))


def _interpolate_attitudes(sensor: Sensor, t_s: Array) -> Array:
    """(m, 3, 3) inertial to the sensor, between its attitudes where it has none."""
    between = Slerp(sensor.t_s, Rotation.from_quat(sensor.q))(np.clip(t_s, sensor.t_s[0], sensor.t_s[-1]))
    return np.asarray(between.inv().as_matrix())


def estimate_scatter(sensor: Sensor, lag_s: float) -> Array:
    """(3,) 1-sigma about the sensor's own axes, rad, from second differences over a lag."""
    step = _compute_spacing(sensor)
    lag = max(round(lag_s / step), 1)
    q = Rotation.from_quat(sensor.q)
    if sensor.t_s.size < 2 * lag + FEWEST_COMMON_TIMES:
        raise InputError(f"attitude {sensor.name}: too few rows to take its noise from; give sigma_deg")
    middle = q[lag:-lag].inv()
    turns = (middle * q[2 * lag :]).as_rotvec() + (middle * q[: -2 * lag]).as_rotvec()
    span = sensor.t_s[2 * lag :] - sensor.t_s[: -2 * lag]
    even = np.abs(span - 2 * lag * step) < 0.1 * step
    return np.asarray(np.sqrt(np.mean(np.square(turns[even]), axis=0) / 6))
