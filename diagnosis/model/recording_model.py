"""Linearised model of a recording: attitude errors in inertial axes, their covariance, and the columns of any effect.

Each interval is propagated from its first reference attitude with the calibrated rates ω_adj = G ω_raw + b
(`gyrocal.propagate`). The residuals exp([θ_k×]) = A_obs A_prop,kᵀ, N (16), are rotated back to inertial axes,
ζ_k = −A_prop,kᵀ θ_k. If the true rate is ω = ω_adj + δω, then to first order

    ζ_k = φ + ∫₀^{t_k} Aᵀ(t) δω(t) dt − A_kᵀ ν_k + g(t_k)

with φ the interval's start attitude error, ν_k the error of reference k in body axes (A_obs = exp([ν×]) A_true) and g the
integrated gyro noise. The noise is isotropic, so its covariance ARW² min(t_a, t_b) I is the same in all axes. In inertial axes
the integral is a cumulative sum. One such sum gives the column of an effect for every time at which the effect may start. A
reading that is too high by r has δω = −G r. The first reference is an observation too (ζ = 0), and φ is a nuisance parameter.

If ζ is large, the propagated attitude A differs from the true one and the first order is not enough.
`diagnosis.model.linearise` then takes A from the references and integrates the error along that path.

The nuisance parameters of M0 (φ of every interval, G, b) are projected out. Under M0 the whitened observations y are N(0, I) in
the complement of the nuisance columns; an effect adds its projected column. Tests, evidence, amplitudes and predictions need
only y and these columns. Source: Kay, Fundamentals of Statistical Signal Processing II, section 7.7 (the linear model with
nuisance parameters).

Long recordings are condensed to fewer steps and observations (`diagnosis.model.linearise`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dtrsm

from diagnosis.model import process_projection
from gyrocal.arrays import Array, Indices
from gyrocal.jit_cache import compile_cached
from gyrocal.recording import Recording
from simulator.effects import References, Stream, Surroundings, find_flight_directions
from simulator.effects.recording_view import interpolate_housekeeping

MOST_CELLS = 320  # cells of a recording; random processes cost the cube of it
RANK = 1e-9  # relative size below which a nuisance column adds nothing to the others

PROJECTED_COLUMNS_PER_BATCH = 1024  # columns that are projected together


@dataclass(frozen=True)
class Block:
    """One interval, or a part of one: its steps, the references in it and their observations."""

    interval: int  # index of the recording's interval it is, or is a part of
    steps: slice  # its steps among all
    rows: slice  # its rows among those of the observations, three for each observation
    references: Indices  # (m,) rows of the reference attitudes in the recording
    ends: Indices  # (m,) steps of the interval done at each reference, the first is 0
    elapsed_s: Array  # (m,) time since the first reference
    groups: Indices  # (r,) the first of the references that are averaged to each observation
    whitener: Array  # (3r, 3r) lower Cholesky factor of the observations' covariance

    @property
    def counts(self) -> Indices:
        """(r,) number of references in each observation."""
        return np.diff(np.append(self.groups, self.references.size))

    def average_references(self, values: Array) -> Array:
        """Average values over the references of each observation, (m, …) → (r, …)."""
        if self.groups.size == self.references.size:
            return values
        sums = np.add.reduceat(values, self.groups, axis=0)
        return np.asarray(sums / self.counts.reshape(-1, *(1,) * (values.ndim - 1)))


@dataclass(frozen=True)
class Cells:
    """Stretches between observations and inside long gaps of them, over which a random rate error is taken as constant."""

    interval: Indices  # (c,) index of the interval
    first: Indices  # first, last: (c,) its steps among all, the last excluded
    last: Indices
    t_s: Array  # (c,) time of its middle, s since the epoch
    run_s: Array  # (c,) sampled time up to its middle, gaps between the intervals left out
    duration_s: Array  # (c,)


@dataclass(frozen=True)
class RecordingModel:
    """A recording linearised about a calibration."""

    recording: Recording  # what was recorded
    G: Array  # G, bias: (3, 3), (3,) rad/s: the parameters it is linearised about
    bias: Array
    t_s: Array  # t_s, dt: (n,) middle and length of each step, s
    dt: Array
    raw: Array  # raw, rates: (n, 3) raw and calibrated rates, smoothed if there is a smoothed stream, rad/s
    rates: Array
    to_inertial: Array  # (n, 3, 3) Aᵀ in the middle of each step
    at_reference: Array  # (m, 3, 3) Aᵀ at each reference of each block, as propagated
    blocks: tuple[Block, ...]  # the intervals
    zeta: Array  # (N,) observations, rad
    residuals: Array  # (m, 3) ζ of every reference before any averaging, rad
    off: Array  # (m, 3) rotation vectors from the propagated attitudes to the references, inertial axes, rad
    errors: Array  # (m, 3, 3) covariance of the error of every reference, inertial axes, rad²
    walk: Array  # (m, 3, 3) covariance of the integrated gyro noise at every reference, inertial axes, rad²
    # (n, 3, k) errors of the readings whose sizes are nuisance parameters, rad/s: lines that are too fast for a scan of periods
    # and would pass for slow ones, and half steps of readings that may have been cut toward zero
    nuisance_errors: Array | None = None

    @property
    def size(self) -> int:
        """Number of observations."""
        return self.zeta.size

    @cached_property
    def reference_rows(self) -> Indices:
        """(m,) rows of the reference attitudes, block by block."""
        return np.concatenate([block.references for block in self.blocks])

    @cached_property
    def reference_slices(self) -> tuple[slice, ...]:
        """The references of each block among all."""
        stops = np.cumsum([block.references.size for block in self.blocks]).tolist()
        return tuple(slice(stop - block.references.size, stop) for stop, block in zip(stops, self.blocks, strict=True))

    @cached_property
    def interval_of_reference(self) -> Indices:
        """(m,) index of the block of each reference."""
        return np.repeat(np.arange(len(self.blocks)), [block.references.size for block in self.blocks])

    @cached_property
    def reference_rates(self) -> Array:
        """(m, 3) body rate at each reference, rad/s: that of the step in progress, or of the last one of its interval."""
        steps = [block.steps.start + np.minimum(block.ends, block.steps.stop - block.steps.start - 1) for block in self.blocks]
        return np.asarray(self.rates[np.concatenate(steps)])

    @cached_property
    def observation_block(self) -> Indices:
        """(r,) index of the block of each observation."""
        return np.repeat(np.arange(len(self.blocks)), [block.groups.size for block in self.blocks])

    @cached_property
    def observation_t_s(self) -> Array:
        """(r,) time of each observation, s since the epoch."""
        t_s = self.recording.attitudes.t_s
        return np.concatenate([block.average_references(t_s[block.references]) for block in self.blocks])

    @cached_property
    def reference_rows_of_observations(self) -> Indices:
        """(r,) the middle one of the references of each observation, among those of `references`."""
        parts = zip(self.blocks, self.reference_slices, strict=True)
        return np.concatenate([references.start + block.groups + block.counts // 2 for block, references in parts])

    @cached_property
    def observation_attitude(self) -> Array:
        """(r, 3, 3) Aᵀ at the middle one of the references of each observation."""
        return self.at_reference[self.reference_rows_of_observations]

    @cached_property
    def stream(self) -> Stream:
        """The steps as the effects see them."""
        orbit = self.recording.orbit
        return Stream(
            t_s=self.t_s,
            duration_s=self.dt,
            rates=self.rates,
            raw=self.raw,
            intervals=tuple(block.steps for block in self.blocks),
            orbit_period_s=orbit.period_s if orbit is not None else float("nan"),
            span_s=(self.recording.intervals[0].start_s, self.recording.intervals[-1].stop_s),
            housekeeping=interpolate_housekeeping(self.recording, self.t_s),
        )

    @cached_property
    def references(self) -> References:
        """The references as the effects see them, block by block."""
        rows = self.reference_rows
        attitudes = self.recording.attitudes
        orbit = self.recording.orbit
        forward, heading = find_flight_directions(self.recording)
        return References(
            t_s=attitudes.t_s[rows],
            quaternions=attitudes.quaternions[rows],
            interval=self.interval_of_reference,
            forward=forward[rows],
            orbit_period_s=orbit.period_s if orbit is not None else float("nan"),
            heading=heading[rows],
        )

    @cached_property
    def surroundings(self) -> Surroundings:
        """Quantities of the recording that effects depend on."""
        gyro, attitudes = self.recording.gyro, self.recording.attitudes.select_rows(self.reference_rows)
        axes = attitudes.build_error_axes()
        return Surroundings(self.stream, self.references, gyro.arw, gyro.sample_s, attitudes.sigma, axes, self.residuals)

    def reading(self, high: Array) -> Array:
        """Observe readings that are too high by (n, 3, k), rad/s, as observations (N, k), not whitened."""
        return self._observe_increments(self.readings_influence, high)

    def observe_rate_error(self, error: Array) -> Array:
        """Observe an error δω of the calibrated rates, (n, 3, k) rad/s → (N, k)."""
        return self._observe_increments(self.to_inertial, error)

    def observe_reading_steps(self, high: Array, starts: Indices) -> Array:
        """Observe one reading that is switched on at each of several steps, as `reading` does: (n, 3), (s,) → (N, s)."""
        turned = np.einsum("nij,nj->ni", self.to_inertial, -(high @ self.G.T)) * self.dt[:, None]
        out = np.empty((self.size, starts.size))
        for block in self.blocks:
            total = np.vstack([np.zeros(3), np.cumsum(turned[block.steps], axis=0)])
            begin = np.clip(starts - block.steps.start, 0, len(total) - 1)
            # Before its start the step has added nothing, after it the sum since then.
            late = (block.ends[:, None] > begin)[:, None]
            added = block.average_references((total[block.ends][:, :, None] - total[begin].T) * late)
            out[block.rows] = added.reshape(-1, starts.size)
        return out

    def observe_reference_error(self, error: Array) -> Array:
        """Observe errors of the references in body axes, (m, 3, k) rad → (N, k)."""
        return self.average_references(-np.matmul(self.at_reference, error)).reshape(self.size, -1)

    def average_references(self, values: Array) -> Array:
        """Average values over the references of each observation, (m, …) → (r, …)."""
        parts = zip(self.blocks, self.reference_slices, strict=True)
        return np.concatenate([block.average_references(values[references]) for block, references in parts])

    def compute_attitude_turns(self, high: Array) -> Array:
        """Compute the attitude errors at every reference, not averaged, of too high readings, (n, 3, k) → (m, 3, k)."""
        return np.concatenate([self._totals(self.readings_influence, high, block) for block in self.blocks])

    @cached_property
    def readings_influence(self) -> Array:
        """(n, 3, 3) rate error in inertial axes of readings that are too high, −Aᵀ G in the middle of each step."""
        return np.asarray(-self.to_inertial @ self.G)

    def _observe_increments(self, turn: Array, rates: Array) -> Array:
        out = np.empty((self.size, rates.shape[2]))
        for block in self.blocks:
            out[block.rows] = block.average_references(self._totals(turn, rates, block)).reshape(3 * block.groups.size, -1)
        return out

    def _totals(self, turn: Array, rates: Array, block: Block) -> Array:
        """Integrate rotated rates up to each reference of a block, (n, 3, 3) and (n, 3, k) of all steps → (m, 3, k)."""
        steps = block.steps
        return np.asarray(_integrate(turn[steps], self.dt[steps], np.ascontiguousarray(rates[steps], dtype=float), block.ends))

    def whiten(self, columns: Array) -> Array:
        """Whiten columns (N,) or (N, k) by L⁻¹, with the factor L of the covariance of each block."""
        values = columns.reshape(self.size, -1)
        out = np.empty(values.shape)
        for block in self.blocks:
            # The transpose of rows that follow one another in memory is in the order of Fortran, and nothing is copied.
            out[block.rows] = dtrsm(1.0, block.whitener.T, values[block.rows].T, side=1).T
        return out.reshape(columns.shape)

    @cached_property
    def calibration(self) -> Array:
        """(N, 12) whitened columns of what G_xx, G_xy, …, G_zz, b_x, b_y, b_z lack: δω = δG ω_raw + δb."""
        return self.whiten(self.observe_rate_error(build_parameter_errors(self.raw)))

    @cached_property
    def starts(self) -> Array:
        """(N, 3 blocks) whitened columns of the start attitude errors φ."""
        out = np.zeros((self.size, 3 * len(self.blocks)))
        for number, block in enumerate(self.blocks):
            out[block.rows, 3 * number : 3 * number + 3] = np.tile(np.eye(3), (block.groups.size, 1))
        return self.whiten(out)

    @cached_property
    def nuisance(self) -> Array:
        """(N, q) orthonormal basis of the nuisance parameters' columns."""
        return build_basis(np.hstack([self.starts, self.calibration, self.error_columns]))

    @cached_property
    def error_columns(self) -> Array:
        """(N, k) whitened columns of the nuisance errors, each of its usual size."""
        return np.zeros((self.size, 0)) if self.nuisance_errors is None else self.whiten(self.reading(self.nuisance_errors))

    def project_out_nuisance(self, columns: Array) -> Array:
        """Project the nuisance parameters out of whitened columns, in batches: ten thousand columns take a gigabyte thrice."""
        basis, out = self.nuisance, np.empty_like(columns)
        for first in range(0, columns.shape[-1] if columns.ndim > 1 else 1, PROJECTED_COLUMNS_PER_BATCH):
            batch = (..., slice(first, first + PROJECTED_COLUMNS_PER_BATCH)) if columns.ndim > 1 else ...
            np.subtract(columns[batch], basis @ (basis.T @ columns[batch]), out=out[batch])
        return out

    def whiten_and_project(self, columns: Array) -> Array:
        """Whiten columns and project the nuisance parameters out."""
        return self.project_out_nuisance(self.whiten(columns))

    @cached_property
    def y(self) -> Array:
        """(N,) whitened and projected observations: N(0, I) on the complement of the nuisance parameters under M0."""
        return self.whiten_and_project(self.zeta)

    @property
    def weighed_residuals(self) -> Array:
        """V⁻¹ (z − C θ), (N,), of the observations less the fit of the nuisance parameters."""
        out = self.y.copy()
        for block in self.blocks:
            out[block.rows] = scipy.linalg.solve_triangular(block.whitener, out[block.rows], lower=True, trans="T")
        return out

    @property
    def degrees_of_freedom(self) -> int:
        """Observations less the nuisance parameters."""
        return self.size - self.nuisance.shape[1]

    @cached_property
    def cells(self) -> Cells:
        """Cells that end at the first reference of every observation."""
        total = float(self.dt.sum())
        length = total / MOST_CELLS * 1.35  # gaps between references leave short ones
        parts: list[tuple[int, int, int]] = []
        for number, block in enumerate(self.blocks):
            for low, high in pairwise(np.append(block.ends[block.groups], block.ends.max())):
                if high <= low:
                    continue
                duration = float(self.dt[block.steps][low:high].sum())
                count = min(max(1, round(duration / length)), int(high - low))
                edges = np.linspace(low, high, count + 1).round().astype(int) + block.steps.start
                parts += [(number, int(a), int(b)) for a, b in pairwise(edges)]
        interval, first, last = (np.array(values) for values in zip(*parts, strict=True))
        lengths: Array = np.add.reduceat(self.dt, first)
        run = np.cumsum(lengths) - 0.5 * lengths
        return Cells(interval, first, last, 0.5 * (self.t_s[first] + self.t_s[last - 1]), run, lengths)

    @cached_property
    def passed_shares(self) -> Array:
        """(r, c) share of each cell that has passed at each observation."""
        out = np.zeros((self.size // 3, self.cells.first.size))
        for number, block in enumerate(self.blocks):
            inside = np.flatnonzero(self.cells.interval == number)
            first, last = self.cells.first[inside] - block.steps.start, self.cells.last[inside] - block.steps.start
            share = block.average_references(np.clip((block.ends[:, None] - first) / (last - first), 0.0, 1.0))
            out[np.ix_(np.arange(block.rows.start // 3, block.rows.stop // 3), inside)] = share
        return out

    @cached_property
    def cell_columns(self) -> Array:
        """(3, N, c) whitened observations of a unit rate error about each body axis in each cell."""
        turned = np.add.reduceat(self.to_inertial * self.dt[:, None, None], self.cells.first, axis=0)  # (c, inertial, body)
        errors = (self.passed_shares[:, None, :] * turned[:, :, axis].T for axis in range(3))
        return np.stack([self.whiten(part.reshape(self.size, -1)) for part in errors])

    @cached_property
    def reference_columns(self) -> Array:
        """(3, N, r) whitened observations of a unit error of the references of each observation about each body axis."""
        count = self.observation_t_s.size
        rows = 3 * np.arange(count)[:, None] + np.arange(3)
        out = np.zeros((3, self.size, count))
        for axis in range(3):
            errors = np.zeros((len(self.at_reference), 3, 1))
            errors[:, axis] = 1.0
            out[axis][rows, np.arange(count)[:, None]] = self.observe_reference_error(errors).reshape(count, 3)
        return np.stack([self.whiten(part) for part in out])

    @cached_property
    def cell_places(self) -> tuple[process_projection.ProcessProjection, ...]:
        """Cells on which a random error of the rates acts, about each body axis."""
        return process_projection.project_cells(self)

    @cached_property
    def reference_places(self) -> tuple[process_projection.ProcessProjection, ...]:
        """References on which a random error acts, about each body axis."""
        return process_projection.project_references(self)

    @cached_property
    def tag_place(self) -> process_projection.ProcessProjection:
        """References on whose time tags a random error acts."""
        return process_projection.project_tags(self)


def build_basis(columns: Array) -> Array:
    """Build an orthonormal basis (N, q) of columns of nuisance parameters in any units."""
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > RANK * s[0]])


def build_parameter_errors(raw: Array) -> Array:
    """Build rate errors (n, 3, 12) per unit error of G_xx, G_xy, …, G_zz, b_x, b_y, b_z from the raw rates (n, 3)."""
    out = np.zeros((len(raw), 3, 12))
    for axis in range(3):
        out[:, axis, 3 * axis : 3 * axis + 3] = raw
        out[:, axis, 9 + axis] = 1.0
    return out


@compile_cached
def _integrate(turn: Array, dt: Array, rates: Array, ends: Indices) -> Array:
    """Integrate rates (n, 3, k), rotated by (n, 3, 3), from the first of the ends (m,) to each of them, (m, 3, k)."""
    # Loops: the assignment of a slice takes four seconds to compile, most of them for the text of its error.
    out = np.zeros((ends.size, 3, rates.shape[2]))
    for m in range(1, ends.size):
        for n in range(ends[m - 1], ends[m]):
            for i in range(3):
                for j in range(3):
                    share = turn[n, i, j] * dt[n]
                    for k in range(rates.shape[2]):
                        out[m, i, k] += share * rates[n, j, k]
        for i in range(3):
            for k in range(rates.shape[2]):
                out[m, i, k] += out[m - 1, i, k]
    return out
