"""A recording: a gyro stream, reference attitudes and calibration intervals; load, validate, save.

On disk a recording is one folder: ``recording.toml``, ``gyro.parquet`` (or ``.csv``), ``attitude.parquet`` and optional
tables. Files are in degrees, objects in radians. The gyro sample k is the mean body rate over [t_k, t_k + sample_s) as the
uncalibrated gyro shows it. Simulated and real data share the format, and nothing in it says which it is.

Format 1 holds the three gyros x, y and z. Format 2 holds any number of named gyros from three on, may say which of them were
switched on in an interval, and may do without reference attitudes. What format 1 can hold is written in it.
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator

from gyrocal.errors import InputError
from gyrocal.files import held, write_together
from gyrocal.recording import bounds, sensor_tables
from gyrocal.recording.faults import validation_message
from gyrocal.recording.sensor_tables import SensorTables

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

TRIAD = ("x", "y", "z")  # names of the three gyros of format 1
GYRO_NAME = re.compile(r"[A-Za-z_]*[0-9]+")  # of any other; ends with a digit, so that no body axis looks like it
MOST_GYROS = 24
RATE_COLUMNS = ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s")
QUATERNION_COLUMNS = ("q1", "q2", "q3", "q4")
SIGMA_COLUMNS = ("sigma_x_deg", "sigma_y_deg", "sigma_z_deg")
OPTIONAL_TABLES = ("housekeeping", *sensor_tables.NAMES)
FORWARD = ("+x", "-x", "+y", "-y", "none")
NORM_TOLERANCE = 1e-6  # |q| - 1 of a quaternion written with 7 digits
TIME_TOLERANCE_S = 1e-6  # rounding of a time tag some years after the epoch
SMALLEST_DETERMINANT = 1e-3  # of a G that counts as invertible
LARGEST_RATE = float(np.deg2rad(1e5))  # no gyro measures more
SIGMA_RANGE = (float(np.deg2rad(1e-9)), float(np.deg2rad(180.0)))  # nothing outside is the sigma of an attitude


@dataclass(frozen=True)
class Interval:
    """One calibration interval; starts and ends in a constant-rate mode.

    Attributes
    ----------
    name : of its own
    activity : for people
    start_s, stop_s : s since the epoch
    forward : one of `FORWARD`, the body axis along the velocity throughout; None leaves it to the attitudes
    gyros : names of those that were switched on; None for all
    """

    name: str
    activity: str
    start_s: float
    stop_s: float
    forward: str | None = None
    gyros: tuple[str, ...] | None = None


@dataclass(frozen=True)
class GyroStream:
    """Raw gyro samples and what is known of the gyro beforehand.

    Attributes
    ----------
    t_s : (n,) sample start times, s since the epoch, strictly increasing
    rates : (n, gyros) raw rates, rad/s; anything where an interval has a gyro switched off
    sample_s : duration of one sample, s
    arw : angle random walk of each gyro, rad/sqrt(s); the noise of one sample's rate is arw / sqrt(sample_s)
    apriori_G : (3, gyros) rows are body axes, columns gyros
    apriori_bias : (3,) rad/s
    names : of the gyros
    """

    t_s: Array
    rates: Array
    sample_s: float
    arw: float
    apriori_G: Array = field(default_factory=lambda: np.eye(3))
    apriori_bias: Array = field(default_factory=lambda: np.zeros(3))
    names: tuple[str, ...] = TRIAD

    @property
    def rates_deg_s(self) -> Array:
        """(n, 3) raw rates, deg/s."""
        return np.asarray(np.rad2deg(self.rates))

    @property
    def arw_deg_per_sqrt_s(self) -> float:
        """Angle random walk, deg/sqrt(s)."""
        return float(np.rad2deg(self.arw))

    @property
    def apriori_bias_deg_s(self) -> Array:
        """(3,) a-priori b, deg/s."""
        return np.asarray(np.rad2deg(self.apriori_bias))


@dataclass(frozen=True)
class Attitudes:
    """Reference attitudes; none at all where more than three gyros are to be compared with one another only.

    Attributes
    ----------
    t_s : (m,) s since the epoch, strictly increasing
    quaternions : (m, 4) inertial to body, scalar last
    sigma : (m, 3) 1-sigma per body axis, rad
    """

    t_s: Array
    quaternions: Array
    sigma: Array

    @property
    def sigma_deg(self) -> Array:
        """(m, 3) 1-sigma per body axis, deg."""
        return np.asarray(np.rad2deg(self.sigma))


@dataclass(frozen=True)
class Orbit:
    """Orbit of the recording, as far as it is known."""

    period_s: float
    altitude_km: float
    inclination_deg: float


@dataclass(frozen=True)
class Recording:
    """Everything the calibrator gets to see."""

    title: str
    epoch: str
    gyro: GyroStream
    attitudes: Attitudes
    intervals: tuple[Interval, ...]
    orbit: Orbit | None = None
    time_scale: str = "UTC"
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)
    sensors: SensorTables | None = None

    def __post_init__(self) -> None:
        _check_gyro(self.gyro)
        _check_intervals(self.intervals)
        _check_switched_on(self.gyro, self.intervals)
        if self.attitudes.t_s.size or not self.is_array:
            _check_attitudes(self.attitudes)
            _check_references(self.attitudes.t_s, self.intervals)

    @property
    def is_array(self) -> bool:
        """Whether it has other gyros than x, y and z."""
        return self.gyro.names != TRIAD

    def switched_on(self, interval: int) -> NDArray[np.intp]:
        """Columns of the gyros that were on in an interval, by its number."""
        chosen = self.intervals[interval].gyros
        return np.array([k for k, name in enumerate(self.gyro.names) if chosen is None or name in chosen])

    @classmethod
    def from_arrays(
        cls,
        t_s: ArrayLike,
        rates: ArrayLike,
        reference_t_s: ArrayLike,
        quaternions: ArrayLike,
        *,
        sigma: ArrayLike,
        arw: float,
        sample_s: float | None = None,
        G: ArrayLike | None = None,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        intervals: Sequence[Interval] | None = None,
        title: str = "arrays",
        epoch: str = "2000-01-01T00:00:00",
        time_scale: str = "seconds of the arrays",
    ) -> Recording:
        """A recording of arrays.

        Parameters
        ----------
        t_s, rates : (n,) starts of the samples, s, and (n, k) raw rates of k gyros, rad/s
        reference_t_s, quaternions : (m,) s, and (m, 4) inertial to body, scalar last
        sigma : 1-sigma of the references per body axis, rad; (m, 3), (3,) or one number
        arw : angle random walk, rad/sqrt(s)
        sample_s : s; the median spacing by default
        G : (3, k) a-priori G, needed if k is not 3: the gyros are then named "1", "2", …
        bias : (3,) a-priori b, rad/s
        intervals : one over all references by default
        title, epoch, time_scale : of the recording

        Raises
        ------
        InputError
            Shapes do not fit, or the recording would not be valid.
        """
        from gyrocal.recording.arrays import from_arrays

        return from_arrays(
            t_s,
            rates,
            reference_t_s,
            quaternions,
            sigma=sigma,
            arw=arw,
            sample_s=sample_s,
            G=G,
            bias=bias,
            intervals=intervals,
            title=title,
            epoch=epoch,
            time_scale=time_scale,
        )

    @classmethod
    def from_frame(cls, gyro: pd.DataFrame, attitude: pd.DataFrame, *, arw_deg_per_sqrt_s: float, **options: Any) -> Recording:
        """A recording of two tables with the columns of the files, in degrees.

        Parameters
        ----------
        gyro : t_s, rate_x_deg_s … z
        attitude : t_s, q1 … q4, sigma_x_deg … z
        arw_deg_per_sqrt_s : angle random walk
        options : bias_deg_s, and what else `from_arrays` takes by name

        Raises
        ------
        InputError
            A column is missing, or the recording would not be valid.
        """
        from gyrocal.recording.arrays import from_frame

        return from_frame(gyro, attitude, arw_deg_per_sqrt_s=arw_deg_per_sqrt_s, **options)

    def to_frame(self, table: str = "gyro") -> pd.DataFrame:
        """A table with the columns of the files, in degrees.

        Parameters
        ----------
        table : "gyro", "attitude", or one of the optional tables that the recording has

        Raises
        ------
        InputError
            It has none of that name.
        """
        frames = _frames(self)
        if table not in frames:
            raise InputError(f"{table}: no such table; there are {', '.join(frames)}")
        return frames[table].copy()

    def to_xarray(self) -> xarray.Dataset:
        """Rates, references and intervals as one labelled data set, in degrees; xarray is an optional extra.

        Raises
        ------
        InputError
            It is not installed.
        """
        from gyrocal.recording import arrays

        return arrays.to_xarray(self)

    def plot_allan(self, ax: Axes | None = None, *, interval: str | None = None) -> Axes:
        """Overlapping Allan deviation of the raw rates about each axis, deg/s, beside the stated angle random walk.

        Parameters
        ----------
        ax : to draw on; one of a new figure by default
        interval : of this interval with whatever moves in it; of the rests by default

        Raises
        ------
        InputError
            There is no rest, no such interval, or too few samples.
        """
        from gyrocal.allan.plot import plot_allan

        return plot_allan(self, ax, interval)

    def __repr__(self) -> str:
        from gyrocal.recording import arrays

        return arrays.text("Recording", arrays.facts(self))

    def _repr_html_(self) -> str:
        from gyrocal.recording import arrays

        return arrays.page("Recording", arrays.facts(self))


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class _GyroHeader(_Model):
    sample_s: float = Field(gt=0)
    kind: Literal["rate"]
    arw_deg_per_sqrt_s: float = Field(ge=0, le=1e3)
    names: list[str] = Field(default=list(TRIAD), min_length=3, max_length=MOST_GYROS)
    apriori_G: list[list[Annotated[float, Field(ge=-100, le=100)]]]
    apriori_bias_deg_s: list[Annotated[float, Field(ge=-1e5, le=1e5)]] = Field(min_length=3, max_length=3)

    @field_validator("names")
    @classmethod
    def _named(cls, value: list[str]) -> list[str]:
        _check_names(tuple(value))
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
    maps: Literal["inertial to body"]
    quaternion: Literal["scalar last"]


class _OrbitHeader(_Model):
    period_s: float = Field(ge=1.0, le=1e9)  # nothing that a spacecraft flies
    altitude_km: float
    inclination_deg: float


class _IntervalHeader(_Model):
    name: str = Field(min_length=1)
    activity: str
    start_s: float
    stop_s: float
    forward: Literal["+x", "-x", "+y", "-y", "none"] | None = None
    gyros: list[str] | None = None


class _Header(_Model):
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
    def _of_its_format(self) -> _Header:
        if self.format == 1 and (tuple(self.gyro.names) != TRIAD or any(one.gyros is not None for one in self.interval)):
            raise ValueError("names of gyros, and gyros of an interval, need format = 2")
        return self


def spans(G: Array) -> bool:
    """Whether gyros with this G (3, gyros) see all three axes: the product of its singular values is not near zero."""
    return bool(np.sqrt(max(float(np.linalg.det(G @ G.T)), 0.0)) >= SMALLEST_DETERMINANT)


def rate_columns(names: Sequence[str]) -> tuple[str, ...]:
    """Columns of the gyros' rates on file."""
    return tuple(f"rate_{name}_deg_s" for name in names)


