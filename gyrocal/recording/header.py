"""recording.toml: what it must say, and how it is written.

Format 1 holds the three gyros x, y and z. Format 2 holds any number of named gyros from three on, and may say which of them
were switched on in an interval. What format 1 can hold is written in it.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator

from gyrocal.errors import InputError
from gyrocal.recording import bounds, trackers
from gyrocal.recording.checks import spans
from gyrocal.recording.faults import validation_message
from gyrocal.recording.names import MOST_GYROS, TRIAD, check_names
from gyrocal.recording.toml import read_toml, toml_value
from gyrocal.recording.trackers import SensorHeader

if TYPE_CHECKING:
    from gyrocal.recording.recording import Recording


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _GyroHeader(_Model):
    sample_s: float = Field(gt=0)
    kind: Literal["rate"]
    arw_deg_per_sqrt_s: float = Field(ge=0, le=1e3)
    arw_estimated: bool = False
    names: list[str] = Field(default=list(TRIAD), min_length=3, max_length=MOST_GYROS)
    apriori_G: list[list[Annotated[float, Field(ge=-100, le=100)]]]
    apriori_bias_deg_s: list[Annotated[float, Field(ge=-1e5, le=1e5)]] = Field(min_length=3, max_length=3)

    @field_validator("names")
    @classmethod
    def _named(cls, value: list[str]) -> list[str]:
        check_names(tuple(value))
        return value

    @field_validator("apriori_G")
    @classmethod
    def _three_by_gyros(cls, value: list[list[float]], info: ValidationInfo) -> list[list[float]]:
        gyros = len(info.data.get("names", TRIAD))
        if len(value) != 3 or any(len(row) != gyros for row in value):
            raise ValueError(f"must be 3 rows of {gyros} numbers")
        if not spans(np.array(value)):
            raise ValueError("must be invertible")
        return value


class _AttitudeHeader(_Model):
    maps: Literal["inertial to body", "inertial to sensor"]
    quaternion: Literal["scalar last"]
    sigma_estimated: bool = False
    sensor: list[SensorHeader] = []


class _OrbitHeader(_Model):
    period_s: float = Field(ge=1.0, le=1e9)  # nothing that a spacecraft flies
    altitude_km: float
    inclination_deg: float
    raan_deg: float | None = None
    argument_of_latitude_deg: float | None = None


class _IntervalHeader(_Model):
    name: str = Field(min_length=1)
    activity: str
    start_s: float
    stop_s: float
    forward: Literal["+x", "-x", "+y", "-y", "none"] | None = None
    gyros: list[str] | None = None


class Header(_Model):
    """What recording.toml says; angles in degrees, as on file."""

    format: Literal[1, 2]
    title: str
    epoch: str
    time_scale: str
    gyro: _GyroHeader
    attitude: _AttitudeHeader
    orbit: _OrbitHeader | None = None
    interval: list[_IntervalHeader] = Field(min_length=1)

    @field_validator("epoch")
    @classmethod
    def _iso(cls, value: str) -> str:
        datetime.fromisoformat(value)
        return value

    @model_validator(mode="after")
    def _of_its_format(self) -> Header:
        trackers.check_header(self.format, self.attitude.maps, self.attitude.sensor)
        if self.format == 1 and (tuple(self.gyro.names) != TRIAD or any(one.gyros is not None for one in self.interval)):
            raise ValueError("names of gyros, and gyros of an interval, need format = 2")
        orbit = set() if self.orbit is None else self.orbit.model_fields_set
        if self.format == 1 and orbit & {"raan_deg", "argument_of_latitude_deg"}:
            raise ValueError("raan_deg and argument_of_latitude_deg of the orbit need format = 2")
        return self


def read(path: Path) -> Header:
    """The header in a file.

    Raises
    ------
    InputError
        One line with the file and all that is wrong in it.
    """
    bounds.check_header(path)
    try:
        return Header.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {validation_message(error, Header)}") from None


def text(recording: Recording) -> str:
    """The header of a recording as it is on file."""
    gyro = recording.gyro
    orbit = (
        {} if recording.orbit is None else {name: value for name, value in vars(recording.orbit).items() if value is not None}
    )
    named = recording.is_array or any(interval.gyros is not None for interval in recording.intervals)
    second = named or bool(recording.attitudes.sensors) or len(orbit) > 3
    sections: list[tuple[str, dict[str, object]]] = [
        (
            "",
            {
                "format": 2 if second else 1,
                "title": recording.title,
                "epoch": recording.epoch,
                "time_scale": recording.time_scale,
            },
        ),
        (
            "[gyro]",
            {
                "sample_s": float(gyro.sample_s),
                "kind": "rate",
                "arw_deg_per_sqrt_s": float(np.rad2deg(gyro.arw)),
                **({"arw_estimated": True} if gyro.arw_estimated else {}),
                **({"names": list(gyro.names)} if named else {}),
                "apriori_G": gyro.apriori_G.tolist(),
                "apriori_bias_deg_s": np.rad2deg(gyro.apriori_bias).tolist(),
            },
        ),
        (
            "[attitude]",
            {
                "maps": trackers.maps(recording.attitudes),
                "quaternion": "scalar last",
                **({"sigma_estimated": True} if recording.attitudes.sigma_estimated else {}),
            },
        ),
        *trackers.header_sections(recording.attitudes),
    ]
    if orbit:
        sections.append(("[orbit]", {name: float(value) for name, value in orbit.items()}))
    for interval in recording.intervals:
        sections.append(
            (
                "[[interval]]",
                {
                    "name": interval.name,
                    "activity": interval.activity,
                    "start_s": float(interval.start_s),
                    "stop_s": float(interval.stop_s),
                    **({} if interval.forward is None else {"forward": interval.forward}),
                    **({} if interval.gyros is None else {"gyros": list(interval.gyros)}),
                },
            )
        )
    blocks = []
    for title, entries in sections:
        lines = [title] if title else []
        blocks.append("\n".join(lines + [f"{key} = {toml_value(value)}" for key, value in entries.items()]))
    return "\n\n".join(blocks) + "\n"
