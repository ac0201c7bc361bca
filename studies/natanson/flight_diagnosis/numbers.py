"""The two sets of numbers a table is judged by, which share no noise, and what print leaves in each.

With y and c, the residuals before and after calibration, as in `studies.natanson.flight_diagnosis`:

- *Motion*, 18 numbers: d = y − c − prediction. What is left in them is print: cells to 0.001 deg, the intervals' times to 15 s,
  Table 3 and R (9) to their last digits (which correlates the intervals through Θ), and one second-iteration correction (N
  Table 5), since the papers do not say which iterate c belongs to.
- *Noise*, 6 + 36 numbers: c off the columns of Θ (the six numbers no calibration can take away, whatever its weights), of
  covariance V = 2σ² + a²T (references at both ends, gyro), and the differences between the step columns, a²T and 2a²T.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from simulator.scenario import IntervalSection
from studies.natanson import flight
from studies.natanson.flight_diagnosis.table import (
    CELL_DEG,
    CLOCK_S,
    INITIAL_DIGITS,
    PUBLISHED_DIGITS,
    Baseline,
    Table,
    outcome,
    outcomes,
    reversed_slews,
)

Array = NDArray[np.float64]

NOISE_FACTORS = np.geomspace(0.1, 10.0, 81)


def log_normal(residuals: Array, covariance: Array) -> Array:
    """Log density of rows (n, m) with zero mean."""
    L = np.linalg.cholesky(covariance)
    z = np.linalg.inv(L) @ residuals.T  # of a few rows: faster than a solve, and as good at these condition numbers
    return np.asarray(-0.5 * np.sum(z**2, axis=0) - np.log(np.diag(L)).sum() - 0.5 * len(L) * np.log(2 * np.pi))


@lru_cache(maxsize=256)
def clock_derivatives(section: IntervalSection, step_s: float = 4.0) -> Array:
    """What a second of the interval's start and of its stop does to its residuals while the motion stays, (3, 2) deg/s."""
    later = section.model_copy(update={"stop_s": section.stop_s + step_s})
    slews = tuple(slew.model_copy(update={"start_s": slew.start_s + step_s}) for slew in section.slew)
    hold = section.hold and section.hold.model_copy(
        update={"start_s": section.hold.start_s + step_s, "stop_s": section.hold.stop_s + step_s}
    )
    earlier = later.model_copy(update={"slew": slews, "hold": hold})
    theta, _ = outcomes([section, earlier, later])
    return np.asarray((theta[1:] - theta[0]).T / step_s)


def motion_covariance(Theta: Array, sections: Sequence[IntervalSection]) -> Array:
    """What print leaves of d, (18, 18) deg²; Theta (6, 3, 12) deg per unit."""
    H = Theta.reshape(18, 12)
    clock = np.zeros((18, 18))
    for k, section in enumerate(sections):
        moved = clock_derivatives(section) * CLOCK_S
        clock[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = moved @ moved.T / 12
    digits = (INITIAL_DIGITS**2 + PUBLISHED_DIGITS**2) / 12
    G, bias = flight.corrections(2)
    second = H @ np.concatenate([G.ravel(), np.deg2rad(bias)])
    return np.asarray(2 * CELL_DEG**2 / 12 * np.eye(18) + clock + H * digits @ H.T + np.outer(second, second))


@dataclass(frozen=True)
class Prepared:
    """A table against a baseline, some of its slews reversed.

    Attributes
    ----------
    flips : intervals whose slews are reversed
    sections : the six intervals
    target : (18,) y − c, deg
    prediction : (18,) deg
    covariance : (18, 18) of d, deg²
    shift : (12,) published minus R (9)
    noise : log likelihood of the noise numbers at `NOISE_FACTORS`, and at one
    """

    flips: tuple[int, ...]
    sections: tuple[IntervalSection, ...]
    target: Array
    prediction: Array
    covariance: Array
    shift: Array
    noise: tuple[Array, float]

    @property
    def d(self) -> Array:
        """(18,) deg."""
        return self.target - self.prediction


def noise_numbers(table: Table, Theta: Array, baseline: Baseline) -> tuple[Array, Array]:
    """The 42 numbers of the noise, whitened under the baseline, and the share of print in the variance of each, (42,).

    c is projected off Θ's columns, which takes out whatever the flight's estimator made of the noise.
    """
    total, gyro = baseline.variances()
    H = Theta.reshape(18, 12) / np.linalg.norm(Theta.reshape(18, 12), axis=0)
    V = np.repeat(total, 3)
    whiten = 1 / np.sqrt(V)
    U = np.linalg.svd(H * whiten[:, None])[0][:, 12:]
    # Print adds to V but little: kept as a variance of each of the six numbers, without their correlation.
    z = U.T @ (table.after.ravel() * whiten)
    z_print = CELL_DEG**2 / 12 * np.sum((U * whiten[:, None]) ** 2, axis=0)
    columns = [table.before, *table.coarser]
    steps = np.array([columns[1] - columns[0], (columns[2] - columns[1]) / np.sqrt(2)]) / np.sqrt(gyro)[:, None]
    steps_print = CELL_DEG**2 / 6 * np.array([1.0, 0.5])[:, None, None] / np.broadcast_to(gyro[:, None], (2, 6, 3))
    return np.concatenate([z, steps.ravel()]), np.concatenate([z_print, steps_print.ravel()])


def _noise_likelihood(z: Array, z_print: Array, factors: Array) -> Array:
    variance = factors[:, None] ** 2 + z_print
    return np.asarray(-0.5 * np.sum(z**2 / variance + np.log(2 * np.pi * variance), axis=1))


def prepare(table: Table, baseline: Baseline, flips: tuple[int, ...] = ()) -> Prepared:
    """Predict under the baseline with some slews reversed."""
    sections = tuple(reversed_slews(s) if k in flips else s for k, s in enumerate(baseline.scenario.interval))
    theta, Theta = (np.array(part) for part in zip(*(outcome(section) for section in sections), strict=True))
    shift = table.published - flight.calibration().vector
    z, z_print = noise_numbers(table, Theta, baseline)
    likelihood = _noise_likelihood(z, z_print, np.append(NOISE_FACTORS, 1.0))
    return Prepared(
        flips=flips,
        sections=sections,
        target=(table.before - table.after).ravel(),
        prediction=(theta - Theta @ shift).ravel(),
        covariance=motion_covariance(Theta, sections),
        shift=shift,
        noise=(likelihood[:-1], float(likelihood[-1])),
    )


def noise_factor(table: Table, baseline: Baseline, flips: tuple[int, ...] = ()) -> tuple[float, float]:
    """Noise over the baseline's: mean and sigma."""
    curve = prepare(table, baseline, flips).noise[0]
    weight = np.exp(curve - logsumexp(curve))
    mean = float(weight @ NOISE_FACTORS)
    return mean, float(np.sqrt(weight @ (NOISE_FACTORS - mean) ** 2))
