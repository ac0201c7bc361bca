"""The printed table of a calibration, the simulator's prediction of it, and the numbers that compare both.

The last digits printed are those of Table 2, Table 3, R (9) and, for the intervals' times, Table 1.

A table is judged by two sets of numbers, which share no noise. With y and c, the residuals before and after calibration, as in
`studies.natanson.flight_diagnosis`:

- *Motion*, 18 numbers: d = y − c − prediction. Their errors are those of print: cells to 0.001 deg, the intervals' times to
  15 s, Table 3 and R (9) to their last digits (which correlates the intervals through Θ), and one second-iteration correction
  (N Table 5), since the papers do not say which iterate c belongs to.
- *Noise*, 6 + 36 numbers: c orthogonal to the columns of Θ (six numbers that no calibration can absorb, with any weights), of
  covariance V = 2σ² + a²T (references at both ends, gyro), and the differences between the step columns, a²T and 2a²T.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product

import numpy as np
import pandas as pd
from scipy.special import chdtrc, logsumexp

from gyrocal.arrays import Array
from simulator import scenario as scenarios
from simulator.scenario import IntervalSection, Scenario
from studies.natanson import flight, flight_gap

# Last digits printed: Table 2 in deg; Table 3 before launch (its scale factors of one are exact), R (9); G, then b in deg/s.
CELL_DEG = 1e-3
CLOCK_S = 15.0  # Table 1's times are multiples of it
MILLIDEGREE = np.deg2rad(1e-3)
INITIAL_DIGITS = np.append(MILLIDEGREE * (1 - np.eye(3)).ravel(), np.deg2rad([1e-6, 1e-6, 1e-6]))
PUBLISHED_DIGITS = np.array([1e-6, 1e-6, 1e-9, 1e-9, 1e-5, 1e-7, 1e-9, 1e-7, 1e-5, *np.deg2rad([1e-10, 1e-10, 1e-11])])


@dataclass(frozen=True)
class ResidualTable:
    """The numbers of a calibration that the paper prints."""

    before: Array  # before, after: (6, 3) residuals at 0.5 s before and after calibration, deg
    after: Array
    coarser: Array  # (2, 6, 3) residuals before calibration at 1 and 2 s, deg
    published: Array  # (12,) the calibration; G, and b in rad/s


def read_flight_residual_table() -> ResidualTable:
    """Read the flight's table."""
    coarser = np.array([flight.read_published_residuals("prelaunch", step) for step in flight.FLIGHT_STEPS_S[1:]])
    return ResidualTable(
        flight.read_published_residuals("prelaunch"),
        flight.read_published_residuals("calibrated"),
        coarser,
        flight.read_published_calibration().vector,
    )


def round_to_digits(values: Array, digits: Array | float) -> Array:
    """Round values to their printed digits; digits of zero are exact."""
    digits = np.broadcast_to(digits, np.shape(values))
    return np.asarray(np.where(digits > 0, np.round(values / np.where(digits > 0, digits, 1.0)) * digits, values))


@dataclass(frozen=True)
class Baseline:
    """Assumptions of the simulator: scenario and noise."""

    name: str  # for people
    scenario: Scenario  # motion and noise
    noise_factor: float = 1.0  # on the scenario's noise
    wrong: str = ""  # effect of a deliberate error

    def compute_variances(self) -> tuple[Array, Array]:
        """Compute the variance (6,) of a residual, and its gyro part a²T, deg²."""
        T = np.array([interval.stop_s - interval.start_s for interval in self.scenario.interval])
        gyro = self.noise_factor**2 * self.scenario.gyro.arw_deg_per_sqrt_s**2 * T
        sigma = np.mean(np.square(self.scenario.reference.sigma_deg))
        return gyro + 2 * self.noise_factor**2 * sigma, gyro


def load_present_baseline() -> Baseline:
    """Load the simulator's present assumptions."""
    return Baseline("as assumed", scenarios.load("trmm"))


@cache
def load_coarse_trmm() -> Scenario:
    """Load the scenario whose orbit and sampling every prediction uses, with coarse samples."""
    return scenarios.override(scenarios.load("trmm"), {"gyro.sample_s": flight_gap.COARSE_SAMPLE_S})


