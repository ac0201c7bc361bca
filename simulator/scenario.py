"""Scenarios: what to simulate, as a validated TOML document.

A scenario is in degrees and seconds, with the unit in each name; the objects it is turned into are in radians. Times of
slews and holds count from their interval's start. A file may name a ``base`` and give only what differs: tables are merged,
arrays (such as the list of intervals) are replaced whole.

    >>> from simulator.scenario import load, override
    >>> scenario = override(load("trmm"), {"gyro.arw_deg_per_sqrt_s": 1e-4, "interval.1.slew.0.start_s": 200.0})
    >>> scenario.gyro.arw_deg_per_sqrt_s
    0.0001
"""

import os
from collections.abc import Mapping
from datetime import datetime
from importlib import resources
from itertools import pairwise
from math import radians
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator

from gyrocal.errors import InputError, suggest_names
from gyrocal.recording import format_validation_error, read_toml
from simulator.truth.maneuvers import MODE_YAW, Hold, Profile, Slew, Sway
from simulator.truth.orbit import CircularOrbit

# Strict mode would refuse TOML's lists for tuples; what is in them stays strict.
Vector = Annotated[tuple[float, float, float], Field(strict=False)]
Matrix = Annotated[tuple[Vector, Vector, Vector], Field(strict=False)]


def _check_positive(value: Vector) -> Vector:
    if min(value) <= 0:
        raise ValueError("must be positive")
    return value


PositiveVector = Annotated[Vector, AfterValidator(_check_positive)]

SCENARIOS = resources.files("simulator") / "scenarios"
TOUCH_TOLERANCE = 1e-6  # s; intervals closer than this touch
JOIN_TOLERANCE = 1e-8  # attitude matrix elements of two intervals that touch
MOST_SAMPLES = 2e7
ADOPTED_TABLES = ("replay", "effect", "posterior")  # tables of `simulator.adopted_scenario`
MOST_BASES = 30  # of a scenario, one of the other
SMALLEST_DETERMINANT = 1e-3  # of a G that counts as invertible


