"""The two sets of numbers a table is judged by, which share no noise, and what print leaves in each.

With y and c, the residuals before and after calibration, as in `studies.natanson.flight_diagnosis`:

- *Motion*, 18 numbers: d = y − c − prediction. What is left in them is print: cells to 0.001 deg, the intervals' times to 15 s,
  Table 3 and R (9) to their last digits (which correlates the intervals through Θ), and one second-iteration correction (N
  Table 5), since the papers do not say which iterate c belongs to.
- *Noise*, 6 + 36 numbers: c off the columns of Θ (the six numbers no calibration can take away, whatever its weights), of
  covariance V = 2σ² + a²T (references at both ends, gyro), and the differences between the step columns, a²T and 2a²T.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import chdtrc, logsumexp

from simulator.scenario import IntervalSection
from studies.natanson import flight
from studies.natanson.flight_diagnosis.table import (
    CELL_DEG,
    CLOCK_S,
    INITIAL_DIGITS,
    PUBLISHED_DIGITS,
    Baseline,
    ResidualTable,
    reverse_slews,
    simulate_each_interval,
    simulate_residuals,
    simulate_residuals_cached,
)

Array = NDArray[np.float64]

NOISE_FACTORS = np.geomspace(0.1, 10.0, 81)
RESIDUAL_PLACES = [
    (k, name) for k in range(6) for name in flight.ROTATIONS
]  # interval, counted from 0, and axis of each number


# ---- motion --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MotionNumbers:
    """A table's motion numbers against a baseline, some of its slews reversed."""

    sections: tuple[IntervalSection, ...]  # the six intervals
    d: Array  # (18,) y − c less the prediction, deg
    prediction: Array  # (6, 3) deg
    covariance: Array  # (18, 18) of d, deg²
    Theta: Array  # (6, 3, 12) deg per unit
    shift: Array  # (12,) published minus R (9)

    def predicted(self, sections: Sequence[IntervalSection]) -> Array:
        """Residuals (n, 3) of intervals flown in another way, deg."""
        theta, Theta = simulate_residuals_cached(tuple(sections))
        return np.asarray(theta - Theta @ self.shift)


def compute_motion_numbers(table: ResidualTable, baseline: Baseline, flips: Collection[int] = ()) -> MotionNumbers:
    """The motion numbers under a baseline with the slews of some intervals reversed."""
    sections = tuple(reverse_slews(s) if k in flips else s for k, s in enumerate(baseline.scenario.interval))
    theta, Theta = simulate_each_interval(sections)
    shift = table.published - flight.read_published_calibration().vector
    prediction = theta - Theta @ shift
    d = (table.before - table.after - prediction).ravel()
    return MotionNumbers(sections, d, prediction, compute_motion_covariance(Theta, sections), Theta, shift)


@lru_cache(maxsize=256)
def differentiate_by_clock(section: IntervalSection, step_s: float = 4.0) -> Array:
    """What a second of the interval's start and of its stop does to its residuals while the motion stays, (3, 2) deg/s."""
    later = section.model_copy(update={"stop_s": section.stop_s + step_s})
    slews = tuple(slew.model_copy(update={"start_s": slew.start_s + step_s}) for slew in section.slew)
    hold = section.hold and section.hold.model_copy(
        update={"start_s": section.hold.start_s + step_s, "stop_s": section.hold.stop_s + step_s}
    )
    earlier = later.model_copy(update={"slew": slews, "hold": hold})
    theta, _ = simulate_residuals([section, earlier, later])
    return np.asarray((theta[1:] - theta[0]).T / step_s)


