"""References of several attitude sensors, such as star trackers, joined to one series of body attitudes by their covariances.

A sensor mounted by M (body to sensor) measures A_s = exp([ν×]) M A, with ν ~ N(0, diag(σ²)) about its own axes. Its row gives
the body attitude Mᵀ A_s = exp([e×]) A, where e has the covariance P = Mᵀ diag(σ²) M. Rows of one time are averaged:

    P = (P_a⁻¹ + P_b⁻¹)⁻¹,    A = exp([P P_b⁻¹ θ×]) A_a,    exp([θ×]) = Mᵀ A_s A_aᵀ

A mounting M = exp([m×]) M₀ is estimated by weighted least squares, with its prior if it has one, from all rows of one time, or
by interpolation where the sensors take turns:

    m = Q Σ C⁻¹ θ,    Q = (Σ C⁻¹ + prior⁻¹)⁻¹,    exp([θ×]) = A_s A_aᵀ M₀ᵀ,    C = diag(σ²) + M₀ P_a M₀ᵀ

The first sensor defines the body's axes. Its mounting error cannot be separated from that of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from gyrocal import attitude
from gyrocal.arrays import Array, Indices, Mask
from gyrocal.errors import InputError
from gyrocal.importing.units import format_degrees
from gyrocal.recording.parts import Attitudes, GyroStream

SAME_TIME = 0.5  # of a gyro sample, or without a gyro of the sensor's usual step: rows within it are of one time
EXACT_S = 1e-9  # largest difference in time of rows that are compared without propagation
LARGEST_TURN = np.deg2rad(10.0)  # between two rows of a sensor that are interpolated: the rate of a body is constant over it
GAP_STEPS = 1.5  # usual steps of a sensor: it is not interpolated over a longer one
FEWEST_COMMON_TIMES = 10  # to estimate a mounting without a prior
DIRECTION_SCATTER_RATIO = 0.5  # times the scatter as read: below it the attitudes are of the other direction
MOUNTING_TOLERANCE = np.deg2rad(2.0)  # of a sensor from its stated mounting: a larger one is another mounting
ITERATIONS = 3  # of a mounting estimate, since the propagation of rows to one time uses the mounting


@dataclass(frozen=True)
class SensorReferences:
    """Reference attitudes by one sensor."""

    name: str  # of the sensor
    t_s: Array  # (m,) s, strictly increasing
    quaternions: Array  # (m, 4) inertial to the sensor's own axes, scalar last
    sigma: Array  # (m, 3) 1-sigma about the sensor's own axes, rad
    mounting: Array | None = None  # (3, 3) body to sensor as stated; None if it is not known
    # (3,) 1-sigma of the stated mounting about the sensor's own axes, rad; None if it is exact
    mounting_sigma: Array | None = None

    @property
    def is_estimated(self) -> bool:
        """Whether the join estimates its mounting."""
        return self.mounting is None or self.mounting_sigma is not None


@dataclass(frozen=True)
class JoinedSensor:
    """A sensor after the join."""

    name: str  # of the sensor
    rows: int  # number of its rows
    common: int  # number of its rows that are compared with a sensor before it
    mounting: Array  # (3, 3) body to sensor
    mounting_sigma: Array | None  # (3,) 1-sigma of the mounting about the sensor's own axes, rad; None if it was not estimated
    agreement: float  # RMS of its differences from the sensors before it, in units of their stated sigma; NaN without any

    def describe(self) -> str:
        """Describe the sensor in a sentence."""
        turn = -Rotation.from_matrix(self.mounting).as_rotvec()
        where = f"turned from the body by {format_degrees(turn)} deg (rotation vector)" if turn.any() else "the body's axes"
        text = f"{self.name}: {self.rows} attitudes, {where}"
        if self.mounting_sigma is not None:
            text += f", estimated with 1-sigma {format_degrees(self.mounting_sigma)} deg about its own axes"
        if self.common:
            text += f"; {self.common} compared with those of another sensor differ from them by {self.agreement:.3g} sigma RMS"
        return text


@dataclass(frozen=True)
class JoinedReferences:
    """One series of body attitudes of several sensors."""

    attitudes: Attitudes  # the references, each with its covariance
    holds: Mask  # (m, sensors) whether a row holds a reference of each sensor, in the order in which they were given
    sensors: tuple[JoinedSensor, ...]  # in the same order

    def describe(self) -> list[str]:
        """Describe each sensor, and the joint references."""
        sigma = format_degrees(np.median(self.attitudes.sigma, axis=0))
        return [
            *(sensor.describe() for sensor in self.sensors),
            f"{self.attitudes.t_s.size} joint references, 1-sigma about the body's axes {sigma} deg (median)",
        ]


class _Rows(NamedTuple):
    """Body attitudes joined so far: times (m,), A (m, 3, 3), P (m, 3, 3) rad², and the sensors (m, s) in each row."""

    t_s: Array
    A: Array
    P: Array
    holds: Mask


def join_references(sensors: Sequence[SensorReferences], gyro: GyroStream | None = None) -> JoinedReferences:
    """Join the references of several sensors to one series of body attitudes.

    Mountings that are not stated are estimated from rows of one time, those of sensors that take turns by interpolation. The
    first sensor defines the body's axes; they are its own ones unless its mounting is stated. A row without another of its time
    is kept with its own covariance.

    An `InputError` if a mounting cannot be estimated, or a stated mounting contradicts the attitudes.

    Parameters
    ----------
    sensors : the references of each sensor
    gyro : brings rows less than half a sample apart to one time, by its a-priori G and bias in body axes; without it each
        further sensor is interpolated at the times of those before it, which correlates its neighbouring errors
    """
    first = sensors[0]
    M = np.eye(3) if first.mounting is None else first.mounting
    joined = _build_rows(first, M, 0, len(sensors))
    joined_sensors = {0: JoinedSensor(first.name, first.t_s.size, 0, M, None, np.nan)}
    for number in sorted(range(1, len(sensors)), key=lambda k: sensors[k].is_estimated):
        sensor = sensors[number]
        pairs, common_gyro = _pair_rows(joined, sensor, gyro), gyro
        common = pairs
        if pairs[0].size < FEWEST_COMMON_TIMES:  # sensors that take turns: compared by interpolation, and not averaged
            common, common_gyro = _pair_rows(joined, sensor, None), None
        M, sigma = _estimate_mounting(joined, sensor, *common, common_gyro)
        agreement = _compute_agreement(joined, sensor, *common, M, common_gyro)
        joined_sensors[number] = JoinedSensor(sensor.name, sensor.t_s.size, common[0].size, M, sigma, agreement)
        theta = attitude.residual(_propagate_rows(sensor, pairs[1], joined.t_s[pairs[0]], M, gyro), M @ joined.A[pairs[0]])
        joined = _merge_rows(joined, _build_rows(sensor, M, number, len(sensors)), *pairs, theta @ M)
    attitudes = Attitudes(joined.t_s, attitude.quaternion_from_matrix(joined.A), np.empty((0, 3)))
    in_order = tuple(joined_sensors[k] for k in range(len(sensors)))
    return JoinedReferences(attitudes.replace_covariance(joined.P), joined.holds, in_order)


def _build_rows(sensor: SensorReferences, M: Array, number: int, count: int) -> _Rows:
    """Build the body attitudes of one of count sensors."""
    A, P = M.T @ attitude.matrix_from_quaternion(sensor.quaternions), np.einsum("ki,mk,kj->mij", M, sensor.sigma**2, M)
    return _Rows(sensor.t_s, A, P, np.tile(np.arange(count) == number, (sensor.t_s.size, 1)))


def _pair_rows(joined: _Rows, sensor: SensorReferences, gyro: GyroStream | None) -> tuple[Indices, Indices]:
    """Pair joined rows (k,) with rows (k,) of a sensor at nearly the same time, each used once."""
    after = np.clip(np.searchsorted(sensor.t_s, joined.t_s), 0, sensor.t_s.size - 1)
    before = np.maximum(after - 1, 0)
    late, early = np.abs(sensor.t_s[after] - joined.t_s), np.abs(sensor.t_s[before] - joined.t_s)
    row, distance = np.where(early < late, before, after), np.minimum(early, late)
    if gyro is not None:
        is_pair = distance <= SAME_TIME * gyro.sample_s
    else:
        step = float(np.median(np.diff(sensor.t_s))) if sensor.t_s.size > 1 else 0.0
        inside = (joined.t_s >= sensor.t_s[0]) & (joined.t_s <= sensor.t_s[-1])
        inside &= sensor.t_s[after] - sensor.t_s[before] <= GAP_STEPS * step
        body = Rotation.from_quat(sensor.quaternions)
        inside &= (body[before].inv() * body[after]).magnitude() <= LARGEST_TURN
        is_pair = (inside & (distance <= GAP_STEPS * SAME_TIME * step)) | (distance <= EXACT_S)
    a = np.flatnonzero(is_pair)
    order = a[np.lexsort((distance[a], row[a]))]  # so that the nearest joined row at a row of the sensor comes first
    b, once = np.unique(row[order], return_index=True)
    return order[once], b


def _propagate_rows(sensor: SensorReferences, rows: Indices, t_s: Array, M: Array, gyro: GyroStream | None) -> Array:
    """Propagate rows of a sensor, (k, 3, 3) from inertial to sensor, to times near theirs, by the gyro or by interpolation."""
    A, gap = attitude.matrix_from_quaternion(sensor.quaternions[rows]), sensor.t_s[rows] - t_s
    is_moved = np.abs(gap) > EXACT_S
    if not is_moved.any():
        return A
    if gyro is None:
        between = Slerp(sensor.t_s, Rotation.from_quat(sensor.quaternions))(np.clip(t_s, sensor.t_s[0], sensor.t_s[-1]))
        return np.where(is_moved[:, None, None], between.inv().as_matrix(), A)
    sample = np.clip(np.searchsorted(gyro.t_s, np.minimum(sensor.t_s[rows], t_s), side="right") - 1, 0, gyro.t_s.size - 1)
    rates = np.nan_to_num(gyro.rates[sample]) @ gyro.apriori_G.T + gyro.apriori_bias
    return np.asarray(attitude.rotation_matrix((rates * gap[:, None]) @ M.T) @ A)


def _compute_difference_covariance(joined: _Rows, sigma: Array, a: Indices, M: Array) -> Array:
    """Compute the covariance (k, 3, 3) of a sensor's attitudes minus the joined ones about the sensor's own axes, rad²."""
    return np.asarray(M @ joined.P[a] @ M.T + np.einsum("mi,ij->mij", sigma**2, np.eye(3)))


def _compute_agreement(
    joined: _Rows, sensor: SensorReferences, a: Indices, b: Indices, M: Array, gyro: GyroStream | None
) -> float:
    """Compute the RMS of a sensor's differences from the joined attitudes in units of their sigma; NaN without any."""
    theta = attitude.residual(_propagate_rows(sensor, b, joined.t_s[a], M, gyro), M @ joined.A[a])
    sigma = sensor.sigma[b]
    if gyro is None and sensor.t_s.size > 1:  # an attitude between two is the mean of both, with less noise
        part = np.abs(sensor.t_s[b] - joined.t_s[a]) / np.median(np.diff(sensor.t_s))
        sigma = sigma * np.sqrt((1 - part) ** 2 + part**2)[:, None]
    C = _compute_difference_covariance(joined, sigma, a, M)
    chi2 = float(np.einsum("ki,ki->", theta, np.linalg.solve(C, theta[:, :, None])[:, :, 0]))
    dof = theta.size - 3 * (sensor.mounting is None)
    return float(np.sqrt(chi2 / dof)) if dof > 0 else np.nan


