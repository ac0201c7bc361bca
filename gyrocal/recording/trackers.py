"""Reference attitudes of several sensors, such as star trackers, each with axes of its own.

A sensor s is mounted by the constant matrix M, body to sensor, as far as that is known; its reference A_s, inertial to sensor,
stands for the body attitude Mᵀ A_s. Its white errors have their sigmas about the sensor's own axes, so that in body axes their
covariance is Mᵀ diag(σ²) M. The true mounting is exp([m×]) M with a small misalignment m about the sensor's axes, which adds
the constant error e = Mᵀ m to every reference of that sensor. The first sensor defines the body's axes: its m is zero, since
turning all sensors together cannot be told from turning the body's axes.

On file (format 2) every row of the attitude table names its sensor and holds the quaternion that this sensor measured; in
memory quaternions are inertial to body by the mountings as stated, like those of a single sensor.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from gyrocal.errors import InputError
from gyrocal.recording.checks import NORM_TOLERANCE, check_norms
from gyrocal.recording.parts import Attitudes, AttitudeSensor

if TYPE_CHECKING:
    import pandas as pd
    from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

NAME = re.compile(r"[A-Za-z_]*[0-9]+")  # as a gyro's, so that it can stand in the place of an axis
MAPS = "inertial to sensor"
SENSOR_COLUMN = "sensor"


class SensorHeader(BaseModel):
    """A sensor as `recording.toml` states it."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    name: str
    mounting: list[Annotated[float, Field(ge=-1.1, le=1.1)]] = Field(min_length=4, max_length=4)
    sigma_deg: list[Annotated[float, Field(gt=0, le=180)]] | None = Field(default=None, min_length=3, max_length=3)
    estimated: bool = False
    mounting_sigma_deg: list[Annotated[float, Field(gt=0, le=10)]] | None = Field(default=None, min_length=3, max_length=3)

    @field_validator("name")
    @classmethod
    def _validate_name(cls, value: str) -> str:
        if not NAME.fullmatch(value):
            raise ValueError("must be letters with digits at the end, such as st1")
        return value

    @field_validator("mounting")
    @classmethod
    def _validate_mounting(cls, value: list[float]) -> list[float]:
        if abs(np.linalg.norm(value) - 1) > NORM_TOLERANCE:
            raise ValueError("must be a quaternion of norm 1")
        return value

    @model_validator(mode="after")
    def _validate_prior(self) -> SensorHeader:
        if self.mounting_sigma_deg is not None and not self.estimated:
            raise ValueError("mounting_sigma_deg is the prior of a mounting that is estimated: give estimated = true")
        return self

    @property
    def sensor(self) -> AttitudeSensor:
        """Convert to radians."""
        prior = None if self.mounting_sigma_deg is None else np.deg2rad(self.mounting_sigma_deg)
        return AttitudeSensor(self.name, np.array(self.mounting), self.estimated, prior)


def check_header(format: int, maps: str, sensors: Sequence[SensorHeader]) -> None:
    """Raise a `ValueError` where a header's sensors do not fit each other, its format, or what its quaternions map to."""
    if bool(sensors) != (maps == MAPS):
        raise ValueError(f'maps = "{MAPS}" and [[attitude.sensor]] need one another')
    if sensors and format == 1:
        raise ValueError("[[attitude.sensor]] needs format = 2")
    names = [one.name for one in sensors]
    if len(set(names)) < len(names):
        raise ValueError("names of attitude sensors must differ")
    if sensors and sensors[0].estimated:
        raise ValueError(f"the mounting of {names[0]} cannot be estimated: the first sensor defines the axes of the body")


def list_entries(sensor: AttitudeSensor) -> dict[str, object]:
    """A sensor's entries in recording.toml; what is None is left out."""
    prior = sensor.mounting_sigma
    return {
        "name": sensor.name,
        "mounting": sensor.mounting.tolist(),
        "estimated": sensor.estimated,
        "mounting_sigma_deg": None if prior is None else np.rad2deg(prior).tolist(),
    }


# ---- rows of the attitude table ------------------------------------------------------------------------------------------


def read(
    frame: pd.DataFrame, headers: Sequence[SensorHeader], sigmas: tuple[str, ...]
) -> tuple[Array, Array, Indices, tuple[AttitudeSensor, ...]]:
    """Quaternions inertial to body (m, 4), sigmas (m, 3) rad, sensor of each row (m,), and the sensors."""
    sensor, sensors = _match_sensors(frame, [one.name for one in headers]), tuple(one.sensor for one in headers)
    measured = frame[["q1", "q2", "q3", "q4"]].to_numpy(dtype=np.float64)
    check_norms(measured)
    there = all(name in frame.columns for name in sigmas)
    own = frame[list(sigmas)].to_numpy(dtype=np.float64) if there else np.array([one.sigma_deg for one in headers])[sensor]
    return convert_to_body(measured, sensor, sensors), np.deg2rad(own), sensor, sensors


