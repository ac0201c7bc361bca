"""Where a gyro is silent: how likely the reading of each sample holds no rate but noise.

Means over short windows are a hidden chain of two states (Rabiner, Proceedings of the IEEE 77, 1989, section III). In the
silent one a mean is N(0, σ²); in the other it has a size of a few to hundreds of σ, log-uniform. Either lasts for tens of
windows, so that a motion that passes through zero is not silent, nor is a window across the edge of a silence wholly so.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.special
from numpy.typing import NDArray

from gyrocal.compiled import compiled

Array = NDArray[np.float64]

SIZES = np.geomspace(2.0, 200.0, 8)  # sigmas of a window's mean where there is a rate
STAY = 50.0  # windows that a state lasts on average


def silent(x: Array, parts: Sequence[slice], noise: float, count: int) -> Array:
    """Probability that each sample holds no rate; (n,), zero outside the intervals.

    Parameters
    ----------
    x : (n,) raw rates of one gyro, rad/s
    parts : samples of each interval
    noise : white noise of a sample, rad/s
    count : samples of a window
    """
    out = np.zeros(x.size)
    for part in parts:
        own = x[part]
        if not own.size:
            continue
        first = np.arange(0, own.size, count)
        sizes = np.diff(np.append(first, own.size))
        z = np.add.reduceat(own, first) / (noise * np.sqrt(sizes))
        out[part] = np.repeat(_chain(np.column_stack([-0.5 * z**2, _of_a_rate(z)]), STAY), sizes)
    return out


def _of_a_rate(z: Array) -> Array:
    """Log likelihood of means in their sigmas where there is a rate, less log √2π."""
    spread = np.hypot(1.0, SIZES)
    each = -0.5 * (z[:, None] / spread) ** 2 - np.log(spread)
    return np.asarray(scipy.special.logsumexp(each, axis=1) - np.log(SIZES.size))


@compiled
def _chain(log_likelihood: Array, stay: float) -> Array:
    """(n,) probability of the first of two states, by the forward and the backward recursion."""
    n, leave = log_likelihood.shape[0], 1.0 / stay
    forward = np.empty(n)
    one = 0.5
    for k in range(n):
        difference = log_likelihood[k, 1] - log_likelihood[k, 0]
        before = one * (1 - leave) + (1 - one) * leave
        one = before / (before + (1 - before) * np.exp(min(difference, 700.0)))
        forward[k] = one
    found = np.empty(n)
    later = 0.5
    for k in range(n - 1, -1, -1):
        a, b = forward[k] * later, (1 - forward[k]) * (1 - later)
        found[k] = a / (a + b) if a + b > 0 else forward[k]
        difference = log_likelihood[k, 1] - log_likelihood[k, 0]
        here = later / (later + (1 - later) * np.exp(min(difference, 700.0))) if later > 0 else 0.0
        later = here * (1 - leave) + (1 - here) * leave
    return found