class Section(BaseModel):
    """A table of a document: nothing else may stand in it."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class OrbitSection(Section):
    """Circular orbit."""

    altitude_km: float = Field(gt=100, le=1e6)
    inclination_deg: float = Field(ge=0, le=180)
    raan_deg: float = 0.0
    argument_of_latitude_deg: float = 0.0
    j2: bool = False
    nadir: Literal["geocentric", "geodetic"] = "geocentric"

    def build_circular_orbit(self) -> CircularOrbit:
        """Build the orbit in metres and radians."""
        return CircularOrbit(
            altitude=1e3 * self.altitude_km,
            inclination=radians(self.inclination_deg),
            node=radians(self.raan_deg),
            latitude_argument=radians(self.argument_of_latitude_deg),
            j2=self.j2,
            geodetic=self.nadir == "geodetic",
        )


class GyroSection(Section):
    """True and a-priori gyro parameters, sampling and noise.

    ``reading`` is what a sample shows: the mean rate over it, or the rate at its start.
    """

    sample_s: float = Field(ge=1e-3, le=1e4)
    reading: Literal["mean", "point"] = "mean"
    arw_deg_per_sqrt_s: float = Field(ge=0, le=1e3)
    true_G: Matrix
    true_bias_deg_s: Vector
    apriori_G: Matrix
    apriori_bias_deg_s: Vector

    @field_validator("true_G", "apriori_G")
    @classmethod
    def _validate_invertible(cls, value: Matrix) -> Matrix:
        if abs(np.linalg.det(np.array(value))) < SMALLEST_DETERMINANT:
            raise ValueError("must be invertible")
        return value


class ReferenceSection(Section):
    """Times of the reference attitudes, and their standard deviation about each body axis."""

    at: Literal["ends", "series"] = "ends"
    every_s: float | None = Field(default=None, ge=1e-3, validate_default=True)
    sigma_deg: PositiveVector

    @field_validator("every_s")
    @classmethod
    def _validate_spacing(cls, value: float | None, info: ValidationInfo) -> float | None:
        if info.data.get("at") == "series" and value is None:
            raise ValueError('is required with at = "series"')
        return value


class SensorsSection(Section):
    """Raw measurements of the nominal sun and Earth sensors; noise is white, 1-sigma of each angle."""

    every_s: float = Field(ge=1e-3, le=1e5)
    sun_noise_deg: float = Field(default=0.005, ge=0, le=10)
    earth_noise_deg: float = Field(default=0.02, ge=0, le=10)


class ControlMotionSection(Section):
    """Sinusoidal attitude motion about each body axis; the phases hold at the epoch."""

    amplitude_deg: Vector
    period_s: PositiveVector
    phase_deg: Vector = (0.0, 0.0, 0.0)


class SlewSection(Section):
    """A turn about a body axis."""

    axis: Vector
    angle_deg: float = Field(ge=-3600, le=3600)
    start_s: float = Field(ge=0)
    duration_s: float = Field(gt=0)
    ramp_fraction: float = Field(default=0.5, gt=0, le=0.5)

    @field_validator("axis")
    @classmethod
    def _validate_axis(cls, value: Vector) -> Vector:
        if not 1e-6 < np.linalg.norm(value) < 1e6:
            raise ValueError("must have a length between 1e-6 and 1e6; it is normalised")
        return value

    def slew(self) -> Slew:
        """Build the slew in radians, its axis normalised."""
        axis = np.array(self.axis) / np.linalg.norm(self.axis)
        return Slew(axis, radians(self.angle_deg), self.start_s, self.duration_s, self.ramp_fraction)


class HoldSection(Section):
    """An inertial hold, its two transitions included."""

    start_s: float = Field(ge=0)
    stop_s: float
    transition_s: float = Field(gt=0)
    offset_deg: Vector = (0.0, 0.0, 0.0)

    @field_validator("transition_s")
    @classmethod
    def _validate_transitions(cls, value: float, info: ValidationInfo) -> float:
        if {"start_s", "stop_s"} <= info.data.keys() and 2 * value > info.data["stop_s"] - info.data["start_s"]:
            raise ValueError("two transitions do not fit between start_s and stop_s")
        return value


class IntervalSection(Section):
    """One calibration interval; ``mode`` is the body axis along the velocity at its start."""

    name: str = Field(min_length=1)
    activity: str
    start_s: float
    stop_s: float
    mode: Literal["+x", "-x", "+y", "-y"]
    slew: Annotated[tuple[SlewSection, ...], Field(strict=False)] = ()
    hold: HoldSection | None = None

    @field_validator("stop_s")
    @classmethod
    def _validate_stop(cls, value: float, info: ValidationInfo) -> float:
        if "start_s" in info.data and not value > info.data["start_s"]:
            raise ValueError("must be after start_s")
        return value

    @field_validator("slew")
    @classmethod
    def _validate_slews(cls, value: tuple[SlewSection, ...], info: ValidationInfo) -> tuple[SlewSection, ...]:
        length = info.data.get("stop_s", np.inf) - info.data.get("start_s", 0.0)
        spans = [(slew.start_s, slew.start_s + slew.duration_s) for slew in value]
        ends = [(k, stop) for k, (_, stop) in enumerate(spans) if stop > length]
        faults = [f"slew {k} ends at {stop:g} s, after the interval's {length:g} s" for k, stop in ends]
        faults += [
            f"slew {k + 1} starts at {second[0]:g} s, before slew {k} ends at {first[1]:g} s"
            for k, (first, second) in enumerate(pairwise(spans))
            if second[0] < first[1]
        ]
        if faults:
            raise ValueError(", ".join(faults))
        return value

    @field_validator("hold")
    @classmethod
    def _validate_hold(cls, value: HoldSection | None, info: ValidationInfo) -> HoldSection | None:
        if value is None:
            return value
        length = info.data.get("stop_s", np.inf) - info.data.get("start_s", 0.0)
        faults = [f"ends at {value.stop_s:g} s, after the interval's {length:g} s"] if value.stop_s > length else []
        faults += [
            f"overlaps slew {k}"
            for k, slew in enumerate(info.data.get("slew", ()))
            if slew.start_s < value.stop_s and slew.start_s + slew.duration_s > value.start_s
        ]
        if faults:
            raise ValueError(", ".join(faults))
        return value

    def build_profile(self, orbit: CircularOrbit, sway: Sway | None = None) -> Profile:
        """Build the interval's motion in radians."""
        slews = tuple(section.slew() for section in self.slew)
        hold = None
        if self.hold:
            offset = np.deg2rad(self.hold.offset_deg)
            hold = Hold(self.hold.start_s, self.hold.stop_s, self.hold.transition_s, offset)
        return Profile(orbit, self.start_s, self.stop_s, MODE_YAW[self.mode], slews, hold, sway)


