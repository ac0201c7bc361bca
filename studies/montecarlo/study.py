"""A study: a configuration, and a function from it, a case number and random streams to a row. See docs/studies.md.

A worker imports the study by its name, and needs nothing but the name, the configuration as JSON and a range of case numbers. A
case may draw from its streams only, so that its row depends on the configuration and its number alone.

A result is identified by the *resolved* configuration, which has the scenario's content in place of its name or path: a changed
scenario file is noticed, and a worker need not read it.
"""

import hashlib
import importlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator, model_validator

from gyrocal.errors import InputError, suggest_names
from gyrocal.recording import Recording, format_validation_error, read_toml
from simulator import scenario as scenarios
from simulator.scenario import Scenario
from simulator.simulate import motion, observe
from simulator.streams import MAX_CASE, generator
from simulator.truth.motion import Motion
from studies.montecarlo import dispersions
from studies.montecarlo.dispersions import Correlation, Dispersion, Sampler

Scalar = bool | int | float | str
Row = Mapping[str, Any]
RESERVED = ("case", "error")  # columns of every table
DISPERSED = "disp:"  # begins the columns of the dispersed values


class StudyConfig(BaseModel):
    """Settings of every study; a study adds its own fields, each with a default.

    Attributes
    ----------
    cases : number of cases
    entropy : root of all random streams
    scenario : built-in name or path of the scenario, or the scenario itself
    overrides : scenario values to replace, by their dotted paths
    dispersions : distributions of scenario values, by their dotted paths; applied after the overrides
    sampler : how the draws of the dispersions cover their space
    correlations : of the draws, each a matrix between some of their paths
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    cases: int = 200
    entropy: int = 1998
    scenario: str | Scenario = "trmm"
    overrides: dict[str, Scalar] = {}
    dispersions: dict[str, Dispersion] = {}
    sampler: Sampler = "random"
    correlations: tuple[Correlation, ...] = ()

    # Not as constraints of the fields: a study with another default would lose them.
    @field_validator("cases", "entropy")
    @classmethod
    def _check_range(cls, value: int, info: ValidationInfo) -> int:
        if info.field_name == "cases" and not 1 <= value <= MAX_CASE:
            raise ValueError(f"must be between 1 and {MAX_CASE}")
        if value < 0:
            raise ValueError("must not be negative")
        return value


class GridConfig(StudyConfig):
    """Settings of a study over a grid: a case is a point of the grid, so that the axes determine the number of cases.

    Attributes
    ----------
    axes : names of the settings that make the grid, the slowest first
    cases : points of the grid; not a setting
    """

    axes: ClassVar[tuple[str, ...]]
    cases: int = Field(default=0, exclude=True)

    def points(self) -> Sequence[Any]:
        """List the points in the order of the cases: all combinations of the axes' values."""
        return list(product(*(getattr(self, name) for name in self.axes)))

    @model_validator(mode="after")
    def _set_cases(self) -> Self:
        if self.dispersions:
            raise ValueError("dispersions: the points of a grid are not dispersed; change the scenario by overrides")
        points = len(self.points())
        if "cases" in self.model_fields_set and self.cases != points:
            raise ValueError(f"cases: the grid has {points} points, one a case; change them by {' and '.join(self.axes)}")
        self.__dict__["cases"] = points  # the model is frozen, and only here is the number known
        return self


Config = TypeVar("Config", bound=StudyConfig)


@dataclass(frozen=True)
class Streams:
    """Random streams of one case, by their purpose."""

    entropy: int
    case: int

    def generator(self, name: str) -> np.random.Generator:
        """Make a generator at the start of the named stream, which depends on no other stream."""
        return generator(self.entropy, self.case, name)


@dataclass(frozen=True)
class Study:
    """A study.

    Attributes
    ----------
    name, config : where to import it from, "module:attribute"; type of its configuration
    case : (config, case, streams) to the case's row, or to several rows; values are numbers, truth values, text or None
    recording : (config, case, streams) to the recording the case works on, for a study whose recordings can be kept
    """

    name: str
    config: type[StudyConfig]
    case: Callable[[Any, int, Streams], Row | Sequence[Row]]
    recording: Callable[[Any, int, Streams], Recording] | None = None


def find(name: str, folder: str = "") -> Study:
    """Import the study of a name "module:attribute", also from another folder; `InputError` if that fails."""
    module, _, attribute = name.partition(":")
    if folder and folder not in sys.path:
        sys.path.append(folder)
    try:
        study = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"study {name}: cannot be imported ({error}); a study's name is module:attribute") from None
    if not isinstance(study, Study) or study.name != name or module == "__main__":
        raise InputError(f"study {name}: what stands there is not the study of that name")
    return study