def _check_names(names: tuple[str, ...]) -> None:
    if names == TRIAD:
        return
    wrong = [name for name in names if not GYRO_NAME.fullmatch(name)]
    if wrong or len(set(names)) < len(names):
        raise ValueError(f"must be x, y and z, or different names of letters with digits at the end, such as g1; not {names}")


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


def load(folder: str | os.PathLike[str]) -> Recording:
    """Load and validate a recording.

    Parameters
    ----------
    folder : path of the recording's folder

    Raises
    ------
    InputError
        One line saying which file, where in it, and what is wrong.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder; a recording is a folder with recording.toml in it")
    with held(folder, shared=True):
        return _load(folder)


def _load(folder: Path) -> Recording:
    path = folder / "recording.toml"
    bounds.check_header(path)
    try:
        header = _Header.model_validate(read_toml(path))
    except ValidationError as error:
        raise InputError(f"{path}: {validation_message(error, _Header)}") from None
    names = tuple(header.gyro.names)
    switched = any(one.gyros is not None for one in header.interval)
    gyro_name, gyro = _read_table(folder, "gyro", ("t_s", *rate_columns(names)), () if not switched else rate_columns(names))
    attitude_name, attitude = "attitude", None
    if _find_table(folder, "attitude") is not None or names == TRIAD:
        attitude_name, attitude = _read_table(folder, "attitude", ("t_s", *QUATERNION_COLUMNS, *SIGMA_COLUMNS))
    tables = {name: _read_table(folder, name, ("t_s",))[1] for name in OPTIONAL_TABLES if _find_table(folder, name)}
    stream = GyroStream(
        t_s=_column(gyro, "t_s"),
        rates=np.deg2rad(_columns(gyro, rate_columns(names))),
        sample_s=header.gyro.sample_s,
        arw=float(np.deg2rad(header.gyro.arw_deg_per_sqrt_s)),
        apriori_G=np.array(header.gyro.apriori_G),
        apriori_bias=np.deg2rad(header.gyro.apriori_bias_deg_s),
        names=names,
    )
    attitudes = without_attitudes()
    if attitude is not None:
        attitudes = Attitudes(
            t_s=_column(attitude, "t_s"),
            quaternions=_columns(attitude, QUATERNION_COLUMNS),
            sigma=np.deg2rad(_columns(attitude, SIGMA_COLUMNS)),
        )
    sensors = _sensors(folder, tables)
    # Checked here first so that the message can name the file.
    checks = [(gyro_name, lambda: _check_gyro(stream))]
    checks += [] if attitude is None else [(attitude_name, lambda: _check_attitudes(attitudes))]
    for name, check in checks:
        try:
            check()
        except InputError as error:
            raise InputError(f"{folder / name}: {error}") from None
    try:
        return Recording(
            title=header.title,
            epoch=header.epoch,
            time_scale=header.time_scale,
            gyro=stream,
            attitudes=attitudes,
            intervals=tuple(
                Interval(i.name, i.activity, i.start_s, i.stop_s, i.forward, None if i.gyros is None else tuple(i.gyros))
                for i in header.interval
            ),
            orbit=Orbit(**header.orbit.model_dump()) if header.orbit else None,
            tables={name: table for name, table in tables.items() if name not in sensor_tables.known(tables)},
            sensors=sensors,
        )
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


def without_attitudes() -> Attitudes:
    """No reference attitudes at all."""
    return Attitudes(np.empty(0), np.empty((0, 4)), np.empty((0, 3)))


def save(recording: Recording, folder: str | os.PathLike[str]) -> None:
    """Write a recording; the folder is made, and an existing recording in it is replaced as a whole or, after an error, not."""
    from gyrocal.recording import parquet  # late, as pandas

    frames = _frames(recording)
    absent = [f"{name}.parquet" for name in ("gyro", "attitude", *OPTIONAL_TABLES) if name not in frames]
    text = [f"{name}.csv" for name in ("gyro", "attitude", *OPTIONAL_TABLES)]  # of a recording that was here before
    files = {f"{name}.parquet": partial(parquet.write, frame) for name, frame in frames.items()}
    header = _header_text(recording).encode()
    write_together(Path(folder), {**files, "recording.toml": lambda file: file.write(header)}, (*absent, *text))


def _frames(recording: Recording) -> dict[str, pd.DataFrame]:
    """The tables of a recording as they are on file."""
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    gyro, attitudes = recording.gyro, recording.attitudes
    columns = ["t_s", *rate_columns(gyro.names)]
    frames = {"gyro": pd.DataFrame(np.column_stack([gyro.t_s, np.rad2deg(gyro.rates)]), columns=columns)}
    if attitudes.t_s.size:
        frames["attitude"] = pd.DataFrame(
            np.column_stack([attitudes.t_s, attitudes.quaternions, np.rad2deg(attitudes.sigma)]),
            columns=["t_s", *QUATERNION_COLUMNS, *SIGMA_COLUMNS],
        )
    return {
        **frames,
        **recording.tables,
        **(sensor_tables.frames(recording.sensors) if recording.sensors is not None else {}),
    }


def toml_value(value: object) -> str:
    """One TOML value; floats with all their digits, so that what is read is what was written."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=True).replace("\x7f", "\\u007f")  # a JSON string is a TOML basic string
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, Iterable):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    raise TypeError(f"no TOML form for {value!r}")