class Scenario(Section):
    """Everything a simulation needs but the random numbers."""

    title: str
    epoch: str
    time_scale: str = "UTC"
    orbit: OrbitSection
    gyro: GyroSection
    reference: ReferenceSection
    control_motion: ControlMotionSection | None = None
    sensors: SensorsSection | None = None
    interval: Annotated[tuple[IntervalSection, ...], Field(strict=False, min_length=1)]

    @field_validator("epoch")
    @classmethod
    def _validate_epoch(cls, value: str) -> str:
        datetime.fromisoformat(value)
        return value

    @field_validator("interval")
    @classmethod
    def _validate_intervals(cls, value: tuple[IntervalSection, ...], info: ValidationInfo) -> tuple[IntervalSection, ...]:
        if "gyro" in info.data:
            samples = sum(section.stop_s - section.start_s for section in value) / info.data["gyro"].sample_s
            if samples > MOST_SAMPLES:
                raise ValueError(f"{samples:.3g} gyro samples are more than the {MOST_SAMPLES:.0e} that fit in memory")
        names = [interval.name for interval in value]
        repeated = sorted({name for name in names if names.count(name) > 1})
        faults = [f"name {name} is used more than once" for name in repeated]
        for first, second in pairwise(value):
            gap = second.start_s - first.stop_s
            if gap < -TOUCH_TOLERANCE:
                faults.append(f"{second.name} starts before {first.name} stops; intervals must be in time order")
            elif gap <= TOUCH_TOLERANCE and {"orbit", "gyro"} <= info.data.keys():
                orbit = info.data["orbit"].build_circular_orbit()
                faults += _find_joining_faults(first, second, orbit, info.data["gyro"].sample_s)
        if faults:
            raise ValueError(", ".join(faults))
        return value


def _find_joining_faults(first: IntervalSection, second: IntervalSection, orbit: CircularOrbit, sample_s: float) -> list[str]:
    """Find faults that interrupt the attitude or the samples where two intervals touch."""
    faults = []
    samples = (first.stop_s - first.start_s) / sample_s
    if abs(samples - round(samples)) * sample_s > TOUCH_TOLERANCE:
        faults.append(f"{second.name} touches {first.name}, which is not a whole number of samples long")
    before, after = first.build_profile(orbit), second.build_profile(orbit)
    end = before.compute_tracking_attitude(np.array([before.stop_s - before.start_s]))
    if np.abs(end - after.compute_tracking_attitude(np.zeros(1))).max() > JOIN_TOLERANCE:
        faults.append(f"{second.name} touches {first.name} but starts in another attitude than the one it ends in")
    return faults


def names() -> tuple[str, ...]:
    """List the names of the built-in scenarios."""
    return tuple(sorted(entry.name[:-5] for entry in SCENARIOS.iterdir() if entry.name.endswith(".toml")))


def read_text(name: str) -> str:
    """Read the TOML of a built-in scenario, as it is on file."""
    if name not in names():
        raise InputError(f"{name}: no built-in scenario; {suggest_names(name, names())}")
    return (SCENARIOS / f"{name}.toml").read_text(encoding="utf-8")


def load(name_or_path: str | os.PathLike[str]) -> Scenario:
    """Load a scenario by its built-in name or from a TOML file.

    Raises
    ------
    InputError
        There is no such scenario, one line with every fault of it by its path in the document, or it holds effects.
    """
    name, values = os.fspath(name_or_path), load_document(name_or_path)
    adopted_keys = [key for key in ADOPTED_TABLES if key in values]
    if adopted_keys:
        raise InputError(
            f"{name}: holds [{adopted_keys[0]}], which 'gyrocal simulate' and 'gyrocal compare' fly: only a plan fits here"
        )
    return validate_scenario(values, name)


