"""recording.toml: its model, how it is written, and the faults of a document in words.

Format 2 may state the node and the argument of latitude of the orbit. A header without these is written in format 1.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from gyrocal.errors import InputError, suggest_names
from gyrocal.recording.parts import Interval
from gyrocal.recording.recording_data import Recording
from gyrocal.recording.tables import check_regular

LARGEST_HEADER = 1 << 24  # bytes of recording.toml

GainRow = Annotated[list[Annotated[float, Field(ge=-100, le=100)]], Field(min_length=3, max_length=3)]

# Replacements in Pydantic's messages, in this order, by plain words.
MESSAGE_REPLACEMENTS = (
    (r"^(Value|Assertion) error, ", ""),
    (r"^Extra inputs are not permitted$", "is not known"),
    (r"^Field required$", "is missing"),
    (r"^Input should be ", "must be "),
    (r"^Unable to extract tag using discriminator '(\w+)'$", r"\1 is missing"),
    (r"^Input tag '(.*)' found using '(\w+)' does not match any of the expected tags: (.*)$", r"\2 is '\1', not one of \3"),
    (r"^(?:List|Tuple|Dictionary|String) should have (at (?:least|most) \d+) (\w+).*$", r"must have \1 \2"),
    (r"(a valid \w+), .*$", r"\1"),
    (r"a valid dictionary(?: or (?:object|instance).*)?$", "a table"),
    (r"a valid (?:list|tuple)$", "a list"),
    (r"a valid string$", "text"),
    (r"a valid integer$", "a whole number"),
    (r"a valid boolean$", "true or false"),
    (r"a valid number$", "a number"),
)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class GyroHeader(_Model):
    """The gyro as a file states it."""

    sample_s: float = Field(gt=0)
    kind: Literal["rate"]
    arw_deg_per_sqrt_s: float = Field(ge=0, le=1e3)
    arw_estimated: bool = False
    arw_dof: float | None = Field(default=None, ge=0)
    apriori_G: list[GainRow] = Field(min_length=3, max_length=3)
    apriori_bias_deg_s: list[Annotated[float, Field(ge=-1e5, le=1e5)]] = Field(min_length=3, max_length=3)


class AttitudeHeader(_Model):
    """The references as a file states them."""

    maps: Literal["inertial to body"]
    quaternion: Literal["scalar last"]
    sigma_estimated: bool = False
    sigma_dof: float | None = Field(default=None, ge=0)


class _OrbitHeader(_Model):
    period_s: float = Field(ge=1.0, le=1e9)  # beyond any orbit
    altitude_km: float
    inclination_deg: float
    raan_deg: float | None = None
    argument_of_latitude_deg: float | None = None


class IntervalHeader(_Model):
    """An interval as a file states it."""

    name: str = Field(min_length=1)
    activity: str
    start_s: float
    stop_s: float
    forward: Literal["+x", "-x", "+y", "-y", "none"] | None = None

    @property
    def interval(self) -> Interval:
        """The interval as a part of a recording."""
        return Interval(self.name, self.activity, self.start_s, self.stop_s, self.forward)


class Header(_Model):
    """The entries of recording.toml; angles in degrees, as on file."""

    format: Literal[1, 2]
    title: str
    epoch: str
    time_scale: str
    gyro: GyroHeader
    attitude: AttitudeHeader
    orbit: _OrbitHeader | None = None
    interval: list[IntervalHeader] = Field(min_length=1)

    @field_validator("epoch")
    @classmethod
    def _validate_epoch(cls, value: str) -> str:
        datetime.fromisoformat(value)
        return value

    @model_validator(mode="after")
    def _validate_format(self) -> Header:
        orbit = set() if self.orbit is None else self.orbit.model_fields_set
        if self.format == 1 and orbit & {"raan_deg", "argument_of_latitude_deg"}:
            raise ValueError("raan_deg and argument_of_latitude_deg of the orbit need format = 2")
        return self


def read(path: Path) -> Header:
    """Read the header in a file."""
    check_regular(path)
    if path.exists() and path.stat().st_size > LARGEST_HEADER:
        raise InputError(f"{path}: {path.stat().st_size} bytes are no header of a recording, of {LARGEST_HEADER} at most")
    try:
        return Header.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {format_validation_error(error, Header)}") from None


def format_header(recording: Recording) -> str:
    """Format the header of a recording as TOML."""
    gyro, attitudes = recording.gyro, recording.attitudes
    known = {} if recording.orbit is None else vars(recording.orbit)
    orbit: dict[str, object] = {key: float(value) for key, value in known.items() if value is not None}
    version = 2 if len(orbit) > 3 else 1
    top = {"format": version, "title": recording.title, "epoch": recording.epoch, "time_scale": recording.time_scale}
    of_gyro = {
        "sample_s": float(gyro.sample_s),
        "kind": "rate",
        "arw_deg_per_sqrt_s": gyro.arw_deg_per_sqrt_s,
        "arw_estimated": gyro.arw_estimated or None,
        "arw_dof": float(gyro.arw_degrees) if np.isfinite(gyro.arw_degrees) else None,
        "apriori_G": gyro.apriori_G.tolist(),
        "apriori_bias_deg_s": gyro.apriori_bias_deg_s.tolist(),
    }
    of_attitudes = {
        "maps": "inertial to body",
        "quaternion": "scalar last",
        "sigma_estimated": attitudes.sigma_estimated or None,
        "sigma_dof": float(attitudes.sigma_degrees) if np.isfinite(attitudes.sigma_degrees) else None,
    }
    spans = [vars(i) | {"start_s": float(i.start_s), "stop_s": float(i.stop_s)} for i in recording.intervals]
    intervals = [("[[interval]]", span) for span in spans]
    blocks = []
    for title, entries in (("", top), ("[gyro]", of_gyro), ("[attitude]", of_attitudes), ("[orbit]", orbit), *intervals):
        if not entries:
            continue
        lines = [f"{key} = {format_toml(value)}" for key, value in entries.items() if value is not None]
        blocks.append("\n".join([title, *lines] if title else lines))
    return "\n\n".join(blocks) + "\n"


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; every failure is an `InputError` that names the file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as fault:
        raise InputError(f"{path}: cannot be read: {fault.strerror}") from None
    except (ValueError, RecursionError) as fault:  # TOML and UTF-8 errors are ValueErrors, as are endless integers
        raise InputError(f"{path}: not a TOML file: {fault}") from None


def format_toml(value: object) -> str:
    """Format one TOML value; floats with all their digits, so that reading returns the value that was written."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True).replace("\x7f", "\\u007f")  # a JSON string is a TOML basic string
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, Mapping):
        names = (name if re.fullmatch("[A-Za-z0-9_-]+", name) else format_toml(name) for name in map(str, value))
        return "{" + ", ".join(f"{name} = {format_toml(item)}" for name, item in zip(names, value.values(), strict=True)) + "}"
    if isinstance(value, Iterable):
        return "[" + ", ".join(format_toml(item) for item in value) + "]"
    raise TypeError(f"no TOML form for {value!r}")