def _estimate_mounting(
    joined: _Rows, sensor: SensorReferences, a: Indices, b: Indices, gyro: GyroStream | None
) -> tuple[Array, Array | None]:
    """Estimate the mounting (3, 3), body to sensor, and its 1-sigma (3,) about the sensor's axes, rad; None if it is exact."""
    stated = sensor.mounting
    if stated is None and a.size < FEWEST_COMMON_TIMES:
        raise InputError(
            f"attitude: {sensor.name} has {a.size} time(s) in common with the sensors before it, of {FEWEST_COMMON_TIMES} that "
            "are needed to find its mounting; state the mountings, or keep one sensor: gyrocal import csv --sensor NAME"
        )
    if a.size >= FEWEST_COMMON_TIMES:
        mean = _estimate_mean_rotation(joined, sensor, a, b, gyro)
    if stated is not None and sensor.mounting_sigma is None:
        return stated, None
    M = mean if stated is None else stated
    prior = np.zeros((3, 3)) if sensor.mounting_sigma is None else np.diag(sensor.mounting_sigma**-2.0)
    for _ in range(ITERATIONS):
        weight = np.linalg.inv(_compute_difference_covariance(joined, sensor.sigma[b], a, M))
        theta = attitude.residual(_propagate_rows(sensor, b, joined.t_s[a], M, gyro), M @ joined.A[a])
        pull = np.einsum("kij,kj->i", weight, theta)
        pull = pull if stated is None else pull + prior @ attitude.residual(stated, M)
        Q = np.linalg.inv(weight.sum(axis=0) + prior)
        M = np.asarray(attitude.rotation_matrix(Q @ pull) @ M)
    return M, np.sqrt(np.diag(Q))


