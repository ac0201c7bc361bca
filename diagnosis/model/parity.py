"""Parity of more gyros than three as whitened observations: what they say of one another, whatever the motion.

In an interval the gyros that were on have parity residuals Vᵀ (ω_raw − c), with VᵀK = 0 (`gyrocal.recording.gyros`). Their
means over blocks of time are the observations; a mean over T s has the noise ARW²/T in each of the n − 3 components, and
nothing is lost by it of an error that changes little within a block. An error f(t) of the reading of gyro i adds V_i f̄, with
f̄ its mean over the block: columns are exact whatever their course.

Nuisance parameters are the K and c of all gyros, −Vᵀ (ΔK ω̄ + Δc). Only their parity is seen here, the rest by the attitude;
gyros that are switched between intervals have different V and the same K and c.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.recording_model import build_basis
from gyrocal.calibration.gyros import GyroArray
from gyrocal.recording import Recording
from gyrocal.recording.gyros import compute_gyro_gain, compute_parity_basis, select_interval_samples
from simulator.effects import Stream
from simulator.effects.recording_view import interpolate_housekeeping

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class ParitySettings:
    """Constants of `diagnosis.model.parity`."""

    most_blocks: int = 200  # of a recording


SETTINGS = ParitySettings()


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

    def average_blocks(self, values: Array) -> Array:
        """Compute means over the blocks, (n, …) → (B, …)."""
        trailing = (1,) * (values.ndim - 1)
        sums = np.add.reduceat(values * self.stream.duration_s.reshape(-1, *trailing), self.edges[:-1], axis=0)
        return np.asarray(sums / self.duration_s.reshape(-1, *trailing))

    def reading(self, high: Array) -> Array:
        """Compute observations of readings that are high, (n, gyros, k) → (R, k)."""
        return np.asarray(np.einsum("rg,rgk->rk", self.rows, self.average_blocks(high)[self.block]))

    def observe_reading_steps(self, high: Array, starts: Indices) -> Array:
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
        w = np.column_stack([self.average_blocks(self.stream.rates), np.ones(self.interval.size)])[self.block]
        return (self.rows[:, :, None] * w[:, None, :]).reshape(self.size, -1)

    @cached_property
    def nuisance(self) -> Array:
        """(R, q) orthonormal basis of those columns."""
        return build_basis(self.nuisance_columns)

    def project_out_nuisance(self, columns: Array) -> Array:
        """Take the part of the nuisance parameters out of whitened columns."""
        return columns - self.nuisance @ (self.nuisance.T @ columns)

    @cached_property
    def y(self) -> Array:
        """(R,) N(0, I) on the complement of the nuisance parameters under M0."""
        return self.project_out_nuisance(self.observed)

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
    gains = np.stack(
        [compute_gyro_gain(gyros.K, recording.switched_on(number), arw) for number in range(len(recording.intervals))]
    )
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
        V = compute_parity_basis(gyros.K, recording.switched_on(number))
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
    out = np.zeros((select_interval_samples(recording, interval)[1].size, len(gyros.names)))
    out[:, chosen] = recording.gyro.rates[select_interval_samples(recording, interval)[0]][:, chosen] - gyros.c[chosen]
    return out


def _build_stream(recording: Recording, gyros: GyroArray, gains: Array) -> Stream:
    """Build the samples inside the intervals as effects on one of the gyros see them."""
    intervals = recording.intervals
    parts = [select_interval_samples(recording, number) for number in range(len(intervals))]
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
        housekeeping=interpolate_housekeeping(recording, t_s),
        gyros=gyros.names,
        axes=gyros.K,
    )