def format_validation_error(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """Format all faults of a validated document in one line, each by its path; an unknown key with those of the model."""
    parts = []
    for fault in error.errors(include_url=False):
        text = str(fault["msg"])
        for pattern, words in MESSAGE_REPLACEMENTS:
            text = re.sub(pattern, words, text)
        if fault["type"] == "extra_forbidden" and model is not None:
            known = _list_keys(model, fault["loc"][:-1])
            text += f"; {suggest_names(str(fault['loc'][-1]), known)}" if known else ""
        parts.append(f"{'.'.join(str(part) for part in fault['loc']) or 'document'}: {text}")
    return "; ".join(parts)


def _list_keys(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """List the keys of the table at a path of a document; none if the table is unknown."""
    models: list[type[BaseModel]] = [model]
    for part in path:
        if isinstance(part, int):
            continue  # an item of a list has the models of the list
        # The model of a union that this tag stands for.
        tagged = [kind for kind in models if any(part in get_args(field.annotation) for field in kind.model_fields.values())]
        inside = [inner for kind in models if part in kind.model_fields for inner in _list_models(kind.model_fields[part])]
        models = inside or tagged or models
    return list(dict.fromkeys(key for kind in models for key in kind.model_fields))


def _list_models(field: Any) -> Iterator[type[BaseModel]]:
    """List the models in the type of a field, or in a part of a type."""
    kind = getattr(field, "annotation", field)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
    for inner in (*get_args(kind), *getattr(kind, "__metadata__", ())):
        yield from _list_models(inner)