def compute_motion_covariance(Theta: Array, sections: Sequence[IntervalSection]) -> Array:
    """Compute the covariance of d from the rounding of the print, (18, 18) deg²; Theta (6, 3, 12) deg per unit."""
    H = Theta.reshape(18, 12)
    clock = np.zeros((18, 18))
    for k, section in enumerate(sections):
        moved = differentiate_by_clock(section) * CLOCK_S
        clock[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = moved @ moved.T / 12
    digits = (INITIAL_DIGITS**2 + PUBLISHED_DIGITS**2) / 12
    G, bias = flight.read_published_corrections(2)
    second = H @ np.concatenate([G.ravel(), np.deg2rad(bias)])
    return np.asarray(2 * CELL_DEG**2 / 12 * np.eye(18) + clock + H * digits @ H.T + np.outer(second, second))


# ---- noise ---------------------------------------------------------------------------------------------------------------


def compute_noise_numbers(table: ResidualTable, Theta: Array, baseline: Baseline) -> tuple[Array, Array]:
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


def estimate_noise_level(table: ResidualTable, Theta: Array, baseline: Baseline) -> tuple[float, float, float]:
    """Noise over the baseline's: log evidence that it is another one, mean and sigma of the factor."""
    z, z_print = compute_noise_numbers(table, Theta, baseline)
    variance = np.append(NOISE_FACTORS, 1.0)[:, None] ** 2 + z_print
    *curve, one = -0.5 * np.sum(z**2 / variance + np.log(variance), axis=1)
    total = logsumexp(curve)
    weight = np.exp(curve - total)
    mean = float(weight @ NOISE_FACTORS)
    sigma = float(np.sqrt(weight @ (NOISE_FACTORS - mean) ** 2))
    return float(total - np.log(len(curve)) - one), mean, sigma


# ---- whether there is a gap, and where -------------------------------------------------------------------------------------


def adjust_by_holm(p: Array) -> Array:
    """Adjust p-values by Holm's method."""
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    out = np.empty_like(p)
    out[order] = np.minimum(adjusted, 1.0)
    return out


def compute_misfit_p(table: ResidualTable, baseline: Baseline) -> dict[str, float]:
    """χ² of the motion's 18 and of the noise's 42 numbers under the baseline, the latter two-sided, and Holm's p of both."""
    case = compute_motion_numbers(table, baseline)
    motion_chi2 = float(case.d @ np.linalg.solve(case.covariance, case.d))
    z, z_print = compute_noise_numbers(table, case.Theta, baseline)
    noise_chi2 = float(np.sum(z**2 / (1 + z_print)))
    upper = float(chdtrc(42, noise_chi2))
    p = adjust_by_holm(np.array([chdtrc(18, motion_chi2), 2 * min(upper, 1 - upper)]))
    return {
        "motion_chi2": motion_chi2,
        "motion_p": float(p[0]),
        "noise_chi2": noise_chi2,
        "noise_p": float(p[1]),
        "p_value": float(p.min()),
    }


def locate_misfit(table: ResidualTable, baseline: Baseline) -> pd.DataFrame:
    """A row per number: d over its sigma, χ² of it and of its interval, and Holm's p over the 18 numbers and six intervals."""
    case = compute_motion_numbers(table, baseline)
    sigma = np.sqrt(np.diag(case.covariance))
    blocks = [slice(3 * k, 3 * k + 3) for k in range(6)]
    chi2 = (case.d / sigma) ** 2
    interval_chi2 = np.array([case.d[b] @ np.linalg.solve(case.covariance[b, b], case.d[b]) for b in blocks])
    return pd.DataFrame(
        {
            "interval": [k + 1 for k, _ in RESIDUAL_PLACES],
            "axis": [name for _, name in RESIDUAL_PLACES],
            "gap_deg": (table.before - case.prediction).ravel(),
            "beyond_calibration_deg": case.d,
            "sigma_deg": sigma,
            "chi2": chi2,
            "p_holm": adjust_by_holm(chdtrc(1, chi2)),
            "interval_chi2": np.repeat(interval_chi2, 3),
            "interval_p_holm": np.repeat(adjust_by_holm(chdtrc(3, interval_chi2)), 3),
        }
    )