def _header_text(recording: Recording) -> str:
    gyro = recording.gyro
    second = recording.is_array or any(interval.gyros is not None for interval in recording.intervals)
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
                **({"names": list(gyro.names)} if second else {}),
                "apriori_G": gyro.apriori_G.tolist(),
                "apriori_bias_deg_s": np.rad2deg(gyro.apriori_bias).tolist(),
            },
        ),
        ("[attitude]", {"maps": "inertial to body", "quaternion": "scalar last"}),
    ]
    if recording.orbit:
        sections.append(("[orbit]", {name: float(value) for name, value in vars(recording.orbit).items()}))
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


def _find_table(folder: Path, name: str) -> Path | None:
    found = [folder / (name + suffix) for suffix in (".parquet", ".csv") if (folder / (name + suffix)).exists()]
    if len(found) > 1:
        raise InputError(f"{folder}: both {name}.parquet and {name}.csv are there; keep the one that is meant")
    return found[0] if found else None


def _read_table(
    folder: Path, name: str, required: tuple[str, ...], with_holes: tuple[str, ...] = ()
) -> tuple[str, pd.DataFrame]:
    """A table and its file's name; columns with holes may hold what is not a number."""
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    from gyrocal.recording import csv_file

    path = _find_table(folder, name)
    if path is None:
        raise InputError(f"{folder}: neither {name}.parquet nor {name}.csv is there")
    bounds.check_table(path)
    try:
        frame = _read_parquet(path) if path.suffix == ".parquet" else csv_file.read(path)
    except pd.errors.EmptyDataError:
        raise InputError(f"{path}: the file is empty") from None
    except Exception as fault:  # pyarrow and pandas raise a zoo of types for a damaged file
        raise InputError(f"{path}: cannot be read: {' '.join(str(fault).split())}") from None
    missing = [column for column in required if column not in frame.columns]
    if missing:
        hint = ""
        close = [str(c) for c in frame.columns if any(str(c).startswith(m.rsplit("_deg", 1)[0]) for m in missing)]
        if len(frame.columns) == 1:
            hint = "; is the separator a comma?"
        elif close:
            hint = f"; found {', '.join(close)}: convert to the unit in the required name"
        else:
            hint = f"; found {', '.join(map(str, frame.columns))}"
        raise InputError(f"{path}: column {', '.join(missing)} is missing{hint}")
    if frame.empty:
        raise InputError(f"{path}: no rows")
    for column in required:
        if not pd.api.types.is_numeric_dtype(frame[column]) or pd.api.types.is_bool_dtype(frame[column]):
            raise InputError(f"{path}: column {column} holds {frame[column].dtype}, not numbers")
        bad = np.flatnonzero(~np.isfinite(frame[column].to_numpy(dtype=float)))
        if bad.size and column not in with_holes:
            raise InputError(
                f"{path}: column {column}, row {bad[0]}: not a finite number ({bad.size} such); drop or repair these rows"
            )
    return path.name, frame