@lru_cache(maxsize=4096)
def _simulate_interval(section: IntervalSection) -> tuple[Array, Array]:
    """Simulate noise-free residuals (3,) deg of an interval and Θ (3, 12); its start does not matter on a circular orbit."""
    shifted = section.model_copy(update={"start_s": 0.0, "stop_s": section.stop_s - section.start_s})
    scenario = load_coarse_trmm().model_copy(update={"interval": (shifted,)})
    theta, Theta = flight_gap.compute_residuals(flight_gap.simulate_without_noise(scenario))
    return theta[0], Theta[0]


def simulate_residuals(sections: Sequence[IntervalSection]) -> tuple[Array, Array]:
    """Simulate noise-free residuals (n, 3) deg and Θ (n, 3, 12) deg per unit, R (9) as truth and Table 3 a priori."""
    theta, Theta = zip(*map(_simulate_interval, sections), strict=True)
    return np.array(theta), np.array(Theta)


def reverse_intervals(sections: Sequence[IntervalSection], flips: Collection[int]) -> tuple[IntervalSection, ...]:
    """Reverse the slews of some intervals: yaws in the opposite direction; +y forward in place of −y."""
    reversed_sections = list(sections)
    for k in flips:
        slews = tuple(slew.model_copy(update={"angle_deg": -slew.angle_deg}) for slew in sections[k].slew)
        reversed_sections[k] = sections[k].model_copy(update={"slew": slews})
    return tuple(reversed_sections)


NOISE_FACTORS = np.geomspace(0.1, 10.0, 81)
RESIDUAL_PLACES = list(product(range(6), flight.ROTATIONS))  # interval, counted from 0, and axis of each number


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

    def predict(self, sections: Sequence[IntervalSection]) -> Array:
        """Predict the residuals (n, 3) of an interval flown in other ways, deg."""
        theta, Theta = simulate_residuals(sections)
        return np.asarray(theta - Theta @ self.shift)


def compute_motion_numbers(table: ResidualTable, baseline: Baseline, flips: Collection[int] = ()) -> MotionNumbers:
    """Compute the motion numbers under a baseline with the slews of some intervals reversed."""
    sections = reverse_intervals(baseline.scenario.interval, flips)
    theta, Theta = simulate_residuals(sections)
    shift = table.published - flight.read_published_calibration().vector
    prediction = theta - Theta @ shift
    d = (table.before - table.after - prediction).ravel()
    return MotionNumbers(sections, d, prediction, compute_motion_covariance(Theta, sections), Theta, shift)


def differentiate_by_clock(section: IntervalSection, step_s: float = 4.0) -> Array:
    """Differentiate residuals by the interval's start and by its stop while the motion stays, (3, 2) deg/s."""
    later = section.model_copy(update={"stop_s": section.stop_s + step_s})
    slews = tuple(slew.model_copy(update={"start_s": slew.start_s + step_s}) for slew in section.slew)
    hold = section.hold
    if hold:
        hold = hold.model_copy(update={"start_s": hold.start_s + step_s, "stop_s": hold.stop_s + step_s})
    earlier = later.model_copy(update={"slew": slews, "hold": hold})
    theta, _ = simulate_residuals([section, earlier, later])
    return np.asarray((theta[1:] - theta[0]).T / step_s)


