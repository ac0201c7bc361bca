"""A step of the rate inside a stretch, which an Allan deviation shows as slow noise or a ramp.

The means of a stretch over up to `BINS` equal times are fitted by a straight line, and by two levels with a step at the time
where that fits best. A step is named where the second explains them far better and leaves what is white: of a ramp the line
fits better, and of noise that wanders neither leaves white noise (its changes are too small for its scatter; von Neumann,
Annals of Mathematical Statistics 12, 1941).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BINS = 256
FEWEST_BINS = 16
STEP_CHI2_MARGIN = 50.0  # by how much the two levels' χ² is below that of the line, of noise that the levels leave
WHITE_VARIANCE_RATIO = 1.7  # mean square change from bin to bin over the variance, at least; 2 for white noise


@dataclass(frozen=True)
class RateStep:
    """A step of the rate."""

    at: int  # sample from which on the rate is another
    size: float  # rad/s


def find_rate_step(rates: Array) -> RateStep | None:
    """The step that explains the course of a stretch's rates (n,), rad/s; None where a line or noise explains it as well."""
    each = max(1, rates.size // BINS)
    count = rates.size // each
    if count < FEWEST_BINS:
        return None
    means = rates[: count * each].reshape(count, each).mean(axis=1)
    before = np.arange(1, count)
    low = np.cumsum(means)[:-1] / before
    high = (means.sum() - np.cumsum(means)[:-1]) / (count - before)
    explained = before * (count - before) / count * (high - low) ** 2
    best = int(np.argmax(explained))
    left = means - np.where(np.arange(count) <= best, low[best], high[best])
    of_line = means - np.polynomial.Polynomial.fit(np.arange(count), means, 1)(np.arange(count))
    variance = float(np.sum(left**2)) / (count - 3)
    better = float(np.sum(of_line**2) - np.sum(left**2))
    white = float(np.mean(np.diff(left) ** 2)) / max(variance, 1e-300)
    if better < STEP_CHI2_MARGIN * variance or white < WHITE_VARIANCE_RATIO:
        return None
    return RateStep((best + 1) * each, float(high[best] - low[best]))
