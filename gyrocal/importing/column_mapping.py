"""Mapping: the meaning of the columns of somebody's tables, from options or from a TOML file with the same entries.

    time = "timestamp_ms:ms"
    gyro = "gx,gy,gz:deg/s"
    quat = "qw,qx,qy,qz:body-to-inertial"

A text names columns, separated by commas, and after colons their unit, order or direction. A minus before a column's name
changes its sign. The scalar part of a quaternion is the element whose name ends in w, or in 0; otherwise scalar-first or
scalar-last must be stated.

Direction: "body-to-inertial" means that the rotation takes components of a vector in body axes to those in inertial ones,
v_inertial = q v q* with Hamilton's product, or v_inertial = M v with a matrix. Euler angles are those of
``Rotation.from_euler(sequence, angles)`` of scipy, columns in the order of the sequence, capitals for rotated axes; its matrix
takes vectors in the same way. A(q) of a recording then is the same quaternion, scalar last; see `gyrocal.attitude`.
"""

from __future__ import annotations

import re
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.importing.units import compute_gyro_factor
from gyrocal.recording import format_validation_error, read_toml
from gyrocal.recording.checks import NORM_TOLERANCE, refuse_rows
from gyrocal.recording.header import IntervalHeader

ATTITUDE_DIRECTIONS = {
    "body-to-inertial": False,
    "body-to-world": False,
    "inertial-to-body": True,
    "world-to-body": True,
}  # True: the inverse of A(q)'s quaternion
QUATERNION_ORDERS = ("scalar-first", "scalar-last")
EULER_SEQUENCE = re.compile("[xyz]{3}|[XYZ]{3}")
COLUMN_NUMBER = re.compile(r"#?([0-9]{1,6})")
TETRAHEDRON = (np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)).tolist()

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]
Positive = Annotated[float, Field(gt=0)]
Sigma = Positive | Vector


class Span(IntervalHeader):
    """An interval as in recording.toml, with an optional activity."""

    activity: str = ""


