"""How far the gap shrinks with an explanation, in sample and on numbers or intervals held out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from studies.natanson import flight
from studies.natanson.flight_diagnosis.draws import draws_of, residuals_of
from studies.natanson.flight_diagnosis.families import Hypothesis
from studies.natanson.flight_diagnosis.numbers import Prepared, log_normal, prepare
from studies.natanson.flight_diagnosis.table import Baseline, Table

Array = NDArray[np.float64]


def _predictive(case: Prepared, timed: tuple[int, ...] | str, extra: Array, left_out: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Mean and variance (m,) of the left-out numbers' d, timings integrated over and steered by the other numbers only."""
    covariance = case.covariance + np.diag(extra)
    out = np.flatnonzero(left_out)
    kept = np.flatnonzero(~left_out)
    gain = np.linalg.solve(covariance[np.ix_(kept, kept)], covariance[np.ix_(kept, out)])
    variance = np.diag(covariance[np.ix_(out, out)] - covariance[np.ix_(out, kept)] @ gain)
    if not timed:
        return case.d[out] - case.d[kept] @ gain, variance
    draws = draws_of(case, timed, ~left_out)
    d = residuals_of(case, draws)
    log_weight = log_normal(d[:, kept], covariance[np.ix_(kept, kept)]) + draws.log_weight
    weight = np.exp(log_weight - logsumexp(log_weight))[:, None]
    errors = d[:, out] - d[:, kept] @ gain
    mean = np.sum(weight * errors, axis=0)
    return mean, variance + np.sum(weight * (errors - mean) ** 2, axis=0)


def _posterior(case: Prepared, h: Hypothesis) -> tuple[Array, dict[str, tuple[float, float]]]:
    """Mean d (18,) under a hypothesis, and mean and sigma of its timings."""
    if not h.timed:
        return case.d, {}
    draws = draws_of(case, h.timed)
    d = residuals_of(case, draws)
    log_weight = log_normal(d, case.covariance + np.diag(h.extra)) + draws.log_weight
    weight = np.exp(log_weight - logsumexp(log_weight))
    sizes = {}
    for name, values in draws.timings.items():
        mean = float(weight @ values)
        sizes[name] = (mean, float(np.sqrt(weight @ (values - mean) ** 2)))
    return weight @ d, sizes


@dataclass(frozen=True)
class Closure:
    """Gap before and after the likeliest explanation.

    Attributes
    ----------
    rms_deg : flown minus predicted, "before", "after" and "floor", the residuals after calibration
    whitened : mean square of d over its sigma: "before", "after" (in sample), and held out, a number or an interval at a time
    after : (18,) flown minus predicted with the explanation, deg
    sigma : (18,) that print leaves, deg
    sizes : mean and sigma of the timings
    """

    rms_deg: dict[str, float]
    whitened: dict[str, float]
    after: Array
    sigma: Array
    sizes: dict[str, tuple[float, float]]


def closure(table: Table, baseline: Baseline, h: Hypothesis) -> Closure:
    """How far a hypothesis closes the gap."""
    before, case = prepare(table, baseline), prepare(table, baseline, h.flips)
    d, sizes = _posterior(case, h)
    c = table.after.ravel()
    numbers = [np.arange(18) == i for i in range(18)]
    intervals = [np.arange(18) // 3 == k for k in range(6)]
    # An unknown residual predicts nothing: it does not count as shrinking the gap.
    none = np.zeros(18)

    def held_out(folds: Sequence[NDArray[np.bool_]]) -> float:
        parts = [_predictive(case, h.timed, none, fold) for fold in folds]
        return float(np.mean(np.concatenate([mean**2 / variance for mean, variance in parts])))

    def rms(x: Array) -> float:
        return float(flight.rms(x))

    return Closure(
        rms_deg={"before": rms(before.d + c), "after": rms(d + c), "floor": rms(c)},
        whitened={
            "before": float(before.d @ np.linalg.solve(before.covariance, before.d)) / 18,
            "after": float(d @ np.linalg.solve(case.covariance, d)) / 18,
            "before, number held out": float(
                np.mean([m[0] ** 2 / v[0] for m, v in (_predictive(before, (), none, fold) for fold in numbers)])
            ),
            "after, number held out": held_out(numbers),
            "before, interval held out": float(
                np.mean(np.concatenate([m**2 / v for m, v in (_predictive(before, (), none, fold) for fold in intervals)]))
            ),
            "after, interval held out": held_out(intervals),
        },
        after=d + c,
        sigma=np.sqrt(np.diag(case.covariance)),
        sizes=sizes,
    )
