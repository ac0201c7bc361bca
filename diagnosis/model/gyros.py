"""The linear model of several gyros: their parity beside the attitude, and every effect gyro by gyro.

Where gyro i reads high by f(t), the body rates G ω_raw are high by G_i f, which the attitude shows, and the parity by V_i f,
which shows without any attitude. Both are observations of one linear model: attitude rows, then parity rows, whose noise is
uncorrelated (`gyrocal.recording.gyros`). What is not of one gyro – errors of the references, late tags of all of them – adds
nothing to the parity. Without reference attitudes there are parity rows only.

Four gyros have one parity residual, in which constant errors of any of them look alike; five or more tell them apart.

`ArrayModel` has what the columns of effects ask of a `RecordingModel`, so that `groups` and `steps` build them for any number
of gyros.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import folds, groups, processes
from diagnosis.model.candidates import placed
from diagnosis.model.groups import Group
from diagnosis.model.linear import Fold, LinearModel, Member
from diagnosis.model.parity import ParityModel
from diagnosis.model.places import Place
from diagnosis.model.recording import RecordingModel
from diagnosis.model.steps import with_finer_times
from diagnosis.settings import DiagnosisSettings
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from gyrocal.recording import Recording
from simulator.effects import Stream, Surroundings, references_of
from simulator.effects.base import Effect, ProcessTimes
from simulator.effects.common import markov
from simulator.effects.gyros import acts_on_one

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

BY_ROW = ("train_y", "train_X", "left_y", "left_X", "owner")  # of a fold


@dataclass(frozen=True)
class ArrayModel:
    """Attitude and parity of a recording.

    Attributes
    ----------
    recording : of the gyros
    parity : its parity
    body : of its body rates, None without reference attitudes
    """

    recording: Recording
    parity: ParityModel
    body: RecordingModel | None

    @property
    def attitude_rows(self) -> int:
        """Number of observations that are attitudes; they come first."""
        return 0 if self.body is None else self.body.size

    @property
    def size(self) -> int:
        """Number of observations."""
        return self.attitude_rows + self.parity.size

    @cached_property
    def y(self) -> Array:
        """(N,) whitened observations, nuisance parameters projected out."""
        return self.parity.y if self.body is None else np.concatenate([self.body.y, self.parity.y])

    @property
    def degrees_of_freedom(self) -> int:
        """Observations less nuisance parameters."""
        return self.parity.degrees_of_freedom + (0 if self.body is None else self.body.degrees_of_freedom)

    def projected(self, columns: Array) -> Array:
        """Take the part of the nuisance parameters out of whitened columns."""
        own = self.parity.projected(columns[self.attitude_rows :])
        return own if self.body is None else np.concatenate([self.body.projected(columns[: self.attitude_rows]), own])

    def whitened(self, columns: Array) -> Array:
        """Whiten the attitude rows of columns; those of the parity are white."""
        rows = self.attitude_rows
        return columns if self.body is None else np.concatenate([self.body.whitened(columns[:rows]), columns[rows:]])

    # ---- as effects see it -----------------------------------------------------------------------------------------------

    @property
    def stream(self) -> Stream:
        """The samples."""
        return self.parity.stream

    @cached_property
    def around(self) -> Surroundings:
        """What the recording offers to effects on a gyro."""
        gyro, references = self.recording.gyro, references_of(self.recording)
        return Surroundings(self.stream, references, gyro.arw, gyro.sample_s, self.recording.attitudes.sigma)

    # ---- columns ---------------------------------------------------------------------------------------------------------

    def reading(self, high: Array) -> Array:
        """Compute observations of readings that are high, (n, gyros, k) rad/s → (N, k); attitude rows not yet whitened."""
        own = self.parity.reading(high)
        return own if self.body is None else np.concatenate([self.body.reading(self._turn(high)), own])

    def reading_steps(self, high: Array, starts: Indices) -> Array:
        """Compute the same of readings (n, gyros) switched on at each of several samples (s,), (N, s)."""
        own = self.parity.reading_steps(high, starts)
        if self.body is None:
            return own
        firsts = np.searchsorted(self.body.t_s, self.stream.t_s[starts] - 0.5 * self.stream.duration_s[starts])
        return np.concatenate([self.body.reading_steps(self._turn(high[:, :, None])[:, :, 0], firsts), own])

    def _turn(self, high: Array) -> Array:
        """Compute the body rates' part of readings, (n, gyros, k) → means over the attitude's steps (steps, 3, k)."""
        parts = zip(self.parity.gains, self.stream.intervals, strict=True)
        turned = np.concatenate([np.matmul(G, high[part]) for G, part in parts])
        dt, ends = self.stream.duration_s, self._samples_of_steps.ravel()
        sums = np.add.reduceat(np.pad(turned * dt[:, None, None], ((0, 1), (0, 0), (0, 0))), ends)[::2]
        return np.asarray(sums / np.add.reduceat(np.append(dt, 1.0), ends)[::2, None, None])

    @cached_property
    def _samples_of_steps(self) -> Indices:
        """(steps, 2) first of the samples with their middle in each step of the attitude, and one past the last.

        A step with none is part of a sample, which is both.
        """
        assert self.body is not None
        t_s, half = self.stream.t_s, 0.5 * self.stream.duration_s
        low, high = (np.searchsorted(t_s, self.body.t_s + 0.5 * side * self.body.dt) for side in (-1, 1))
        held = np.clip(np.searchsorted(t_s - half, self.body.t_s, side="right") - 1, 0, None)
        return np.column_stack([np.where(low < high, low, held), np.where(low < high, high, held)])

    # ---- random processes ------------------------------------------------------------------------------------------------

    @cached_property
    def process_times(self) -> ProcessTimes:
        """Times at which a random process of a gyro is taken: the attitude's cells, or the parity's blocks without attitude."""
        if self.body is None:
            one = self.parity
            return ProcessTimes(one.means(one.stream.t_s), np.cumsum(one.duration_s) - 0.5 * one.duration_s, one.interval)
        at = processes.cell_times(self.body)
        return replace(at, interval=np.array([block.interval for block in self.body.blocks])[at.interval])

    def unit_columns(self, gyro: int) -> Array:
        """Compute (N, times) whitened observations of a unit error of one gyro at each time of a process."""
        own = self.parity.rows[:, [gyro]] * self._held[self.parity.block]
        if self.body is None:
            return own
        weights = -self.parity.gains[self.process_times.interval, :, gyro]  # a reading that is high makes a rate error −G_i
        return np.concatenate([np.einsum("aNc,ca->Nc", self.body.cell_columns, weights), own])

    @cached_property
    def _held(self) -> Array:
        """(B, times) share of each block of the parity in which each value of a process holds: that nearest in time.

        It is one of the same interval where there is one.
        """
        at, stream, blocks = self.process_times, self.stream, self.parity.interval.size
        if self.body is None:
            return np.eye(blocks)
        own = np.empty(stream.t_s.size, dtype=np.intp)
        for number, part in enumerate(stream.intervals):
            there = np.flatnonzero(at.interval == number)
            there = there if there.size else np.arange(at.t_s.size)
            own[part] = there[np.searchsorted(0.5 * (at.t_s[there][1:] + at.t_s[there][:-1]), stream.t_s[part])]
        out = np.zeros((blocks, at.t_s.size))
        np.add.at(out, (np.repeat(np.arange(blocks), np.diff(self.parity.edges)), own), stream.duration_s)
        return out / self.parity.duration_s[:, None]


# ---- candidates ----------------------------------------------------------------------------------------------------------


def build_array_model(model: ArrayModel, effects: Sequence[Effect], settings: DiagnosisSettings) -> LinearModel:
    """Build the linear model of several gyros: effects of each, of the references, and unlisted rivals of both."""
    of_gyros = {effect.name: effect for effect in effects if effect.axes and acts_on_one(effect)}
    offered = list(list_gyro_groups(model, list(of_gyros.values())))
    if model.body is not None:
        common = [effect for effect in effects if effect.on_references or not effect.axes]
        below = ((0, model.parity.size), (0, 0))  # no parity shows these
        for one in (*groups.listed(model.body, common, None), *groups.unlisted_groups(model.body, {}, common)):
            offered.append(replace(one, columns=[np.pad(part, below) for part in one.columns]))
    found, W = placed(offered, model.projected, settings, model.size)
    return LinearModel(
        y=model.y,
        X=model.projected(W),
        W=W,
        candidates=found,
        dof=model.degrees_of_freedom,
        projected=model.projected,
        most_effects=settings.largest_set,
        split=folds.SPLIT,
        folds=lambda W: fold_array(model, W),
        refine=lambda linear, member: refine_steps(model, linear, member, of_gyros),
    )


def list_gyro_groups(model: ArrayModel, effects: Sequence[Effect]) -> Iterator[Group]:
    """List effects with columns or a covariance on each gyro, and the unlisted errors of each."""
    around, at = model.around, model.process_times
    here = [effect for effect in effects if effect.missing(around) is None]
    random = [effect for effect in here if effect.is_process]
    covariances = [[effect.covariance(at, trial.parameters) for trial in effect.trials(around)] for effect in random]
    longest = max(float(np.ptp(at.t_s[at.interval == k])) for k in np.unique(at.interval))
    levels = processes.same(at.interval)
    fast = [levels * markov(at.t_s, longest / part) for part in (60, 20, 6)]
    for gyro, name in enumerate(model.stream.gyros):
        for effect in here:
            if effect.has_columns:
                yield (groups.switched_group if effect.switched else groups.plain_group)(model, effect, name, around)
        unit = model.unit_columns(gyro)
        place = Place.of(unit, unit.T @ model.projected(unit))
        for effect, own in zip(random, covariances, strict=True):
            trials, columns = effect.trials(around), [processes.usual(place, K) for K in own]
            parameters, weights = [dict(trial.parameters) for trial in trials], [trial.weight for trial in trials]
            yield replace(groups.group_of(effect, name, columns, parameters, weights), process=True)
        rate = np.interp(at.t_s, model.stream.t_s, model.stream.raw[:, gyro])
        along = np.outer(rate, rate)
        for words, kinds in (
            ("random error of a gyro, correlated in time", fast),
            ("bias of a gyro differs between intervals", [levels]),
            ("scale factor of a gyro differs between intervals", [levels * along]),
            ("scale factor of a gyro wanders", [fast[2] * along]),
        ):
            yield groups.build_rival(words, name, [processes.usual(place, K) for K in kinds], True)


def refine_steps(model: ArrayModel, linear: LinearModel, member: Member, effects: Mapping[str, Effect]) -> LinearModel:
    """Add times of a step around the one at which a member is held, to every step of every gyro.

    Steps of different gyros may look alike. One alone with finer times would win over the others for no other reason.
    """
    time_s = linear.option(member).parameters.get("time_s")
    if time_s is None:
        return linear
    for number, entry in enumerate(linear.candidates):
        effect = effects.get(entry.effect)
        if effect is not None and effect.switched:
            nearest = np.argmin([abs(float(option.parameters["time_s"]) - float(time_s)) for option in entry.options])
            linear = with_finer_times(model, linear, Member(number, int(nearest), 0), effect)
    return linear


# ---- held-out data -------------------------------------------------------------------------------------------------------


def fold_array(model: ArrayModel, W: Array) -> Iterator[Fold]:
    """Split attitude and parity, which are independent under M0, into common folds."""
    rows = model.attitude_rows
    of_attitude = folds.folds(model.body, W[:rows]) if model.body is not None else iter(())
    for pair in zip_longest(of_attitude, _fold_parity(model, W[rows:])):
        found = [one for one in pair if one is not None]
        names = {name for one in found for name in one.dof}
        joined = {part: np.concatenate([getattr(one, part) for one in found]) for part in BY_ROW}
        yield Fold(**joined, dof={name: sum(one.dof.get(name, 0.0) for one in found) for name in names})


def _fold_parity(model: ArrayModel, W: Array) -> Iterator[Fold]:
    parity = model.parity
    names = np.array([interval.name for interval in model.recording.intervals])
    scale = folds.SETTINGS.broad * np.tile([PLAUSIBLE_G] * 3 + [PLAUSIBLE_BIAS], parity.rows.shape[1])
    nuisance = parity.nuisance_columns * scale
    sigma = np.eye(parity.size) + nuisance @ nuisance.T
    part = np.empty(parity.interval.size, dtype=np.intp)
    for number in np.unique(parity.interval):
        own = np.flatnonzero(parity.interval == number)
        part[own] = (np.arange(own.size) * folds.SETTINGS.parts // own.size + number) % folds.SETTINGS.parts
    for number in np.unique(part):
        out = (part == number)[parity.block]
        if not out.all():
            yield folds.held_out(sigma, parity.observed, W, out, names[parity.interval[parity.block]])
