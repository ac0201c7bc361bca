"""Attitude and parity of several gyros as one linearised recording.

`ArrayModel` has what the columns of effects ask of a `RecordingModel`, so that `groups` and `steps` build them for any number
of gyros. Its rows are those of the attitude, then those of the parity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import processes
from diagnosis.model.parity import ParityModel
from diagnosis.model.recording_model import RecordingModel
from gyrocal.recording import Recording
from simulator.effects import Stream, Surroundings, extract_references
from simulator.effects.base import ProcessTimes

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


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

    def project_out_nuisance(self, columns: Array) -> Array:
        """Take the part of the nuisance parameters out of whitened columns."""
        own = self.parity.project_out_nuisance(columns[self.attitude_rows :])
        return (
            own if self.body is None else np.concatenate([self.body.project_out_nuisance(columns[: self.attitude_rows]), own])
        )

    def whiten(self, columns: Array) -> Array:
        """Whiten the attitude rows of columns; those of the parity are white."""
        rows = self.attitude_rows
        return columns if self.body is None else np.concatenate([self.body.whiten(columns[:rows]), columns[rows:]])

    # ---- as effects see it -----------------------------------------------------------------------------------------------

    @property
    def stream(self) -> Stream:
        """The samples."""
        return self.parity.stream

    @cached_property
    def surroundings(self) -> Surroundings:
        """Quantities of the recording that effects on a gyro depend on."""
        gyro, references = self.recording.gyro, extract_references(self.recording)
        return Surroundings(self.stream, references, gyro.arw, gyro.sample_s, self.recording.attitudes.sigma)

    # ---- columns ---------------------------------------------------------------------------------------------------------

    def reading(self, high: Array) -> Array:
        """Compute observations of readings that are high, (n, gyros, k) rad/s → (N, k); attitude rows not yet whitened."""
        own = self.parity.reading(high)
        return own if self.body is None else np.concatenate([self.body.reading(self._average_body_rates(high)), own])

    def observe_reading_steps(self, high: Array, starts: Indices) -> Array:
        """Compute the same of readings (n, gyros) switched on at each of several samples (s,), (N, s)."""
        own = self.parity.observe_reading_steps(high, starts)
        if self.body is None:
            return own
        firsts = np.searchsorted(self.body.t_s, self.stream.t_s[starts] - 0.5 * self.stream.duration_s[starts])
        return np.concatenate(
            [self.body.observe_reading_steps(self._average_body_rates(high[:, :, None])[:, :, 0], firsts), own]
        )

    def _average_body_rates(self, high: Array) -> Array:
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
            return ProcessTimes(
                one.average_blocks(one.stream.t_s), np.cumsum(one.duration_s) - 0.5 * one.duration_s, one.interval
            )
        at = processes.compute_cell_times(self.body)
        return replace(at, interval=np.array([block.interval for block in self.body.blocks])[at.interval])

    def build_unit_columns(self, gyro: int) -> Array:
        """Compute (N, times) whitened observations of a unit error of one gyro at each time of a process."""
        own = self.parity.rows[:, [gyro]] * self._block_shares[self.parity.block]
        if self.body is None:
            return own
        weights = -self.parity.gains[self.process_times.interval, :, gyro]  # a reading that is high makes a rate error −G_i
        return np.concatenate([np.einsum("aNc,ca->Nc", self.body.cell_columns, weights), own])

    @cached_property
    def _block_shares(self) -> Array:
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