def _estimate_mean_rotation(
    joined: _Rows, sensor: SensorReferences, joined_rows: Indices, sensor_rows: Indices, gyro: GyroStream | None
) -> Array:
    """Estimate the mean rotation (3, 3) from body to sensor.

    An `InputError` if the transposed attitudes scatter far less, so that they are stored in the inverse direction, or if the
    rotation is far from the stated mounting.
    """
    A = _propagate_rows(
        sensor, sensor_rows, joined.t_s[joined_rows], np.eye(3) if sensor.mounting is None else sensor.mounting, gyro
    )
    B = joined.A[joined_rows]
    mean, scatter = _compute_mean_rotation(A, B)
    _, reversed_scatter = _compute_mean_rotation(A.transpose(0, 2, 1), B.transpose(0, 2, 1))
    if sensor.mounting is None and reversed_scatter < DIRECTION_SCATTER_RATIO * scatter:
        raise InputError(
            f"attitude: {sensor.name} and the sensors before it turn against each other by {np.rad2deg(scatter):.2g} deg RMS "
            f"as read, by {np.rad2deg(reversed_scatter):.2g} deg with the other direction "
            "(body-to-inertial for inertial-to-body, or back)"
        )
    off = 0.0 if sensor.mounting is None else float(Rotation.from_matrix(sensor.mounting.T @ mean).magnitude())
    if off > MOUNTING_TOLERANCE:
        raise InputError(
            f"attitude: by the attitudes {sensor.name} is mounted {np.rad2deg(off):.1f} deg from where it is stated; are the "
            "mountings quaternions from body to sensor, scalar last?"
        )
    return mean


