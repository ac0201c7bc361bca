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

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.gyros import GyroArray
from gyrocal.recording import Recording
from gyrocal.recording.gyros import gain, inside, parity

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST_BLOCKS = 200  # of a recording
RANK = 1e-9  # relative size below which a nuisance column adds nothing to the others


@dataclass(frozen=True)
class ParityModel:
    """Parity of a recording, about some K and c.

    Attributes
    ----------
    gyros : the K and c that it is about
    t_s, dt : (n,) middle and duration of each sample inside the intervals, s
    rates : (n, 3) body rates, rad/s
    samples : of each interval among those
    first : (B,) first sample of each block
    interval : (B,) interval of each block
    block : (R,) block of each observation
    rows : (R, gyros) whitened V_i of each observation; zero for gyros that were off
    observed : (R,) whitened parity residuals
    """

    gyros: GyroArray
    t_s: Array
    dt: Array
    rates: Array
    samples: tuple[slice, ...]
    first: Indices
    interval: Indices
    block: Indices
    rows: Array
    observed: Array

    @property
    def size(self) -> int:
        """Number of observations."""
        return self.observed.size

    @cached_property
    def duration_s(self) -> Array:
        """(B,) of each block."""
        return np.asarray(np.add.reduceat(self.dt, self.first))

    @cached_property
    def middle_s(self) -> Array:
        """(B,) time of its middle, s since the epoch."""
        return self.means(self.t_s)

    def means(self, values: Array) -> Array:
        """Means over the blocks, (n, …) → (B, …)."""
        weight = self.dt.reshape(-1, *(1,) * (values.ndim - 1))
        sums = np.add.reduceat(values * weight, self.first, axis=0)
        return np.asarray(sums / self.duration_s.reshape(-1, *(1,) * (values.ndim - 1)))

    def reading(self, gyro: int, means: Array) -> Array:
        """Whitened observations of a reading of one gyro that is high by its means over the blocks, (B, k) → (R, k)."""
        return np.asarray(self.rows[:, [gyro]] * means[self.block])

    def means_from(self, values: Array, times: Array) -> Array:
        """Means over the blocks of a reading (n,) that is switched on at each of some times, (B, s)."""
        begin = self.t_s - 0.5 * self.dt
        held = np.clip(np.searchsorted(begin, times, side="right") - 1, 0, None)  # the sample that holds each time
        total = np.concatenate([[0.0], np.cumsum(values * self.dt)])
        off = total[held] + values[held] * np.clip(times - begin[held], 0.0, self.dt[held])
        stop = total[np.append(self.first[1:], self.t_s.size)]
        added = np.clip(np.searchsorted(self.first, held, side="right") - 1, 0, None)
        places = np.arange(self.first.size)[:, None]
        whole = (stop - total[self.first])[:, None]
        out = np.where(places > added, whole, np.where(places < added, 0.0, stop[:, None] - off))
        return np.asarray(out / self.duration_s[:, None])

    @cached_property
    def nuisance(self) -> Array:
        """(R, q) orthonormal basis of the columns of K and c."""
        w = np.column_stack([self.means(self.rates), np.ones(self.first.size)])[self.block]
        columns = (self.rows[:, :, None] * w[:, None, :]).reshape(self.size, -1)
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        U, s, _ = np.linalg.svd(columns, full_matrices=False)
        return np.asarray(U[:, s > RANK * s[0]])

    def projected(self, columns: Array) -> Array:
        """Whitened columns without the part of the nuisance parameters."""
        return columns - self.nuisance @ (self.nuisance.T @ columns)

    @cached_property
    def y(self) -> Array:
        """(R,) N(0, I) on the complement of the nuisance parameters under M0."""
        return self.projected(self.observed)

    @property
    def degrees_of_freedom(self) -> int:
        """Observations less nuisance parameters."""
        return self.size - self.nuisance.shape[1]


def parity_model(recording: Recording, gyros: GyroArray, arw: Array) -> ParityModel | None:
    """The parity of a recording; None where never more than three gyros were on.

    Parameters
    ----------
    recording : the recording
    gyros : K and c to take it about; that of its own parity leaves nothing nonlinear
    arw : (gyros,) angle random walk of each, rad/sqrt(s)
    """
    parts = [inside(recording, number) for number in range(len(recording.intervals))]
    total = sum(float(dt.sum()) for _, dt in parts)
    found: dict[str, list[Array]] = {name: [] for name in ("t_s", "dt", "rates", "rows", "observed")}
    first: list[Indices] = []
    interval: list[Indices] = []
    block: list[Indices] = []
    samples: list[slice] = []
    count = 0
    for number, (part, dt) in enumerate(parts):
        chosen = recording.switched_on(number)
        if not dt.size:
            samples.append(slice(count, count))
            continue
        raw = np.zeros((dt.size, len(gyros.names)))
        raw[:, chosen] = recording.gyro.rates[part][:, chosen] - gyros.c[chosen]
        own = max(1, min(dt.size, round(MOST_BLOCKS * float(dt.sum()) / total)))
        edges = np.unique(np.linspace(0, dt.size, own + 1).round().astype(int))[:-1]
        duration = np.add.reduceat(dt, edges)
        means = np.add.reduceat(raw * dt[:, None], edges, axis=0) / duration[:, None]
        V = parity(gyros.K, chosen)
        if V.shape[1]:
            white = np.linalg.solve(np.linalg.cholesky(V.T * arw**2 @ V), V.T)  # (m, gyros)
            scaled = np.sqrt(duration)[:, None, None] * white
            block.append(np.repeat(sum(part.size for part in first) + np.arange(edges.size), len(white)))
            found["rows"].append(scaled.reshape(-1, len(gyros.names)))
            found["observed"].append(np.einsum("bmi,bi->bm", scaled, means).ravel())
        found["t_s"].append(recording.gyro.t_s[part] + 0.5 * dt)
        found["dt"].append(dt)
        found["rates"].append(raw @ gain(gyros.K, chosen, arw).T)
        samples.append(slice(count, count + dt.size))
        first.append(count + edges)
        interval.append(np.full(edges.size, number))
        count += dt.size
    if not block:
        return None
    arrays = {name: np.concatenate(values) for name, values in found.items()}
    return ParityModel(
        gyros=gyros,
        samples=tuple(samples),
        first=np.concatenate(first),
        interval=np.concatenate(interval),
        block=np.concatenate(block),
        **arrays,
    )
