"""The trials: where they are, which belong to one sensor unit, and each as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import model_validator

from gyrocal import Attitudes, InputError, Recording
from gyrocal.recording import reference_rows
from studies.montecarlo.study import GridConfig
from studies.validation import broad

Row = dict[str, Any]  # of the study's table

ROOT = Path(__file__).parents[3]
FOLDER = "../shared/real/broad"
UNITS: dict[str, tuple[str, ...]] = {"A": ("04",), "B": ("02", "05", "07", "09", "18"), "C": ("03", "24")}


class RealConfig(GridConfig):
    """Where the trials are and which belong together.

    Attributes
    ----------
    folder : of the trials; a relative one counts from the repository
    units : numbers that the files' names begin with, by sensor unit
    spacing_s : s between the references of an interval
    floor_replays : simulated repetitions of each trial
    """

    axes: ClassVar = ("units",)
    folder: str = FOLDER
    units: dict[str, tuple[str, ...]] = UNITS
    spacing_s: float = 1.0
    floor_replays: int = 4

    @model_validator(mode="after")
    def _usable(self) -> Self:
        for unit, numbers in self.units.items():
            for number in numbers:
                if len(self.files(number)) != 1:
                    raise ValueError(
                        f"no trial {number} of unit {unit} in {self.path}; the BROAD trials are not part of this project "
                        "(docs/broad.md says where they come from), point folder at them"
                    )
        return self

    def points(self) -> list[str]:
        """Unit of each case."""
        return sorted(self.units)

    @property
    def path(self) -> Path:
        """The folder."""
        return (ROOT / self.folder).resolve()

    def files(self, number: str) -> list[Path]:
        """The files of a trial's number."""
        return sorted(self.path.glob(f"{number}_*.parquet"))


@dataclass(frozen=True)
class Loaded:
    """A trial, or some intervals of it.

    Attributes
    ----------
    number : of the trial
    trial : as it is on file
    recording : the same as a recording, tags and samples untouched
    """

    number: str
    trial: broad.Trial
    recording: Recording

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the intervals with motion."""
        return tuple(interval.name for interval in self.recording.intervals if interval.activity != "rest")

    @cached_property
    def first_rest(self) -> slice:
        """Samples of the first rest."""
        for first, stop in broad.runs(self.trial.still):
            if (stop - first) * self.trial.sample_s >= broad.SHORTEST_REST_S:
                return slice(first, stop)
        raise InputError(f"{self.trial.name}: no rest of {broad.SHORTEST_REST_S:g} s to take the bias from")

    def only(self, names: Sequence[str]) -> Loaded:
        """With some of the intervals."""
        kept = tuple(interval for interval in self.recording.intervals if interval.name in names)
        own = self.recording.attitudes
        rows = np.unique(np.concatenate([reference_rows(own.t_s, interval) for interval in kept]))
        attitudes = Attitudes(own.t_s[rows], own.quaternions[rows], own.sigma[rows])
        return replace(self, recording=replace(self.recording, intervals=kept, attitudes=attitudes))

    def seen(self, recording: Recording) -> Loaded:
        """With another recording of the same motion, cut to the intervals of this one."""
        times = self.recording.attitudes.t_s
        rows = np.searchsorted(recording.attitudes.t_s, times - 1e-9)
        own = recording.attitudes
        attitudes = Attitudes(times, own.quaternions[rows], self.recording.attitudes.sigma)
        return replace(self, recording=replace(self.recording, gyro=recording.gyro, attitudes=attitudes))


def load(config: RealConfig, number: str) -> Loaded:
    """A trial by its number."""
    trial = broad.read(config.files(number)[0])
    return Loaded(number, trial, broad.to_recording(trial, spacing_s=config.spacing_s).recording)
