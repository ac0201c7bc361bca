"""Parity and attitude of more gyros than three as whitened observations of one linearised recording.

In an interval the gyros that were on have parity residuals Vᵀ (ω_raw − c), with VᵀK = 0 (`gyrocal.recording.gyros`). Their
means over blocks of time are the observations; a mean over T s has the noise ARW²/T in each of the n − 3 components, and
nothing is lost by it of an error that changes little within a block. An error f(t) of the reading of gyro i adds V_i f̄, with
f̄ its mean over the block: columns are exact whatever their course.

Nuisance parameters are the K and c of all gyros, −Vᵀ (ΔK ω̄ + Δc). Only their parity is seen here, the rest by the attitude;
gyros that are switched between intervals have different V and the same K and c.

`ArrayModel` has both, and what the columns of effects need of a `RecordingModel`, so that `candidates` and `steps` build them
for any number of gyros. Its rows are those of the attitude, then those of the parity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import processes
from diagnosis.model.recording import RecordingModel, build_basis
from gyrocal.calibration.gyros import GyroArray
from gyrocal.recording import Recording
from gyrocal.recording.gyros import gain, inside, parity
from simulator.effects import Stream, Surroundings, references_of
from simulator.effects.base import ProcessTimes
from simulator.effects.recorded import housekeeping_at

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class GyroArraySettings:
    """Constants of `diagnosis.model.gyro_array`."""

    most_blocks: int = 200  # of a recording


SETTINGS = GyroArraySettings()


@dataclass(frozen=True)
class ParityModel:
    """Parity of a recording, about some K and c.

    Attributes
    ----------
    stream : the n samples inside the intervals, with the names and axes K of the gyros
    edges : (B + 1,) first sample of each block, and the number of samples
    interval : (B,) interval of each block
    block : (R,) block of each observation
    rows : (R, gyros) whitened V_i of each observation; zero for gyros that were off
    observed : (R,) whitened parity residuals
    gains : (intervals, 3, gyros) G of each interval
    """

    stream: Stream
    edges: Indices
    interval: Indices
    block: Indices
    rows: Array
    observed: Array
    gains: Array

    @property
    def size(self) -> int:
        """Number of observations."""
        return self.observed.size

    @cached_property
    def duration_s(self) -> Array:
        """(B,) of each block."""
        return np.asarray(np.add.reduceat(self.stream.duration_s, self.edges[:-1]))

    def means(self, values: Array) -> Array:
        """Compute means over the blocks, (n, …) → (B, …)."""
        trailing = (1,) * (values.ndim - 1)
        sums = np.add.reduceat(values * self.stream.duration_s.reshape(-1, *trailing), self.edges[:-1], axis=0)
        return np.asarray(sums / self.duration_s.reshape(-1, *trailing))

    def reading(self, high: Array) -> Array:
        """Compute observations of readings that are high, (n, gyros, k) → (R, k)."""
        return np.asarray(np.einsum("rg,rgk->rk", self.rows, self.means(high)[self.block]))

    def reading_steps(self, high: Array, starts: Indices) -> Array:
        """Compute observations of readings (n, gyros) switched on at each of several samples (s,), (R, s)."""
        out = np.zeros((self.size, starts.size))
        since = np.maximum(self.edges[:, None], starts)
        for gyro in np.flatnonzero(high.any(axis=0)):
            total = np.concatenate([[0.0], np.cumsum(high[:, gyro] * self.stream.duration_s)])
            out += self.rows[:, [gyro]] * (np.diff(total[since], axis=0) / self.duration_s[:, None])[self.block]
        return out

    @cached_property
    def nuisance_columns(self) -> Array:
        """(R, 4 gyros) columns of K_x, K_y, K_z and c, gyro by gyro."""
        w = np.column_stack([self.means(self.stream.rates), np.ones(self.interval.size)])[self.block]
        return (self.rows[:, :, None] * w[:, None, :]).reshape(self.size, -1)

    @cached_property
    def nuisance(self) -> Array:
        """(R, q) orthonormal basis of those columns."""
        return build_basis(self.nuisance_columns)

    def projected(self, columns: Array) -> Array:
        """Take the part of the nuisance parameters out of whitened columns."""
        return columns - self.nuisance @ (self.nuisance.T @ columns)

    @cached_property
    def y(self) -> Array:
        """(R,) N(0, I) on the complement of the nuisance parameters under M0."""
        return self.projected(self.observed)

    @property
    def degrees_of_freedom(self) -> int:
        """Observations less nuisance parameters."""
        return self.size - self.nuisance.shape[1]


def build_parity_model(recording: Recording, gyros: GyroArray, arw: Array) -> ParityModel | None:
    """Build the parity of a recording; None where never more than three gyros were on.

    Parameters
    ----------
    recording : the recording
    gyros : K and c to take it about; that of its own parity leaves nothing nonlinear
    arw : (gyros,) angle random walk of each, rad/sqrt(s)
    """
    gains = np.stack([gain(gyros.K, recording.switched_on(number), arw) for number in range(len(recording.intervals))])
    stream = _build_stream(recording, gyros, gains)
    total = float(stream.duration_s.sum())
    edges: list[Indices] = []
    interval: list[Indices] = []
    block: list[Indices] = []
    rows: list[Array] = []
    observed: list[Array] = []
    for number, part in enumerate(stream.intervals):
        dt = stream.duration_s[part]
        if not dt.size:
            continue
        blocks = max(1, min(dt.size, round(SETTINGS.most_blocks * float(dt.sum()) / total)))
        first = np.linspace(0, dt.size, blocks + 1).round().astype(np.intp)[:-1]
        duration = np.add.reduceat(dt, first)
        V = parity(gyros.K, recording.switched_on(number))
        white = np.linalg.solve(np.linalg.cholesky(V.T * arw**2 @ V), V.T)  # (m, gyros)
        scaled = np.sqrt(duration)[:, None, None] * white
        means = np.add.reduceat(_read(recording, gyros, number) * dt[:, None], first, axis=0) / duration[:, None]
        block.append(np.repeat(sum(one.size for one in interval) + np.arange(blocks), len(white)))
        edges.append(part.start + first)
        interval.append(np.full(blocks, number))
        rows.append(scaled.reshape(-1, len(V)))
        observed.append(np.einsum("bmi,bi->bm", scaled, means).ravel())
    if not sum(one.size for one in observed):
        return None
    return ParityModel(
        stream=stream,
        edges=np.concatenate([*edges, [stream.t_s.size]]),
        interval=np.concatenate(interval),
        block=np.concatenate(block),
        rows=np.concatenate(rows),
        observed=np.concatenate(observed),
        gains=gains,
    )


def _read(recording: Recording, gyros: GyroArray, interval: int) -> Array:
    """Compute what the gyros read in an interval less their biases (n, gyros), zero for those that were off."""
    chosen = recording.switched_on(interval)
    out = np.zeros((inside(recording, interval)[1].size, len(gyros.names)))
    out[:, chosen] = recording.gyro.rates[inside(recording, interval)[0]][:, chosen] - gyros.c[chosen]
    return out


def _build_stream(recording: Recording, gyros: GyroArray, gains: Array) -> Stream:
    """Build the samples inside the intervals as effects on one of the gyros see them."""
    intervals = recording.intervals
    parts = [inside(recording, number) for number in range(len(intervals))]
    ends = np.cumsum([0, *(own.size for _, own in parts)]).tolist()
    dt = np.concatenate([own for _, own in parts])
    t_s = np.concatenate([recording.gyro.t_s[part] for part, _ in parts]) + 0.5 * dt
    rates = np.concatenate([_read(recording, gyros, number) @ G.T for number, G in enumerate(gains)])
    return Stream(
        t_s=t_s,
        duration_s=dt,
        rates=rates,
        raw=rates @ gyros.K.T + gyros.c,
        intervals=tuple(slice(low, high) for low, high in pairwise(ends)),
        orbit_period_s=recording.orbit.period_s if recording.orbit is not None else float("nan"),
        span_s=(min(one.start_s for one in intervals), max(one.stop_s for one in intervals)),
        housekeeping=housekeeping_at(recording, t_s),
        gyros=gyros.names,
        axes=gyros.K,
    )


# ---- with the attitude ---------------------------------------------------------------------------------------------------


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