def find_study_folder(study: Study) -> str:
    """Find the folder of a study whose module is a single file; empty for a module of a package."""
    module = study.name.partition(":")[0]
    file = getattr(sys.modules.get(module), "__file__", None)
    return str(Path(file).resolve().parent) if file and "." not in module else ""


def load_config(study: Study, path: Path | None = None, changes: Mapping[str, Any] | None = None) -> Any:
    """Load the configuration of a study: its defaults, a TOML file over them, single values over both.

    Values of overrides and dispersions may be given by the path in the scenario, e.g.
    ``{"cases": 50, "overrides.gyro.sample_s": 1.0, "dispersions.gyro.true_G.0.0": {"kind": "normal", "sigma": 1e-3}}``.
    `InputError` with every fault in one line.
    """
    # Replaced defaults need not be valid, such as a missing folder.
    document = study.config.model_construct().model_dump(mode="json") | (read_toml(path) if path else {})
    for setting, value in (changes or {}).items():
        name, _, key = setting.partition(".")
        if name not in study.config.model_fields:
            raise InputError(f"{setting}: there is no such setting; {suggest_names(name, study.config.model_fields)}")
        if not key:
            document[name] = value
        elif isinstance(document[name], dict):
            document[name] = document[name] | {key: value}
        else:
            raise InputError(f"{setting}: there is no such setting; give {name} as a whole")
    source = " with ".join([*([str(path)] if path else []), *(["settings"] if changes else [])]) or study.name
    # As JSON, since strict validation would refuse TOML's lists for tuples.
    try:
        return study.config.model_validate_json(json.dumps(document))
    except TypeError as error:
        raise InputError(f"{source}: {error}") from None
    except ValidationError as error:
        raise InputError(f"{source}: {format_validation_error(error, study.config)}") from None


def resolve_config(config: Config) -> Config:
    """Replace the scenario's name by its content with overrides applied; `InputError` if that is not valid."""
    scenario = load_base_scenario(config)
    dispersions.check(config.dispersions, scenario, config.correlations)
    return config.model_copy(update={"scenario": scenario, "overrides": {}})


def hash_config(study: Study, config: StudyConfig) -> str:
    """Compute the SHA-256 of a study's name and resolved configuration, as canonical JSON."""
    document = config.model_dump(mode="json") | {"cases": config.cases}
    # Sorted keys must not hide the order of the dispersions, on which the Sobol dimensions depend.
    document["dispersions"] = list(document["dispersions"].items())
    text = json.dumps({"study": study.name, "config": document}, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


def load_base_scenario(config: StudyConfig) -> Scenario:
    """Load the scenario with its overrides, before any dispersion."""
    scenario = scenarios.load(config.scenario) if isinstance(config.scenario, str) else config.scenario
    return scenarios.override(scenario, config.overrides) if config.overrides else scenario


def draw_case_values(config: StudyConfig, case: int) -> dict[str, float]:
    """Draw the scenario's dispersed values in one case, by path."""
    if not config.dispersions:
        return {}
    return dispersions.draw_values(config, load_base_scenario(config), case)


def dispersed(config: StudyConfig, case: int) -> Scenario:
    """Build the scenario of one case with overrides and dispersions; `InputError` if the drawn values are not valid."""
    values = draw_case_values(config, case)
    scenario = load_base_scenario(config)
    return scenarios.override(scenario, values) if values else scenario


def simulate_case_motion(scenario: Scenario) -> Motion:
    """Simulate the noise-free motion of a scenario, cached while nothing that moves is dispersed.

    The gyro's parameters and the noise levels, on which the motion does not depend, are set to constants for the cache.
    """
    unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    zero = (0.0, 0.0, 0.0)
    fixed = {
        "true_G": unit,
        "apriori_G": unit,
        "true_bias_deg_s": zero,
        "apriori_bias_deg_s": zero,
        "arw_deg_per_sqrt_s": 0.0,
    }
    gyro = scenario.gyro.model_copy(update=fixed)
    reference = scenario.reference.model_copy(update={"sigma_deg": (1.0, 1.0, 1.0)})
    return _simulate_cached_motion(scenario.model_copy(update={"gyro": gyro, "reference": reference}))


@lru_cache(maxsize=2)
def _simulate_cached_motion(scenario: Scenario) -> Motion:
    return motion(scenario)


def observed(config: StudyConfig, case: int, streams: Streams) -> Recording:
    """Simulate the recording of one case: its scenario, dispersions applied, with noise from its own two streams."""
    scenario = dispersed(config, case)
    gyro, reference = streams.generator("gyro_noise"), streams.generator("reference_noise")
    return observe(scenario, simulate_case_motion(scenario), gyro_rng=gyro, reference_rng=reference)