def compute_motion_covariance(Theta: Array, sections: Sequence[IntervalSection]) -> Array:
    """Compute the covariance of d from the rounding of the print, (18, 18) deg²; Theta (6, 3, 12) deg per unit."""
    H = Theta.reshape(18, 12)
    clock = np.zeros((18, 18))
    for k, section in enumerate(sections):
        change = differentiate_by_clock(section) * CLOCK_S
        clock[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = change @ change.T / 12
    digits = (INITIAL_DIGITS**2 + PUBLISHED_DIGITS**2) / 12
    G, bias = flight.read_published_corrections(2)
    second = H @ np.concatenate([G.ravel(), np.deg2rad(bias)])
    return np.asarray(2 * CELL_DEG**2 / 12 * np.eye(18) + clock + H * digits @ H.T + np.outer(second, second))


# ---- noise ---------------------------------------------------------------------------------------------------------------


def compute_noise_numbers(table: ResidualTable, Theta: Array, baseline: Baseline) -> tuple[Array, Array]:
    """Compute the 42 noise numbers, whitened under the baseline, and the variance of rounding in each, (42,).

    c is projected on the complement of Θ's columns, which removes the part that the flight's estimator absorbed.
    """
    total, gyro = baseline.compute_variances()
    H = Theta.reshape(18, 12) / np.linalg.norm(Theta.reshape(18, 12), axis=0)
    V = np.repeat(total, 3)
    whiten = 1 / np.sqrt(V)
    U = np.linalg.svd(H * whiten[:, None])[0][:, 12:]
    # Rounding adds little to V: it enters as a variance of each of the six numbers, without their correlation.
    z = U.T @ (table.after.ravel() * whiten)
    z_print = CELL_DEG**2 / 12 * np.sum((U * whiten[:, None]) ** 2, axis=0)
    columns = [table.before, *table.coarser]
    steps = np.array([columns[1] - columns[0], (columns[2] - columns[1]) / np.sqrt(2)]) / np.sqrt(gyro)[:, None]
    steps_print = CELL_DEG**2 / 6 * np.array([1.0, 0.5])[:, None, None] / np.broadcast_to(gyro[:, None], (2, 6, 3))
    return np.concatenate([z, steps.ravel()]), np.concatenate([z_print, steps_print.ravel()])


def estimate_noise_level(table: ResidualTable, Theta: Array, baseline: Baseline) -> tuple[float, float, float]:
    """Estimate the noise over the baseline's: log evidence of another level, mean and sigma of the factor."""
    z, z_print = compute_noise_numbers(table, Theta, baseline)
    variance = np.append(NOISE_FACTORS, 1.0)[:, None] ** 2 + z_print
    # log likelihood of each factor, and last of the baseline's own noise; the prior is uniform over the factors
    *log_likelihoods, log_likelihood_baseline = -0.5 * np.sum(z**2 / variance + np.log(variance), axis=1)
    total = logsumexp(log_likelihoods)
    weight = np.exp(log_likelihoods - total)
    mean = float(weight @ NOISE_FACTORS)
    sigma = float(np.sqrt(weight @ (NOISE_FACTORS - mean) ** 2))
    return float(total - np.log(len(log_likelihoods)) - log_likelihood_baseline), mean, sigma


# ---- tests of a misfit, and its place ------------------------------------------------------------------------------------


def adjust_by_holm(p: Array) -> Array:
    """Adjust p-values by Holm's method."""
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    result = np.empty_like(p)
    result[order] = np.minimum(adjusted, 1.0)
    return result


def compute_misfit_p(table: ResidualTable, baseline: Baseline) -> dict[str, float]:
    """Compute χ² of the 18 motion and 42 noise numbers under the baseline, the latter two-sided, and Holm's p of both."""
    numbers = compute_motion_numbers(table, baseline)
    motion_chi2 = float(numbers.d @ np.linalg.solve(numbers.covariance, numbers.d))
    z, z_print = compute_noise_numbers(table, numbers.Theta, baseline)
    noise_chi2 = float(np.sum(z**2 / (1 + z_print)))
    upper = float(chdtrc(42, noise_chi2))
    p = adjust_by_holm(np.array([chdtrc(18, motion_chi2), 2 * min(upper, 1 - upper)]))
    chi2 = {"motion_chi2": motion_chi2, "noise_chi2": noise_chi2}
    return chi2 | {"motion_p": float(p[0]), "noise_p": float(p[1]), "p_value": float(p.min())}


def locate_misfit(table: ResidualTable, baseline: Baseline) -> pd.DataFrame:
    """Build a row per number: the gap, d and its sigma, and Holm's p over the 18 numbers and over the intervals."""
    numbers = compute_motion_numbers(table, baseline)
    sigma = np.sqrt(np.diag(numbers.covariance))
    blocks = [slice(3 * k, 3 * k + 3) for k in range(6)]
    chi2 = (numbers.d / sigma) ** 2
    interval_chi2 = np.array([numbers.d[b] @ np.linalg.solve(numbers.covariance[b, b], numbers.d[b]) for b in blocks])
    return pd.DataFrame(
        {
            "interval": [k + 1 for k, _ in RESIDUAL_PLACES],
            "axis": [name for _, name in RESIDUAL_PLACES],
            "gap_deg": (table.before - numbers.prediction).ravel(),
            "beyond_calibration_deg": numbers.d,
            "sigma_deg": sigma,
            "p_holm": adjust_by_holm(chdtrc(1, chi2)),
            "interval_p_holm": np.repeat(adjust_by_holm(chdtrc(3, interval_chi2)), 3),
        }
    )