def _read_parquet(path: Path) -> pd.DataFrame:
    from gyrocal.recording import parquet  # late, as pandas; and a recording in CSV does without it

    return parquet.read(path)


def _sensors(folder: Path, tables: Mapping[str, pd.DataFrame]) -> SensorTables | None:
    try:
        return sensor_tables.read(tables)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


def _column(frame: pd.DataFrame, name: str) -> Array:
    return frame[name].to_numpy(dtype=np.float64)


def _columns(frame: pd.DataFrame, names: tuple[str, ...]) -> Array:
    return np.ascontiguousarray(frame[list(names)].to_numpy(dtype=np.float64))


def _check_times(t_s: Array, what: str) -> None:
    if t_s.ndim != 1 or t_s.size == 0:
        raise InputError(f"{what}: no rows")
    if not np.isfinite(t_s).all():
        raise InputError(f"{what}: t_s row {np.flatnonzero(~np.isfinite(t_s))[0]} is not a finite number")
    back = np.flatnonzero(np.diff(t_s) <= 0)
    if back.size:
        row = back[0] + 1
        raise InputError(f"{what}: time goes backwards or repeats at row {row} (t_s {t_s[row - 1]} then {t_s[row]})")


def _check_gyro(gyro: GyroStream) -> None:
    _check_times(gyro.t_s, "gyro")
    try:
        _check_names(gyro.names)
    except ValueError as fault:
        raise InputError(f"gyro: names {fault}") from None
    gyros = len(gyro.names)
    if gyro.rates.shape != (gyro.t_s.size, gyros):
        raise InputError(f"gyro: rates must be {'three' if gyros == 3 else gyros} a sample")
    if gyro.apriori_G.shape != (3, gyros) or not spans(gyro.apriori_G):
        raise InputError(f"gyro: G must be 3×{gyros}, and the gyros' axes must not lie in one plane")
    if not gyro.sample_s > 0:
        raise InputError("gyro: sample_s must be positive")
    fast = np.flatnonzero(np.abs(gyro.rates).max(axis=1) > LARGEST_RATE)
    if fast.size:
        raise InputError(f"gyro: the rate in row {fast[0]} is beyond {np.rad2deg(LARGEST_RATE):g} deg/s; is the unit right?")
    spacing = np.diff(gyro.t_s)
    if spacing.size and abs(np.median(spacing) - gyro.sample_s) > 0.01 * gyro.sample_s:
        raise InputError(
            f"gyro: samples are {np.median(spacing):.6g} s apart, but sample_s is {gyro.sample_s:g}; is sample_s right?"
        )
    close = np.flatnonzero(spacing < 0.5 * gyro.sample_s)
    if close.size:
        row = close[0] + 1
        raise InputError(
            f"gyro: rows {row - 1} and {row} are only {spacing[row - 1]:.6g} s apart; sample_s is {gyro.sample_s:g}"
        )