class Mapping(BaseModel):
    """Meaning of the columns, and known quantities; None is estimated or taken from the data."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    # time, attitude_time: "COLUMN:UNIT" of the gyro's table and of the attitudes'; the latter as the former by default
    time: str
    gyro: str  # "COLUMNS:UNIT", or one column with `gyro_by`
    attitude_time: str | None = None
    # quat, euler, matrix: the attitudes, one of the three
    quat: str | None = None
    euler: str | None = None
    matrix: str | None = None
    lsb: str | None = None  # size of a count with its unit
    # where an accumulated angle wraps, or the full range of rates that overflow, in the column's own unit
    wrap: float | None = Field(default=None, gt=0)
    rows: str | None = None  # "COLUMN:VALUE", the rows of the gyro's table that are read, where it holds several gyros
    sample_number: str | None = None  # column of the gyro's table that counts the samples
    temperature: str | None = None  # column of the gyro's table with the gyro's temperature, °C, which becomes housekeeping
    # samples a second; with it or the sample number the gyro's time tags are put on an even time base
    rate_hz: float | None = Field(default=None, gt=0)
    # gyro_by, attitude_by: column that says which gyro or which attitude sensor a row is of
    gyro_by: str | None = None
    attitude_by: str | None = None
    # which of the gyros are used, three or more by name or by number from 1, separated by commas; all by default
    gyros: str | None = None
    sensor: str | None = None  # with attitude_by, the only attitude sensor that is read
    # direction of each gyro in the body, a row a gyro; or "tetrahedron", three or all four of its axes
    axes: list[Vector] | Literal["tetrahedron"] | None = None
    G: list[list[float]] | None = None  # 3×n in place of axes: ω = G ω_raw + b
    # rotation vector in degrees from the gyros' axes to the attitudes'; "estimate" finds it
    mounting: Literal["as given", "estimate"] | Vector = "as given"
    tag: Literal["start", "middle", "end"] = "start"  # which part of a rate's sample its time tags
    attitude_offset_s: float = 0.0  # added to the attitudes' tags
    time_factor: float = Field(default=1.0, gt=0)  # factor of the gyro's tags about its first one
    rate_factor: float = Field(default=1.0, gt=0)  # factor of the rates
    common_start: bool = False  # whether a table whose times have no date begins with the other one
    # "auto" finds offset, time_factor, direction, mounting and rate_factor from the rates of both
    align: Literal["as given", "auto"] = "as given"
    unchecked: bool = False  # whether rates and attitudes are taken that do not fit each other
    # reference 1-sigma about all body axes or each; column(s) of the attitudes' table with it; with attitude_by about each
    # sensor's own axes, by its name
    sigma_deg: Sigma | str | dict[str, Sigma] | None = None
    # with attitude_by, quaternion from body to a sensor, scalar last, by its name; estimated of those not given
    mountings: dict[str, Quaternion] | None = None
    # 1-sigma of those that are to be estimated all the same, about the sensor's own axes, by its name
    mounting_sigma_deg: dict[str, Vector] | None = None
    arw_deg_per_sqrt_s: Positive | list[Positive] | None = None  # of each gyro; a number for all, or one for each that is used
    bias_deg_s: Vector | None = None  # of the body, b of ω = G ω_raw + b
    # interval_s, spacing_s: longest interval, and least time between references
    interval_s: float | None = Field(default=None, gt=0)
    spacing_s: float | None = Field(default=None, gt=0)
    # intervals as in recording.toml, in the place of those that are made
    interval: list[Span] | None = Field(default=None, min_length=1)
    exclude: list[Pair] | None = None  # stretches to leave out, from and to, s since the first gyro sample
    # title, epoch: of the recording; times of intervals are since the epoch
    title: str | None = None
    epoch: str | None = None

    @property
    def is_counted(self) -> bool:
        """Whether the gyro's samples are in the order of its rows, whatever their tags."""
        return self.rate_hz is not None or self.sample_number is not None

    @property
    def gyro_unit(self) -> str:
        """Unit of the gyro's columns."""
        return parse_spec(self.gyro, "gyro")[1][0]

    @property
    def gyro_factor(self) -> tuple[float, bool]:
        """Factor from the unit of the gyro's columns to rad/s or rad, and whether they are accumulated angles."""
        return compute_gyro_factor(self.gyro_unit, self.lsb)

    @property
    def is_accumulated(self) -> bool:
        """Whether the gyro's columns are accumulated angles."""
        return self.gyro_factor[1]

    @property
    def attitude(self) -> str:
        """The given one of quat, euler and matrix; an `InputError` if not exactly one is given."""
        given = [name for name in ("quat", "euler", "matrix") if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(
                "attitude: give one of quat, euler and matrix, e.g. --quat qw,qx,qy,qz:body-to-inertial; the noise of a "
                f"gyro at rest needs no attitudes: gyrocal allan LOG.csv --time {quote(self.time)} --gyro {quote(self.gyro)}"
            )
        return given[0]

    def build_mountings(self) -> dict[str, tuple[Array, Array | None]]:
        """Build the stated mountings by sensor: (3, 3) from body to sensor, and 1-sigma (3,) rad or None."""
        stated, sigmas = self.mountings or {}, self.mounting_sigma_deg or {}
        if stated and self.attitude_by is None:
            raise InputError("mountings: goes with attitude_by, the column that says which sensor a row is of")
        for name, q in stated.items():
            if abs(np.linalg.norm(q) - 1) > NORM_TOLERANCE:
                raise InputError(f"mountings: {name} must be a quaternion of norm 1")
        if unknown := sorted(set(sigmas) - set(stated)):
            raise InputError(f"mounting_sigma_deg: no mounting of {', '.join(unknown)} is stated; one not stated is estimated")
        if not stated:
            return {}
        prior = {name: np.deg2rad(sigma) for name, sigma in sigmas.items()}
        return {name: (np.asarray(Rotation.from_quat(q).as_matrix().T), prior.get(name)) for name, q in stated.items()}

    def choose_gyros(self, names: list[str]) -> list[int]:
        """Return the places in the list of names of the gyros that are used."""
        if self.gyros is None:
            return list(range(len(names)))
        plain = [name.removeprefix("-") for name in names]
        signed = {part: find_name(part.strip(), plain, "gyros", "gyro") for part in self.gyros.split(",")}
        if unknown := [part for part, name in signed.items() if name is None]:
            raise InputError(f"gyros: no gyro {', '.join(unknown)}; there are {', '.join(plain)}, or 1 to {len(names)}")
        places = [plain.index(name[1]) for part in self.gyros.split(",") if (name := signed[part]) is not None]
        if len(places) < 3 or len(set(places)) < len(places):
            raise InputError(f"gyros: three or more different ones are needed, not {self.gyros}")
        return places

    def get_relative_noise(self, gyros: int) -> list[float] | None:
        """Return the stated noise of each gyro, deg/sqrt(s); None if it is not stated for each."""
        stated = self.arw_deg_per_sqrt_s
        if isinstance(stated, list) and len(stated) != gyros:
            raise InputError(f"arw_deg_per_sqrt_s: {len(stated)} numbers, but {gyros} gyros; give one, or one a gyro")
        return stated if isinstance(stated, list) else None

    def build_G(self, count: int) -> Array:
        """Build G (3, count) of the mapping: its own, that of its axes, or the identity for three gyros."""
        if self.G is not None:
            if self.axes is not None:
                raise InputError("give axes or G, not both")
            G = np.array(self.G, dtype=float) if len({len(row) for row in self.G}) == 1 else np.zeros(0)
            if G.shape != (3, count):
                raise InputError(f"G: three rows of {count} numbers are needed, one for each gyro")
        elif self.axes is None:
            if count != 3:
                raise InputError(
                    f"gyro: {count} columns; with other than three give the gyros' axes: --axes 'X,Y,Z;X,Y,Z;…', three numbers "
                    "a gyro, or --axes tetrahedron (allan: axes in --mapping), or take three with --gyros"
                )
            G = np.eye(3)
        else:
            # Any three axes of a tetrahedron are its first three after a rotation or a reflection.
            rows = np.array(TETRAHEDRON[: 3 if count == 3 else 4] if self.axes == "tetrahedron" else self.axes)
            if len(rows) != count:
                raise InputError(f"axes: {len(rows)} rows, but {count} gyros")
            length = np.linalg.norm(rows, axis=1, keepdims=True)
            if (length < 1e-6).any():
                raise InputError("axes: a row is zero")
            # Unit rows measure ω_raw = axes ω; the pseudo-inverse is the least-squares body rate of equally noisy gyros.
            G = np.linalg.pinv(rows / length)
        if np.linalg.svd(G, compute_uv=False)[-1] < 1e-3:
            raise InputError("axes: the gyros do not measure all three directions")
        return np.asarray(G)


def load_mapping(path: Path) -> dict[str, Any]:
    """Read the entries of a mapping file without a check."""
    return read_toml(path)


def validate_mapping(entries: dict[str, Any], source: str, attitude_needed: bool = True) -> Mapping:
    """Build a mapping of entries; source names their origin. An `InputError` if one is not understood or missing."""
    entries = {key: value for key, value in entries.items() if value is not None}
    for name, example in (("time", "timestamp_ms:ms"), ("gyro", "gx,gy,gz:deg/s")):
        if name not in entries:
            raise InputError(f"{source}: {name} is missing, e.g. --{name} {example}")
    try:
        mapping = Mapping.model_validate(entries)
    except ValidationError as error:
        raise InputError(f"{source}: {format_validation_error(error, Mapping)}") from None
    if attitude_needed:
        _ = mapping.attitude  # raises if none is given
    return mapping


def find_name(text: str, names: list[str], what: str, thing: str = "column") -> tuple[str, str] | None:
    """Find the name that a text means, by itself or by its number from 1, and its sign, "" or "-"; None without a name.

    Every option that names columns, gyros or sensors is read by this rule.
    """
    if text in names:
        return "", text
    sign, plain = ("-", text[1:].strip()) if text.startswith("-") else ("", text)
    if plain in names:
        return sign, plain
    uncommented = plain.removeprefix("#").strip()  # a header may begin with the sign of a comment
    if uncommented in names and not uncommented.isdigit():
        return sign, uncommented
    number = COLUMN_NUMBER.fullmatch(plain)
    if number is None:
        return None
    if not 1 <= int(number[1]) <= len(names):
        raise InputError(f"{what}: no {thing} {plain}; there are {len(names)}, counted from 1 as in #1: {', '.join(names)}")
    return sign, names[int(number[1]) - 1]


def parse_spec(text: str, what: str) -> tuple[list[str], list[str]]:
    """Split a text "A,B:WORD:WORD" into its columns and its words."""
    head, *words = text.split(":")
    names = [name.strip() for name in head.split(",") if name.strip()]
    words = [word.strip() for word in words]
    if not names or not words or not all(words):
        raise InputError(f"{what}: {text!r} is not COLUMNS:UNIT, such as gx,gy,gz:deg/s")
    return names, words


def is_scalar_first(names: list[str], words: list[str]) -> bool:
    """Whether a quaternion's first column is its scalar part, by a stated order or by the columns' names."""
    orders = [word for word in words if word in QUATERNION_ORDERS]
    if len(orders) == 1:
        return orders[0] == QUATERNION_ORDERS[0]
    ends = [re.sub(r"[^a-z0-9]", "", name.lower())[-1:] for name in names]
    for mark in ("w", "0", "s"):
        if ends.count(mark) == 1 and ends.index(mark) in (0, 3):
            return ends.index(mark) == 0
    raise InputError(f"quat: do {', '.join(names)} have the scalar part first or last? add :scalar-first or :scalar-last")


def convert_attitude(kind: str, text: str, values: Array) -> Array:
    """Convert attitude columns (m, 3, 4 or 9) to A(q), (m, 4) scalar last; text is the entry that names the columns."""
    names, words = parse_spec(text, kind)
    reversals = [ATTITUDE_DIRECTIONS[word] for word in words if word in ATTITUDE_DIRECTIONS]
    if len(reversals) != 1:
        raise InputError(f"{kind}: {text!r} must say one direction: {', '.join(ATTITUDE_DIRECTIONS)}")
    others = [word for word in words if word not in ATTITUDE_DIRECTIONS]
    needed = {"quat": 4, "euler": 3, "matrix": 9}[kind]
    if len(names) != needed:
        raise InputError(f"{kind}: {needed} columns are needed, not {len(names)}")
    if kind != "euler":
        allowed = QUATERNION_ORDERS if kind == "quat" else ()
        if unknown := [word for word in others if word not in allowed]:
            known = ", ".join((*ATTITUDE_DIRECTIONS, *allowed))
            raise InputError(f"{kind}: {', '.join(unknown)} is not understood; known: {known}")
    if kind == "quat":
        q = np.roll(values, -1, axis=1) if is_scalar_first(names, words) else values
        norm = np.linalg.norm(q, axis=1)
        refuse_rows(kind, np.abs(norm - 1) > 0.01, "the four do not have norm 1")
        rotation = Rotation.from_quat(q)
    elif kind == "euler":
        rotation = _convert_euler_angles(text, others, values)
    else:
        M = values.reshape(-1, 3, 3)
        deviation = np.abs(M @ M.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        refuse_rows(kind, (deviation > 0.02) | (np.linalg.det(M) < 0), "the nine, row by row, are not a rotation matrix")
        rotation = Rotation.from_matrix(M)
    return np.asarray((rotation.inv() if reversals[0] else rotation).as_quat())


def _convert_euler_angles(text: str, words: list[str], values: Array) -> Rotation:
    """Convert Euler angles (m, 3) to rotations by the unit and the sequence among the words of an entry."""
    unit = [word for word in words if word in ("deg", "rad")]
    sequence = [word for word in words if EULER_SEQUENCE.fullmatch(word)]
    if len(unit) != 1 or len(sequence) != 1 or len(words) != 2:
        raise InputError(f"euler: {text!r} must say deg or rad and a sequence, e.g. yaw,pitch,roll:deg:ZYX:body-to-inertial")
    try:
        return Rotation.from_euler(sequence[0], values, degrees=unit[0] == "deg")
    except ValueError as fault:
        raise InputError(f"euler: {sequence[0]}: {fault}") from None