def _match_sensors(frame: pd.DataFrame, names: Sequence[str]) -> Indices:
    if SENSOR_COLUMN not in frame.columns:
        if len(names) > 1:
            raise InputError(f"column {SENSOR_COLUMN} is missing, which says of which of {', '.join(names)} a row is")
        return np.zeros(len(frame), dtype=np.intp)
    given = frame[SENSOR_COLUMN].astype(object).fillna("(empty)").astype(str)
    unknown = sorted(set(given) - set(names))
    if unknown:
        raise InputError(
            f"column {SENSOR_COLUMN}: no [[attitude.sensor]] {', '.join(unknown[:3])}; there are {', '.join(names)}"
        )
    return np.array([names.index(name) for name in given], dtype=np.intp)


def check_unnamed(frame: pd.DataFrame, format: int) -> None:
    """Raise an `InputError` where rows name sensors that are stated nowhere; format 1 knows none."""
    if format > 1 and SENSOR_COLUMN in frame.columns:
        raise InputError(
            f"attitude: rows name a {SENSOR_COLUMN}, but recording.toml has no [[attitude.sensor]] with its mounting"
        )


def convert_to_body(measured: Array, sensor: Indices, sensors: Sequence[AttitudeSensor]) -> Array:
    """Quaternions inertial to body of those inertial to sensor, (m, 4)."""
    return np.asarray((_build_rotations(measured) * _stack_mountings(sensor, sensors).inv()).as_quat())


def convert_to_sensors(attitudes: Attitudes) -> Array:
    """Quaternions inertial to sensor, (m, 4), as they stand on file."""
    if attitudes.sensor is None:
        return attitudes.quaternions
    turned = _build_rotations(attitudes.quaternions) * _stack_mountings(attitudes.sensor, attitudes.sensors)
    return np.asarray(turned.as_quat())


def _stack_mountings(sensor: Indices, sensors: Sequence[AttitudeSensor]) -> Rotation:
    """Stack the mountings of every row as active rotations: the matrix is Mᵀ."""
    return _build_rotations(np.array([one.mounting for one in sensors])[sensor])


def _build_rotations(quaternions: Array) -> Rotation:
    """Active rotations of quaternions (m, 4)."""
    from scipy.spatial.transform import Rotation  # late: a third of a second that a refused file does without

    return Rotation.from_quat(quaternions)


def check(attitudes: Attitudes) -> None:
    """Raise an `InputError` where rows and sensors do not fit each other; times rise for each sensor by itself."""
    sensor, sensors = attitudes.sensor, attitudes.sensors
    if sensor is None:
        if sensors:
            raise InputError("attitude: sensors are stated, but not which row is of which")
        return
    if sensor.shape != attitudes.t_s.shape or (sensor.size and not 0 <= sensor.min() <= sensor.max() < len(sensors)):
        raise InputError("attitude: every row needs one of the sensors")
    for number, one in enumerate(sensors):
        own = attitudes.t_s[sensor == number]
        if (np.diff(own) <= 0).any():
            raise InputError(f"attitude: time of {one.name} repeats at t_s = {own[1:][np.diff(own) <= 0][0]}")


def keep_rows(attitudes: Attitudes, rows: Any) -> Attitudes:
    """Some of the references, by their rows."""
    sensor = None if attitudes.sensor is None else attitudes.sensor[rows]
    return replace(
        attitudes,
        t_s=attitudes.t_s[rows],
        quaternions=attitudes.quaternions[rows],
        sigma=attitudes.sigma[rows],
        sensor=sensor,
    )


# ---- one of them ---------------------------------------------------------------------------------------------------------


def stack_sensor_axes(attitudes: Attitudes) -> Array:
    """(m, 3, 3) M of every row, body to the axes in which its sigmas are; the identity of a single sensor in body axes."""
    if attitudes.sensor is None:
        return np.broadcast_to(np.eye(3), (attitudes.t_s.size, 3, 3))
    return np.array([one.M for one in attitudes.sensors])[attitudes.sensor]


def compute_body_covariance(attitudes: Attitudes) -> Array:
    """(m, 3, 3) covariance Mᵀ diag(σ²) M of every reference in body axes, rad²."""
    M = stack_sensor_axes(attitudes)
    return np.einsum("mki,mk,mkj->mij", M, attitudes.sigma**2, M)


def need_one_sensor(attitudes: Attitudes) -> None:
    """Raise an `InputError` for references of several sensors, where only those of one in body axes are understood."""
    if attitudes.sensor is not None:
        names = ", ".join(one.name for one in attitudes.sensors)
        raise InputError(
            f"this takes reference attitudes of one sensor in body axes, not of {names}; "
            "gyrocal.of_sensor makes the recording of one of them"
        )