def load_document(name_or_path: str | os.PathLike[str]) -> dict[str, Any]:
    """Load a scenario's document as it stands, bases merged in and not validated; arguments and errors as of `load`."""
    return _merge_bases(os.fspath(name_or_path), Path(), ())


def override(scenario: Scenario, values: Mapping[str, object]) -> Scenario:
    """Replace some values of a scenario, and validate it again as a whole.

    An `InputError` if a path leads nowhere, or the result is not a valid scenario.

    Parameters
    ----------
    scenario : the one to start from, left as it is
    values : by dotted path, list items by their index, e.g. ``{"interval.1.slew.0.start_s": 200.0}``
    """
    changed = _convert_to_lists(scenario.model_dump(exclude_none=True))
    for path, value in values.items():
        _assign(changed, path, value)
    return validate_scenario(changed, "override")


def build_profiles(scenario: Scenario) -> tuple[Profile, ...]:
    """Build the motion of each interval, in radians."""
    orbit = scenario.orbit.build_circular_orbit()
    sway, control = None, scenario.control_motion
    if control:
        sway = Sway(np.deg2rad(control.amplitude_deg), np.array(control.period_s), np.deg2rad(control.phase_deg))
    return tuple(interval.build_profile(orbit, sway) for interval in scenario.interval)


def validate_scenario(values: dict[str, Any], source: str) -> Scenario:
    """Validate a document as a scenario; one `InputError` with every fault, which names the source."""
    try:
        return Scenario.model_validate(values)
    except ValidationError as error:
        raise InputError(f"{source}: {format_validation_error(error, Scenario)}") from None


def _merge_bases(name: str, folder: Path, inside: tuple[str, ...]) -> dict[str, Any]:
    """Merge a scenario's bases into its document; inside are the identities of the scenarios on the way here."""
    path = folder / name
    identity = name if name in names() else str(path.resolve())
    if identity in inside:
        raise InputError(f"{name}: scenario bases form a circle: {' -> '.join((*inside, identity))}")
    if len(inside) > MOST_BASES:
        raise InputError(f"{inside[0]}: more than {MOST_BASES} scenarios are one another's base; write what they say into one")
    if name in names():
        with resources.as_file(SCENARIOS / f"{name}.toml") as builtin:
            document = read_toml(builtin)
    elif path.is_file():
        document = read_toml(path)
    elif path.is_dir():
        raise InputError(f"{name}: is a folder; a scenario is wanted here: a TOML file, or one of {', '.join(names())}")
    else:
        raise InputError(f"{name}: neither a file nor a built-in scenario; {suggest_names(name, names())}")
    base = document.pop("base", None)
    if base is None:
        return document
    if not isinstance(base, str):
        raise InputError(f"{name}: base must be the name or path of a scenario")
    return _merge_tables(_merge_bases(base, path.parent, (*inside, identity)), document)


def _merge_tables(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """Merge tables, replace all else."""
    out = {**base, **changes}
    for key in base.keys() & changes.keys():
        if isinstance(base[key], dict) and isinstance(changes[key], dict):
            out[key] = _merge_tables(base[key], changes[key])
    return out


def _convert_to_lists(value: Any) -> Any:
    """Convert tuples of a document to lists, so that items can be replaced."""
    if isinstance(value, dict):
        return {key: _convert_to_lists(item) for key, item in value.items()}
    return [_convert_to_lists(item) for item in value] if isinstance(value, tuple) else value


def _assign(document: dict[str, Any], path: str, value: object) -> None:
    """Set one value; a key that no section knows is left to the validation to refuse."""
    *parents, last = path.split(".")
    place: Any = document
    for key in parents:
        place = place.setdefault(key, {}) if isinstance(place, dict) else _select_item(place, key, path)
    if isinstance(place, dict):
        place[last] = value
    else:
        _select_item(place, last, path)
        place[int(last)] = value


def _select_item(place: Any, key: str, path: str) -> Any:
    if not isinstance(place, list):
        raise InputError(f"{path}: there is no such value; {key} would be inside a single value")
    if not key.isdecimal() or int(key) >= len(place):
        raise InputError(f"{path}: {key} is not the index of one of {len(place)} items, counted from 0")
    return place[int(key)]
