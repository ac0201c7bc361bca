"""The trials: where they are, which belong to one sensor unit, and each as a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from diagnosis.detectors.gap_interpolation import filled
from diagnosis.detectors.lattice import lattice_step
from diagnosis.detectors.samples import examine
from gyrocal import Attitudes, InputError, Recording
from gyrocal.importing.rests import runs
from gyrocal.recording import reference_rows
from studies.montecarlo.study import GridConfig
from studies.validation import broad

Array = NDArray[np.float64]
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
    whole : the same with one interval over everything tracked, for tests of the samples
    filled : (n,) samples that those tests find stale
    """

    number: str
    trial: broad.Trial
    recording: Recording
    whole: Recording
    filled: NDArray[np.bool_]

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the intervals with motion."""
        return tuple(interval.name for interval in self.recording.intervals if interval.activity != "rest")

    @property
    def repeats(self) -> NDArray[np.bool_]:
        """(n,) samples that repeat the one before on all axes."""
        rates = self.recording.gyro.rates
        return np.append(False, (rates[1:] == rates[:-1]).all(axis=1))

    @property
    def stale(self) -> NDArray[np.bool_]:
        """(n,) repeats that are more than chance by the tests of the samples."""
        return self.repeats & self.filled

    def repaired(self, cut: bool, bridged: bool) -> Array:
        """(n, 3) raw rates, rad/s: those cut toward zero put in the middle of what they stand for, stale samples bridged.

        Half a step for each reading is exact on average in motion, and needs no noise level, which cut readings hide at rest.
        """
        gyro = self.recording.gyro
        step = np.array([lattice_step(gyro.rates[:, axis]) for axis in range(3)])
        on_lattice = cut & (step > 0)
        counts = np.rint(gyro.rates[:, on_lattice] / step[on_lattice])
        rates = gyro.rates.copy()
        rates[:, on_lattice] += 0.5 * step[on_lattice] * np.sign(counts)
        return filled(gyro.t_s, rates, self.stale, gyro.sample_s)[0] if bridged else rates

    @cached_property
    def first_rest(self) -> slice:
        """Samples of the first rest, as far as they are inside the whole interval."""
        for first, stop in runs(self.trial.still & (self.trial.t_s >= self.whole.intervals[0].start_s)):
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

    def flown_again(self, rates: Array, attitudes: Attitudes) -> Loaded:
        """With other samples, and other attitudes at the references' times among those given."""
        own = self.recording.attitudes
        rows = np.searchsorted(attitudes.t_s, own.t_s - 1e-9)
        seen = Attitudes(own.t_s, attitudes.quaternions[rows], own.sigma)
        gyro = replace(self.recording.gyro, rates=rates)
        whole = replace(self.whole, gyro=gyro)
        recording = replace(self.recording, gyro=gyro, attitudes=seen)
        return replace(self, recording=recording, whole=whole, filled=examine(whole).filled)


def load(config: RealConfig, number: str) -> Loaded:
    """A trial by its number."""
    trial = broad.read(config.files(number)[0])
    cut, whole = (broad.to_recording(trial, how, config.spacing_s).recording for how in ("motion", "whole"))
    return Loaded(number, trial, cut, whole, examine(whole).filled)