def _check_attitudes(attitudes: Attitudes) -> None:
    _check_times(attitudes.t_s, "attitude")
    count = attitudes.t_s.size
    if attitudes.quaternions.shape != (count, 4) or attitudes.sigma.shape != (count, 3):
        raise InputError("attitude: four quaternion elements and three sigmas a row are needed")
    norms = np.linalg.norm(attitudes.quaternions, axis=1)
    bad = np.flatnonzero(~(np.abs(norms - 1) <= NORM_TOLERANCE))
    if bad.size:
        raise InputError(
            f"attitude: quaternion in row {bad[0]} has norm {norms[bad[0]]:.9g}, not 1 ({bad.size} such); normalise them"
        )
    bad = np.flatnonzero(~((attitudes.sigma >= SIGMA_RANGE[0]) & (attitudes.sigma <= SIGMA_RANGE[1])).all(axis=1))
    if bad.size:
        low, high = np.rad2deg(SIGMA_RANGE)
        raise InputError(f"attitude: sigma in row {bad[0]} is not within {low:g} and {high:g} deg")


def _check_intervals(intervals: tuple[Interval, ...]) -> None:
    if not intervals:
        raise InputError("no [[interval]] is given")
    names = [interval.name for interval in intervals]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InputError(f"interval name {', '.join(repeated)} is used more than once")
    for interval in intervals:
        if interval.forward not in (None, *FORWARD):
            raise InputError(f"interval {interval.name}: forward {interval.forward} must be one of {', '.join(FORWARD)}")
        if not interval.stop_s > interval.start_s:
            raise InputError(f"interval {interval.name}: stop_s {interval.stop_s} is not after start_s {interval.start_s}")
    ordered = sorted(intervals, key=lambda interval: interval.start_s)
    for first, second in pairwise(ordered):
        if second.start_s < first.stop_s - TIME_TOLERANCE_S:
            raise InputError(
                f"intervals {first.name} and {second.name} overlap: "
                f"{second.name} starts at {second.start_s} s, before {first.name} stops at {first.stop_s} s"
            )


