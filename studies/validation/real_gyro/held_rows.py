"""Rows on trials left out: errors of predictions rung by rung, and what is left of turns over different times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from gyrocal import Attitudes, Interval, attitude
from studies.validation.real_gyro.fitting import TRIED, Fitted, Prediction, fit, predicted, propagated
from studies.validation.real_gyro.ladder import LADDER, LATE, delayed, repaired, rungs
from studies.validation.real_gyro.left_out import Fold
from studies.validation.real_gyro.trials import Row

LAGS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 4.0)


def fold_rows(fold: Fold, last: dict[str, list[tuple[Fold, Fitted]]]) -> list[Row]:
    """Predictions of one trial left out, rung by rung, and with more in the model; the last fit is added to `last`."""
    rows: list[Row] = []
    number = fold.tested.number
    for order, (name, rung) in enumerate(rungs(fold.found)):
        fitted = fit(fold.others, rung, fold.found)
        predictions = predicted(fold.tested, fitted, rung, fold.found)
        rows += held_rows(number, "held", name, predictions, order)
        rows += [row for row in _series_rows(number, name, predictions) if order in (0, len(LADDER))]
        added = name.removeprefix("+ ")
        rows.append(
            {
                "kind": "fit",
                "trial": number,
                "name": name,
                "chosen": order == 0 or added in fold.found.effects,
                "size": fitted.offset,
                "size_sigma": fitted.offset_sigma,
                "determinant": float(np.linalg.det(fitted.G)),
            }
        )
    last.setdefault(number, []).append((fold, fitted))
    if LATE in fold.found.effects:
        other = fit(fold.others, rung, fold.found, lag=True)
        rows += held_rows(
            number, "tried", "rate_lag for time_offset", predicted(fold.tested, other, rung, fold.found, lag=True)
        )
    for further in TRIED:
        other = fit(fold.others, rung, fold.found, further=further)
        rows += held_rows(number, "tried", further.name, predicted(fold.tested, other, rung, fold.found, further=further))
    return rows


def held_rows(number: str, kind: str, name: str, predictions: Sequence[Prediction], order: int = 0) -> list[Row]:
    """A row for the prediction of each interval."""
    return [
        {
            "kind": kind,
            "trial": number,
            "name": name,
            "order": float(order),
            "interval": one.interval,
            "end_deg2": one.squares[0],
            "series_deg2": one.squares[1],
        }
        for one in predictions
    ]


def _series_rows(number: str, name: str, predictions: Sequence[Prediction]) -> list[Row]:
    return [
        {
            "kind": "series",
            "trial": number,
            "name": name,
            "interval": one.interval,
            "t_s": float(t),
            **{f"error_{axis}": float(value) for axis, value in zip("xyz", error, strict=True)},
        }
        for one in predictions
        for t, error in zip(one.t_s, one.error, strict=True)
    ]


def increment_rows(fold: Fold, fitted: Fitted) -> list[Row]:
    """Mean squares of what is left of the turns over different times, in motion, for the slower and the faster half."""
    trial = fold.tested.trial
    rung = tuple(rungs(fold.found))[-1][1]
    recording = delayed(repaired(fold.tested, rung, fold.found), fitted.offset, lag=False)
    tracked, phases, t = trial.tracked, trial.phases, trial.t_s
    angle = np.linalg.norm(trial.rates - trial.rates[fold.tested.first_rest].mean(axis=0), axis=1)
    total = np.append(0.0, np.cumsum(angle))
    spans = [(interval.start_s, interval.stop_s) for interval in fold.tested.recording.intervals if interval.activity != "rest"]
    rows: list[Row] = []
    for lag in LAGS_S:
        ends = [
            (int(a), int(b))
            for first, stop in phases
            if any(low <= t[first] and t[stop - 1] <= high for low, high in _joined(spans))
            for a, b in pairwise(np.arange(first, stop, trial.samples(lag)))
            if tracked[a] and tracked[b]
        ]
        if len(ends) < 8:
            continue
        used = np.unique(np.array(ends))
        turns = replace(
            recording,
            attitudes=Attitudes(t[used], trial.quaternions[used], np.full((used.size, 3), 1e-3)),
            intervals=tuple(Interval(str(k), "", float(t[a]), float(t[b])) for k, (a, b) in enumerate(ends)),
        )
        parts, theta, _, R, _ = propagated(turns, fitted.G, fitted.bias)
        rate = np.rad2deg((total[used[parts.row]] - total[used[parts.start]]) / (used[parts.row] - used[parts.start]))
        turned = attitude.residual(R, np.broadcast_to(np.eye(3), R.shape))
        along = turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
        squares = np.square(np.rad2deg(theta)).sum(axis=1)
        parallel = np.square(np.rad2deg(np.einsum("mi,mi->m", theta, along)))
        slow = rate < np.median(rate)
        for which, own in (("slower", slow), ("faster", ~slow)):
            rows.append(
                {
                    "kind": "increments",
                    "trial": fold.tested.number,
                    "name": which,
                    "lag_s": lag,
                    "count": float(np.count_nonzero(own)),
                    "rate": float(rate[own].mean()),
                    "series_deg2": float(squares[own].mean()),
                    "parallel_deg2": float(parallel[own].mean()),
                }
            )
    return rows


def _joined(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Touching stretches as one."""
    out: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if out and low <= out[-1][1] + 1e-6:
            out[-1] = (out[-1][0], high)
        else:
            out.append((low, high))
    return out