def _compute_mean_rotation(A: Array, B: Array) -> tuple[Array, float]:
    """Compute the mean rotation (3, 3) of A Bᵀ, and the RMS angle from it, rad."""
    turns = Rotation.from_matrix(A @ B.transpose(0, 2, 1))
    mean = turns.mean()
    return mean.as_matrix(), float(np.sqrt(np.mean(np.square((mean.inv() * turns).magnitude()))))


def _merge_rows(joined: _Rows, sensor_rows: _Rows, a: Indices, b: Indices, theta: Array) -> _Rows:
    """Average the rows a with the rows b of a sensor, whose attitudes are exp([θ×]) times theirs, and insert its other rows."""
    A, P, holds = joined.A.copy(), joined.P.copy(), joined.holds.copy()
    weight = np.linalg.inv(sensor_rows.P[b])
    P[a] = np.linalg.inv(np.linalg.inv(P[a]) + weight)
    A[a] = attitude.rotation_matrix(np.einsum("kij,kjl,kl->ki", P[a], weight, theta)) @ A[a]
    holds[a] |= sensor_rows.holds[b]
    unpaired = np.setdiff1d(np.arange(sensor_rows.t_s.size), b)
    t_s = np.append(joined.t_s, sensor_rows.t_s[unpaired])
    order = np.argsort(t_s, kind="stable")
    pairs = ((A, sensor_rows.A), (P, sensor_rows.P), (holds, sensor_rows.holds))
    return _Rows(t_s[order], *(np.concatenate([old, new[unpaired]])[order] for old, new in pairs))