def _check_switched_on(gyro: GyroStream, intervals: tuple[Interval, ...]) -> None:
    """Gyros that are on have finite rates, and see all three axes."""
    switched = any(interval.gyros is not None for interval in intervals)
    if not switched and not np.isfinite(gyro.rates).all():
        raise InputError("gyro: rates must be finite numbers")
    for interval in intervals if switched else ():
        chosen = gyro.names if interval.gyros is None else interval.gyros
        unknown = [name for name in chosen if name not in gyro.names]
        if unknown:
            raise InputError(f"interval {interval.name}: no gyro {', '.join(unknown)}; there are {', '.join(gyro.names)}")
        columns = [k for k, name in enumerate(gyro.names) if name in chosen]
        if len(columns) < 3 or not spans(np.linalg.pinv(np.linalg.pinv(gyro.apriori_G)[columns])):
            raise InputError(f"interval {interval.name}: its gyros {', '.join(chosen)} do not see all three axes")
        used = (gyro.t_s > interval.start_s - gyro.sample_s + TIME_TOLERANCE_S) & (
            gyro.t_s < interval.stop_s - TIME_TOLERANCE_S
        )
        bad = np.flatnonzero(used & ~np.isfinite(gyro.rates[:, columns]).all(axis=1))
        if bad.size:
            raise InputError(f"interval {interval.name}: gyro row {bad[0]} is not a finite number of a gyro that is on")


def reference_rows(t_s: Array, interval: Interval) -> NDArray[np.intp]:
    """Indices of the reference attitudes inside an interval, both ends included."""
    inside = (t_s >= interval.start_s - TIME_TOLERANCE_S) & (t_s <= interval.stop_s + TIME_TOLERANCE_S)
    return np.flatnonzero(inside)


def _check_references(t_s: Array, intervals: tuple[Interval, ...]) -> None:
    used = np.zeros(t_s.size, dtype=bool)
    for interval in intervals:
        rows = reference_rows(t_s, interval)
        used[rows] = True
        if rows.size < 2:
            raise InputError(
                f"interval {interval.name}: {rows.size} reference attitude(s) inside "
                f"[{interval.start_s}, {interval.stop_s}] s; at least two are needed, the first one to start from"
            )
    if not used.all():
        row = np.flatnonzero(~used)[0]
        raise InputError(
            f"attitude row {row}: reference at t_s = {t_s[row]} lies outside every interval; "
            "widen the interval it belongs to or drop it"
        )
