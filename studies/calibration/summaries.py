"""Summaries of rows: accuracy against the truth, orders and crossings of error curves, where a flight's value falls."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy.special
from numpy.typing import ArrayLike

from gyrocal.arrays import Array
from studies.montecarlo.statistics import compute_binomial_interval

SIGMA_LEVELS = {"68": 0.682689492137, "95": 0.954499736104, "99.7": 0.997300203937}  # 1, 2 and 3 sigma of a Gaussian


def count_covered(errors: Array, sigmas: Array, level: str) -> tuple[int, int]:
    """Count the errors within the level's k sigma, and all errors."""
    k = scipy.special.ndtri(0.5 + SIGMA_LEVELS[level] / 2)
    inside = np.abs(errors) <= k * sigmas
    return int(inside.sum()), int(inside.size)


def tabulate_accuracy(errors: Array, sigmas: Array, names: Sequence[str], units: Sequence[str]) -> pd.DataFrame:
    """Tabulate bias, spread, formal sigma and coverage of each parameter over cases, from errors and sigmas (n, p)."""
    bias, spread = errors.mean(axis=0), errors.std(axis=0, ddof=1)
    standard_error = spread / np.sqrt(len(errors))
    table = pd.DataFrame(
        {
            "parameter": names,
            "unit": units,
            "bias": bias,
            "standard_error": standard_error,
            "bias_in_standard_errors": bias / standard_error,
            "spread": spread,
            "formal_sigma": np.sqrt(np.mean(sigmas**2, axis=0)),
        }
    )
    table["spread_over_formal"] = table["spread"] / table["formal_sigma"]
    for level in SIGMA_LEVELS:
        counts = [count_covered(errors[:, j], sigmas[:, j], level) for j in range(errors.shape[1])]
        table[f"coverage_{level}"] = [inside / total for inside, total in counts]
        limits = np.array([compute_binomial_interval(*count) for count in counts])
        table[f"coverage_{level}_low"], table[f"coverage_{level}_high"] = limits[:, 0], limits[:, 1]
    return table


def summarise_distribution(samples: Array, flight: Array | None = None) -> pd.DataFrame:
    """Compute mean, deviation, 5–95 % range of each column of samples (n, cells), and the percentiles of flight (cells,).

    flight_percentile is the share of samples below the flight's value, in percent, with ties counted half.
    """
    table = pd.DataFrame(
        {
            "mean": samples.mean(axis=0),
            "std": samples.std(axis=0, ddof=1),
            "p05": np.quantile(samples, 0.05, axis=0),
            "p95": np.quantile(samples, 0.95, axis=0),
            "flight": np.nan,
            "flight_percentile": np.nan,
        }
    )
    if flight is not None:
        table["flight"] = flight
        table["flight_percentile"] = 100 * ((samples < flight).mean(axis=0) + 0.5 * (samples == flight).mean(axis=0))
    return table


def summarise_with_flight(values: pd.Series, flight: float) -> dict[str, float]:
    """Compute median and 5–95 % range of simulated values, and the percentage below the flight's; NaN without it."""
    low, median, high = np.quantile(values, [0.05, 0.5, 0.95]) if len(values) else np.full(3, np.nan)
    percentile = np.nan if np.isnan(flight) else 100 * float((values < flight).mean())
    return {"median": median, "p05": low, "p95": high, "flight": flight, "flight_percentile": percentile}


def fit_log_slope(x: ArrayLike, y: ArrayLike) -> float:
    """Fit the slope of log y over log x by least squares: n of y ∝ xⁿ; NaN from fewer than two points above zero."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    is_positive = (x > 0) & (y > 0)
    return float(np.polyfit(np.log(x[is_positive]), np.log(y[is_positive]), 1)[0]) if is_positive.sum() > 1 else float("nan")


def find_level_crossing(x: ArrayLike, y: ArrayLike, level: float) -> float:
    """Find the first x at which y rises through the level, interpolated in log x and log y; NaN if there is none."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    crossings = np.flatnonzero((y[:-1] < level) & (y[1:] >= level))
    if crossings.size == 0:
        return float("nan")
    k = crossings[0]
    fraction = np.log(level / y[k]) / np.log(y[k + 1] / y[k])
    return float(x[k] * (x[k + 1] / x[k]) ** fraction)
