"""Reference attitudes of several sensors in a recording's files (format 2), which are joined when they are read.

Every row of the attitude table names its sensor and holds the quaternion that this sensor measured, with the sigmas about the
sensor's own axes.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from gyrocal.errors import InputError
from gyrocal.recording.checks import NORM_TOLERANCE, check_norms, check_sigmas, check_times
from gyrocal.recording.tables import QUATERNION_COLUMNS, SIGMA_COLUMNS

if TYPE_CHECKING:
    import pandas as pd

    from gyrocal.recording.reference_join import SensorReferences

Indices = NDArray[np.intp]

NAME = re.compile(r"[A-Za-z_]*[0-9]+")
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


def read(frame: pd.DataFrame, headers: Sequence[SensorHeader]) -> list[SensorReferences]:
    """The references of each sensor that has any, from the rows of the attitude table."""
    from gyrocal.attitude import matrix_from_quaternion  # late: a third of a second that a refused file does without
    from gyrocal.recording.reference_join import SensorReferences

    sensor, out = _match_sensors(frame, [one.name for one in headers]), []
    measured = frame[list(QUATERNION_COLUMNS)].to_numpy(dtype=np.float64)
    check_norms(measured)
    for number, one in enumerate(headers):
        own = np.flatnonzero(sensor == number)
        t_s = frame["t_s"].to_numpy(dtype=np.float64)[own]
        there = set(SIGMA_COLUMNS) <= set(frame.columns)
        degrees = frame[list(SIGMA_COLUMNS)].to_numpy(dtype=np.float64)[own] if there else np.array([one.sigma_deg] * own.size)
        if not own.size:
            continue
        check_times(t_s, f"attitude of {one.name}")
        check_sigmas(np.deg2rad(degrees))
        M = matrix_from_quaternion(np.array(one.mounting))
        prior = None if one.mounting_sigma_deg is None else np.deg2rad(one.mounting_sigma_deg)
        is_free = one.estimated and prior is None
        out.append(SensorReferences(one.name, t_s, measured[own], np.deg2rad(degrees), None if is_free else M, prior))
    return out


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
