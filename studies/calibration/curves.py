"""Orders and crossings of error curves, and where a flight's value falls among simulated ones."""

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike


def summarise_with_flight(values: pd.Series, flight: float) -> dict[str, float]:
    """Median and 5–95 % range of simulated values, the flight's, and the percentage of them below it; NaN if it did not fly."""
    low, median, high = np.quantile(values, [0.05, 0.5, 0.95]) if len(values) else np.full(3, np.nan)
    percentile = np.nan if np.isnan(flight) else 100 * float((values < flight).mean())
    return {"median": median, "p05": low, "p95": high, "flight": flight, "flight_percentile": percentile}


def fit_log_slope(x: ArrayLike, y: ArrayLike) -> float:
    """Slope of log y over log x by least squares: the n of y ∝ xⁿ; NaN from fewer than two points above zero."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    good = (x > 0) & (y > 0)
    return float(np.polyfit(np.log(x[good]), np.log(y[good]), 1)[0]) if good.sum() > 1 else float("nan")


def find_level_crossing(x: ArrayLike, y: ArrayLike, level: float) -> float:
    """Find the first x at which y rises through the level, interpolated in log x and log y; NaN if there is none."""
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    above = np.flatnonzero((y[:-1] < level) & (y[1:] >= level))
    if above.size == 0:
        return float("nan")
    k = above[0]
    share = np.log(level / y[k]) / np.log(y[k + 1] / y[k])
    return float(x[k] * (x[k + 1] / x[k]) ** share)
