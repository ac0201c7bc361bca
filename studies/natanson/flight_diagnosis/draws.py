"""Integrals over the timings by importance sampling: draws from the prior, weighed by the numbers they are to explain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from studies.natanson.flight_diagnosis.numbers import Prepared, log_normal
from studies.natanson.flight_diagnosis.table import sign_of
from studies.natanson.flight_diagnosis.timings import (
    COMMON,
    COMMON_CLOUD,
    TIMINGS,
    cloud,
    common_cloud,
    common_points,
    cube,
    shifted,
    surrogate,
)
from studies.natanson.flight_gap import MINUS_Y, YAW_INTERVALS

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

DRAWS = 1024
WIDENED = 2.0  # covariance of the sampling density over that of the likelihood


@dataclass(frozen=True)
class Draws:
    """Timings drawn near what the data want, and what corrects for that.

    Attributes
    ----------
    predictions : interval to predicted residuals (n, 3), deg
    log_weight : (n,) log of prior over sampling density
    timings : names to (n,) values
    """

    predictions: dict[int, Array]
    log_weight: Array
    timings: dict[str, Array]


def _systematic(log_weight: Array, seed: int) -> tuple[Indices, Array]:
    """`DRAWS` indices in proportion to the weights, in random order, and the log of each one's share."""
    share = np.exp(log_weight - logsumexp(log_weight))
    edges = np.cumsum(share)
    chosen = np.minimum(np.searchsorted(edges, (np.arange(DRAWS) + 0.5) / DRAWS * edges[-1]), len(share) - 1)
    np.random.default_rng(seed).shuffle(chosen)  # so that two intervals' draws do not go hand in hand
    return chosen, np.log(share[chosen])


def own_draws(case: Prepared, k: int, used: NDArray[np.bool_] | None = None) -> Draws:
    """Timings of interval k by itself, drawn by those of its three numbers that are used."""
    u, values = cloud(k, sign_of(case.sections[k]))
    predictions = shifted(values, case.shift)
    rows = np.arange(3 * k, 3 * k + 3)[np.ones(3, dtype=bool) if used is None else used]
    log_weight = np.zeros(len(u))
    if rows.size:
        spread = WIDENED * case.covariance[np.ix_(rows, rows)]
        log_weight = log_normal(case.target[rows] - predictions[:, rows - 3 * k], spread)
    chosen, log_share = _systematic(log_weight, k)
    names = TIMINGS[k].names
    timings = dict(zip((f"m{k + 1} {name}" for name in names), TIMINGS[k].values(u[chosen]).T, strict=True))
    return Draws({k: predictions[chosen]}, -np.log(len(u)) - log_share, timings)


def common_draws(case: Prepared, used: NDArray[np.bool_] | None = None) -> Draws:
    """Timings common to all slews: a coarse look at the whole prior, then points inside the box of what is likely."""
    slewing = (*YAW_INTERVALS, MINUS_Y)
    signs = tuple(sign_of(case.sections[k]) for k in slewing)
    rows = np.concatenate([np.arange(3 * k, 3 * k + 3) for k in slewing])
    rows = rows if used is None else rows[used[rows]]
    spread = WIDENED * case.covariance[np.ix_(rows, rows)]

    def weigh(predictions: Mapping[int, Array]) -> Array:
        full = np.zeros((len(predictions[MINUS_Y]), 18))
        for k in slewing:
            full[:, 3 * k : 3 * k + 3] = predictions[k]
        return log_normal(case.target[rows] - full[:, rows], spread)

    u, values = common_cloud(signs)
    coarse = weigh({k: shifted(values[k], case.shift) for k in slewing})
    best = u[np.argsort(coarse)[-48:]]
    low, high = best.min(axis=0), best.max(axis=0)
    margin = 0.15 * (high - low) + 0.01
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, 1)
    fine = low + cube(COMMON_CLOUD // 4, 4) * (high - low)
    good, points = common_points(fine)
    predictions = {k: surrogate(k, sign)(points[k], case.shift) for k, sign in zip(slewing, signs, strict=True)}
    chosen, log_share = _systematic(weigh(predictions), 9)
    # Prior density: uniform over what can be flown; the box holds its volume's share of that.
    density = np.prod(high - low) / len(fine) / (len(u) / COMMON_CLOUD)
    names = ("delay_s", "slew_rate_deg_s", "ramp_fraction", "stay_s")
    bounds = np.array(list(COMMON.values()))
    u_fine = fine[good][chosen]
    physical = bounds[:, 0] + u_fine * np.ptp(bounds, axis=1)
    physical[:, 1] = bounds[1, 0] * (bounds[1, 1] / bounds[1, 0]) ** u_fine[:, 1]
    timings = {f"common {name}": physical[:, j] for j, name in enumerate(names)}
    return Draws({k: predictions[k][chosen] for k in slewing}, np.log(density) - log_share, timings)


def joined(parts: Sequence[Draws]) -> Draws:
    """Independent draws side by side."""
    return Draws(
        {k: p for part in parts for k, p in part.predictions.items()},
        np.sum([part.log_weight for part in parts], axis=0),
        {name: values for part in parts for name, values in part.timings.items()},
    )


def draws_of(case: Prepared, timed: tuple[int, ...] | str, used: NDArray[np.bool_] | None = None) -> Draws:
    """Draws of a timing hypothesis; used (18,) says which numbers may steer them."""
    if isinstance(timed, str):
        return common_draws(case, used)
    return joined([own_draws(case, k, None if used is None else used[3 * k : 3 * k + 3]) for k in timed])


def residuals_of(case: Prepared, draws: Draws) -> Array:
    """d (n, 18) at each draw, deg."""
    out = np.tile(case.d, (DRAWS, 1))
    for k, predictions in draws.predictions.items():
        out[:, 3 * k : 3 * k + 3] = case.target[3 * k : 3 * k + 3] - predictions
    return out
