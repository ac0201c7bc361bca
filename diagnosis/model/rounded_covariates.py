"""Covariates that are recorded to a coarse step, such as a temperature in whole degrees, with their rounding in the model.

A covariate T is recorded as R = q round(T/q). In a run of n equal rows T lies within ±q/2 of R; between runs of neighbouring
values it crosses the edge between them. With T an integrated Wiener process, T″ white of density σ², the observations are

    at a crossing, in the middle of both rows: the edge, with a standard deviation q/(√12 n), n the rows of the shorter run,
    as T passes at most one step in a run;
    at m rows of a run: R with the variance m q²/12, so that a run tells as much as one uniform error, however many rows it has.

Where R changes by more than a step within a row, or where rows are missing, T begins anew: a switch is not smoothed. The most
likely σ is taken. The posterior is normal with a banded precision (Wahba, Journal of the Royal Statistical Society B 40 (1978)
364, whose smoothing spline is its mean). With its mean m and its covariance Σ λ_k u_k u_kᵀ,

    a T = a m + Σ a η_k √λ_k u_k,    η ~ N(0, 1).

For a ~ N(0, s²) the products a η_k have mean zero, variance s², and no correlation with a or one another. Columns of m and of
√λ_k u_k with independent amplitudes N(0, s²) thus have the first two moments of a T, and s ties the errors to the size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
from numpy.typing import NDArray

from diagnosis.detectors.lattice import find_lattice_step
from gyrocal.recording import Recording
from simulator.effects.recording_view import list_housekeeping_columns

Array = NDArray[np.float64]

HELD = 0.5  # share of rows equal to the one before, from which on the step is coarse beside changes and noise
GAP = 3.0  # median spacings of the rows, beyond which rows are missing
FINEST = 100.0  # rows of a usual run; where there are more, rows are left out
ROWS = 9  # of a run that are used beside its last one; T is linear between them
CLOSEST = 0.5  # rows between nodes, as from a row to a crossing; rows with nearly the same tag leave rounding
LONGEST = 30  # rows of a run that sharpen its crossing; the noise of a sensor blurs it
COURSES = 72  # of the error that are kept
UNKNOWN = 1e6  # steps, prior sigma of T and of its change per row where it begins
# σ in steps per row^1.5: least (T is straight over 20 usual runs), largest (over one row), number
ROUGHNESS = (1e-5, 1.0, 26)


@dataclass(frozen=True)
class RoundedCovariate:
    """Posterior of a rounded covariate."""

    t_s: Array  # (n,) times, s from the epoch
    mean: Array  # (n,) in its unit
    courses: Array  # (n, r) of its error, √λ_k u_k, the strongest first

    def list_curves(self, t_s: Array) -> Iterator[Array]:
        """The mean at some times (k,), and the mean with each course of its error added."""
        mean = np.interp(t_s, self.t_s, self.mean)
        yield mean
        for course in self.courses.T:
            yield mean + np.interp(t_s, self.t_s, course)


def find_rounded_covariates(recording: Recording) -> Mapping[str, RoundedCovariate]:
    """Find the housekeeping columns whose rows in the intervals lie on a coarse lattice, and estimate their courses."""
    found = {}
    for name, tags, values in list_housekeeping_columns(recording):
        inside = np.any([(tags >= one.start_s) & (tags <= one.stop_s) for one in recording.intervals], axis=0)
        t_s, first = np.unique(tags[inside], return_index=True)
        rows = values[inside][first]
        step = find_lattice_step(rows)
        if step > 0 and np.mean(np.diff(rows) == 0) > HELD:
            found[name] = estimate_course(t_s, rows, step)
    return found


def estimate_course(t_s: Array, rows: Array, step: float) -> RoundedCovariate:
    """Estimate the course of a covariate from rows (n,) that are rounded to a step, at increasing times."""
    t_s, rows = _thin_rows(t_s, rows)
    spacing = float(np.median(np.diff(t_s)))
    nodes, values, variances, begins = _list_observations(t_s, rows / step, spacing)
    d = np.maximum(np.diff(nodes) / spacing, CLOSEST)
    y, weights = values - values.mean(), 1 / variances
    pull = np.zeros(2 * nodes.size)
    pull[::2] = weights * y

    def factor_precision(sigma: float) -> tuple[float, Array]:
        """Log likelihood but for a constant, and the banded root of the precision of T and its change."""
        root = scipy.linalg.cholesky_banded(_build_precision(d, begins, sigma, weights))
        explained = pull @ scipy.linalg.cho_solve_banded((root, False), pull)
        return 0.5 * explained - np.log(root[-1]).sum() - 2 * np.log(sigma) * np.count_nonzero(~begins), root

    tried = np.geomspace(*ROUGHNESS[:2], ROUGHNESS[2])
    _, root = max((factor_precision(float(sigma)) for sigma in tried), key=lambda pair: pair[0])
    mean = scipy.linalg.cho_solve_banded((root, False), pull)[::2] + values.mean()
    return RoundedCovariate(nodes, step * mean, step * _decompose_error(np.where(begins[1:], 0.0, d), root))


def _thin_rows(t_s: Array, rows: Array) -> tuple[Array, Array]:
    """Leave out rows, so that the run that a row is in, on average over the rows, has no more rows than are needed."""
    lengths = np.bincount(np.cumsum(np.append(False, np.diff(rows) != 0))).astype(float)
    stride = max(1, round(float(np.sum(lengths**2)) / rows.size / FINEST))
    return t_s[::stride], rows[::stride]


def _list_observations(t_s: Array, counts: Array, spacing: float) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Times, values and variances of rows and crossings in order of time, in steps, and where T begins anew."""
    change, missing = np.round(np.diff(counts)), np.diff(t_s) > GAP * spacing
    run = np.cumsum(np.append(False, (change != 0) | missing))
    lengths = np.bincount(run)
    rank = np.arange(run.size) - (np.cumsum(lengths) - lengths)[run]
    most = np.minimum(lengths, ROWS)[run]
    last = np.append(np.diff(run) > 0, True)  # a switch comes right after it
    kept = last | (rank * most // lengths[run] != (rank - 1) * most // lengths[run])
    used = np.bincount(run[kept])[run]
    anew = np.append(True, (np.abs(change) > 1) | missing)
    crosses = np.flatnonzero((np.abs(change) == 1) & ~missing)
    shorter = np.minimum(np.minimum(lengths[run[crosses]], lengths[run[crosses + 1]]), LONGEST)
    times = np.concatenate([t_s[kept], 0.5 * (t_s[crosses] + t_s[crosses + 1])])
    values = np.concatenate([counts[kept], 0.5 * (counts[crosses] + counts[crosses + 1])])
    variances = np.concatenate([used[kept] / 12, 1 / (12.0 * shorter**2)])
    order = np.argsort(times)
    return times[order], values[order], variances[order], np.append(anew[kept], np.zeros(crosses.size, bool))[order]


def _build_precision(d: Array, begins: NDArray[np.bool_], sigma: float, weights: Array) -> Array:
    """Build the banded precision (4, 2n) of T and its change at n nodes d apart, for `scipy.linalg.cholesky_banded`.

    The increment over d has the precision σ⁻² [[12/d³, −6/d²], [−6/d², 4/d]] (Särkkä and Solin, Applied Stochastic
    Differential Equations, section 6.2, inverted).
    """
    on = np.where(begins[1:], 0.0, sigma**-2)
    a, b, c = 12 * on / d**3, 6 * on / d**2, 4 * on / d
    band = np.zeros((4, 2 * weights.size))
    first = UNKNOWN**-2 * begins
    band[3, ::2] = weights + first + np.append(a, 0.0) + np.append(0.0, a)
    band[3, 1::2] = first + np.append(c, 0.0) + np.append(0.0, c)
    band[2, 1::2] = np.append(b, 0.0) - np.append(0.0, b)
    band[1, 2::2], band[1, 3::2] = -a, 0.5 * c
    band[0, 3::2] = b
    band[2, 2::2] = -b
    return band


def _decompose_error(d: Array, root: Array) -> Array:
    """Strongest courses (n, r) of the posterior covariance at nodes d rows apart, orthogonal in time."""
    weight = np.sqrt(0.5 * np.maximum(np.append(d, 0.0) + np.append(0.0, d), 1.0))

    def multiply_covariance(course: Array) -> Array:
        load = np.zeros(2 * weight.size)
        load[::2] = weight * course.ravel()
        return np.asarray(weight * scipy.linalg.cho_solve_banded((root, False), load)[::2])

    operator = scipy.sparse.linalg.LinearOperator((weight.size,) * 2, matvec=multiply_covariance, dtype=float)
    count = min(COURSES, weight.size - 1)
    powers, turned = scipy.sparse.linalg.eigsh(operator, count, v0=np.cos(np.arange(weight.size) ** 2.0))
    return np.asarray((turned * np.sqrt(np.maximum(powers, 0.0)) / weight[:, None])[:, ::-1])
