"""Attitudes of several sensors as those of one body, the first sensor's axes being the body's.

With A_1 and A_2 the attitudes by two sensors at one time, D = A_1 A_2ᵀ takes the second's axes to the body's: a constant M of
mounting, but for both errors. M is the mean rotation; what is left is exp([d×]) = M A_2 A_1ᵀ.

A sensor's own noise is told by second differences of its attitude over a lag L,

    x(t − L) − 2 x(t) + x(t + L),    variance 6 σ² of noise that is white over L

about its own axes, so that the large error about one sensor's boresight does not hide the small ones of the other. A body that
speeds up, and jitters, adds to it: it is an upper bound of that noise, and says nothing of errors that last longer than L.

At one time the sensors' attitudes together have the information Σ M diag(σ_k⁻²) Mᵀ, and the mean weighted by it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from gyrocal import attitude
from gyrocal.errors import InputError
from gyrocal.importing.streams import Sensor

Array = NDArray[np.float64]

FEWEST = 10  # common times


@dataclass(frozen=True)
class Together:
    """Attitudes of one body by all sensors.

    Attributes
    ----------
    t_s, q : (m,) s and (m, 4) inertial to body, scalar last
    covariance : (3, 3) of one attitude's error, rad²; None for a single sensor whose sigma is not known
    mounting : each sensor's axes to the body's, (3, 3) by name
    sigma : (3,) 1-sigma about each sensor's own axes, rad, by name
    apart : (m, 3) of each further sensor from the first, M A_k A_1ᵀ as a rotation vector in body axes, rad, by name
    """

    t_s: Array
    q: Array
    covariance: Array | None
    mounting: dict[str, Array]
    sigma: dict[str, Array]
    apart: dict[str, Array]


def together(sensors: tuple[Sensor, ...], stated: dict[str, Array] | None, lag_s: float = 0.0) -> Together:
    """Join the sensors' attitudes at the first one's times.

    Parameters
    ----------
    sensors : the first one's axes are the body's
    stated : 1-sigma about each one's own axes, rad, by name; None estimates it
    lag_s : of the second differences that it is estimated from; one step of a sensor at least

    Raises
    ------
    InputError
        They have too few common times, or the stated sigmas are not theirs.
    """
    first = sensors[0]
    if stated is not None and set(stated) != {one.name for one in sensors}:
        raise InputError(f"sigma_deg: give it for {', '.join(one.name or 'the attitudes' for one in sensors)}")
    if len(sensors) == 1:
        covariance = None if stated is None else np.diag(np.square(stated[first.name]))
        return Together(first.t_s, first.q, covariance, {first.name: np.eye(3)}, dict(stated or {}), {})
    low, high = max(one.t_s[0] for one in sensors), min(one.t_s[-1] for one in sensors)
    used = (first.t_s >= low) & (first.t_s <= high)
    if used.sum() < FEWEST:
        raise InputError(f"attitude: {int(used.sum())} common times of {', '.join(one.name for one in sensors)} are too few")
    t_s = first.t_s[used]
    A = attitude.matrix_from_quaternion(first.q[used])
    mounting, apart = {first.name: np.eye(3)}, {}
    sigma = stated or {one.name: scatter(one, lag_s) for one in sensors}
    for one in sensors[1:]:
        other = Slerp(one.t_s, Rotation.from_quat(one.q))(t_s)
        D = A @ other.as_matrix()  # A_2ᵀ is scipy's own matrix
        M = Rotation.from_matrix(D).mean().as_matrix()
        mounting[one.name] = M
        apart[one.name] = attitude.residual(M @ other.inv().as_matrix(), A)
    weights = {name: np.linalg.inv(M @ np.diag(np.square(sigma[name])) @ M.T) for name, M in mounting.items()}
    covariance = np.linalg.inv(sum(weights.values()))
    shift = sum((d @ (covariance @ weights[name]).T for name, d in apart.items()), np.zeros((t_s.size, 3)))
    q = attitude.quaternion_from_matrix(attitude.rotation_matrix(shift) @ A)
    return Together(t_s, q, np.asarray(covariance), mounting, sigma, apart)


def scatter(sensor: Sensor, lag_s: float) -> Array:
    """(3,) 1-sigma about the sensor's own axes, rad, from second differences over a lag."""
    step = float(np.median(np.diff(sensor.t_s)))
    lag = max(round(lag_s / step), 1)
    q = Rotation.from_quat(sensor.q)
    if sensor.t_s.size < 2 * lag + FEWEST:
        raise InputError(f"attitude {sensor.name}: too few rows to take its noise from; give sigma_deg")
    middle = q[lag:-lag].inv()
    turns = (middle * q[2 * lag :]).as_rotvec() + (middle * q[: -2 * lag]).as_rotvec()
    span = sensor.t_s[2 * lag :] - sensor.t_s[: -2 * lag]
    even = np.abs(span - 2 * lag * step) < 0.1 * step
    return np.asarray(np.sqrt(np.mean(np.square(turns[even]), axis=0) / 6))
