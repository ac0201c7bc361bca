"""How far the gap shrinks: predictions of data that neither chose nor fitted anything.

Observations ζ are left out, and predicted from the others. Under M0 all are jointly normal: noise with the covariance V,
start attitudes, G and b with broad priors, Σ = V + N P₀ Nᵀ. Given the training rows t, the rows s left out have the mean Σ_st
Σ_tt⁻¹ ζ_t and the covariance C = Σ_ss − Σ_st Σ_tt⁻¹ Σ_ts (Rasmussen & Williams, Gaussian Processes for Machine Learning,
section 2.2). With e the error of that prediction the measure is eᵀ C⁻¹ e over its degrees of freedom: one on average if M0 is
true, which is the floor. For *after*, each fold finds explanations and fits their amplitudes on its training rows, takes what
they predict, weighted by their probabilities, out of the rows left out, and is measured in the same metric, so that an effect
cannot win by claiming more noise.

Two splits: *stretches*, where an eighth of each interval is left out at a time, so that training sees every motion; and whole
intervals, which asks more: an effect that shows in one interval only cannot be learnt from the others, whatever it is.

Where the cause is a random process there is nothing to predict but how far the residuals scatter; there the measure is
eᵀ C⁻¹ e + log |C|, each model with its own C, against the floor that the measure has if the model's C is true.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.answer import Closure
from diagnosis.inference.candidates import Bank
from diagnosis.inference.search import Member, Search
from diagnosis.model.recording import Model
from gyrocal.calibration.observability import PLAUSIBLE_RANGE

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Chooser = Callable[[Search], Sequence[tuple[float, Sequence[Member]]]]

PARTS = 8  # of an interval
TINY = 1e-6
START = 0.02  # rad, prior of a start attitude
BROAD = 10.0  # plausible ranges, prior of G and b
STRETCHES = "leave-one-stretch-out, an eighth of each interval at a time"
INTERVALS = "leave-one-interval-out"


@dataclass(frozen=True)
class Fold:
    """One part left out.

    Attributes
    ----------
    out : (N,) rows left out
    train : (t, t) lower Cholesky factor of Σ_tt
    gain : (t, s) factor⁻¹ Σ_ts
    left : (s, s) lower Cholesky factor of C
    """

    out: Mask
    train: Array
    gain: Array
    left: Array

    def whitened(self, values: Array) -> Array:
        """Training rows in units of their own scatter."""
        return np.asarray(scipy.linalg.solve_triangular(self.train, values[~self.out], lower=True, check_finite=False))

    def error(self, values: Array) -> Array:
        """Error of the prediction of the rows left out, in units of its own scatter; of observations or of columns."""
        error = values[self.out] - self.gain.T @ self.whitened(values)
        return np.asarray(scipy.linalg.solve_triangular(self.left, error, lower=True, check_finite=False))


def masks(model: Model, intervals: bool) -> list[Mask]:
    """Rows that each fold leaves out: whole intervals, or an eighth of each."""
    owner = np.concatenate([np.full(block.references.size, block.interval) for block in model.blocks])
    parts = owner if intervals else np.concatenate(_stretches(model))
    return [np.repeat(parts == part, 3) for part in np.unique(parts)]


def _stretches(model: Model) -> list[NDArray[np.intp]]:
    """Fold of each reference: which eighth of its interval, counted from another one in each interval.

    Sorted by length, so that two intervals of one kind, such as two slews, do not leave the same part out together.
    """
    rank = np.argsort(np.argsort([block.elapsed_s[-1] for block in model.blocks]))
    return [
        (np.arange(block.references.size) * PARTS // block.references.size + int(place)) % PARTS
        for place, block in zip(rank, model.blocks, strict=True)
    ]


def folds(model: Model, intervals: bool = False) -> list[Fold]:
    """All folds of a split, without those that leave nothing to learn from."""
    sigma = joint_covariance(model)
    made = []
    for out in masks(model, intervals):
        if out.all():
            continue
        train = np.asarray(np.linalg.cholesky(sigma[np.ix_(~out, ~out)]))
        gain = scipy.linalg.solve_triangular(train, sigma[np.ix_(~out, out)], lower=True, check_finite=False)
        left = np.asarray(np.linalg.cholesky(sigma[np.ix_(out, out)] - gain.T @ gain))
        made.append(Fold(out, train, gain, left))
    return made


def joint_covariance(model: Model) -> Array:
    """(N, N) covariance Σ of all observations under M0, broad priors on start attitudes, G, b and what else is free."""
    V = np.zeros((model.size, model.size))
    for block in model.blocks:
        V[block.rows, block.rows] = block.whitener @ block.whitener.T
    scale = np.concatenate([np.full(3 * len(model.blocks), START), BROAD * PLAUSIBLE_RANGE])
    columns = np.hstack([model.starts, model.calibration]) * scale
    if model.free.shape[1]:
        free = model.whitened(model.free)
        columns = np.hstack([columns, free * (300.0 / np.maximum(np.linalg.norm(free, axis=0), 1e-300))])
    columns = unwhitened(model, columns)
    return V + columns @ columns.T


def unwhitened(model: Model, columns: Array) -> Array:
    """L times whitened columns."""
    out = np.empty_like(columns)
    for block in model.blocks:
        out[block.rows] = block.whitener @ columns[block.rows]
    return out


def closure(model: Model, bank: Bank, choose: Chooser, random: bool = False, intervals: bool = False) -> Closure | None:
    """Closure of the gap on data left out.

    Parameters
    ----------
    model, bank : the recording and its candidates
    choose : explanations with their weights that a fold comes to, given its search; a fixed answer measures a given one
    random : whether the explanation holds a random process, which needs the other measure
    intervals : whether whole intervals are left out, in place of stretches

    Returns
    -------
    None where nothing can be left out
    """
    columns = unwhitened(model, bank.W)
    made = folds(model, intervals)
    return _summed(model, [_one(model, fold, bank, columns, choose, random) for fold in made], made, random, intervals)


def closure_of_response(model: Model, response: Array, intervals: bool = False) -> Closure | None:
    """What the truth reaches: the same with its response (N,) rad known and taken out."""
    made = folds(model, intervals)
    parts = []
    for fold in made:
        before, after = fold.error(model.zeta) ** 2, fold.error(model.zeta - response) ** 2
        parts.append(np.column_stack([before, after, np.ones(before.size)]))
    return _summed(model, parts, made, False, intervals)


def _one(model: Model, fold: Fold, bank: Bank, columns: Array, choose: Chooser, random: bool) -> Array:
    """(s, 3) the measure of each row left out: before, after, floor."""
    y = fold.whitened(model.zeta)
    X = fold.whitened(columns)
    before = fold.error(model.zeta)
    weighted = choose(Search(Bank(X, X, bank.candidates), y))
    log = 2 * np.log(np.diag(fold.left)) if random else np.zeros(before.size)
    if not weighted:
        return np.column_stack([before**2 + log, before**2 + log, 1 + log])
    predicted = np.zeros(len(columns))
    for weight, members in weighted:
        places, scale = _places(bank, members)
        amplitudes, _ = _amplitudes(X[:, places] * scale, y)
        predicted += columns[:, places] @ (weight * scale * amplitudes)
    after = before - fold.error(predicted)
    if not random:
        return np.column_stack([before**2, after**2, np.ones(before.size)])
    # The scatter that the likeliest explanation claims.
    places, scale = _places(bank, max(weighted, key=lambda pair: pair[0])[1])
    _, information = _amplitudes(X[:, places] * scale, y)
    B = fold.error(columns[:, places] * scale)
    factor = np.linalg.cholesky(np.eye(before.size) + B @ np.linalg.solve(information, B.T))
    own = scipy.linalg.solve_triangular(factor, after, lower=True, check_finite=False)
    more = log + 2 * np.log(np.diag(factor))
    return np.column_stack([before**2 + log, own**2 + more, 1 + more])


def _places(bank: Bank, members: Sequence[Member]) -> tuple[NDArray[np.intp], Array]:
    """Columns of some members in the bank, and the scale of each."""
    chosen, scales = [], []
    for member in members:
        entry = bank.candidates[member.candidate]
        option = entry.options[member.option]
        chosen.append(np.arange(option.start, option.start + option.count))
        scales.append(np.full(option.count, entry.scales[member.scale]))
    return np.concatenate(chosen), np.concatenate(scales)


def _amplitudes(A: Array, y: Array) -> tuple[Array, Array]:
    """Amplitudes in units of the scale that the evidence gives them, and their information.

    With that prior, an amplitude that a fold cannot see is not invented.
    """
    information = np.eye(A.shape[1]) + A.T @ A
    return np.asarray(np.linalg.solve(information, A.T @ y)), np.asarray(information)


def _summed(model: Model, parts: list[Array], made: list[Fold], random: bool, intervals: bool) -> Closure | None:
    if not parts:
        return None
    rows = np.concatenate([np.flatnonzero(fold.out) for fold in made])
    values = np.concatenate(parts)
    owner = np.concatenate([np.full(block.rows.stop - block.rows.start, block.interval) for block in model.blocks])[rows]
    records = []
    for interval in np.unique(owner):
        own = values[owner == interval]
        records.append((model.recording.intervals[interval].name, *own.mean(axis=0).tolist(), len(own)))
    before, after, floor = (float(value) for value in values.mean(axis=0))
    gap = before - floor
    closed = 1.0 - (after - floor) / gap if abs(gap) > TINY else 0.0
    # The noise of the data left out is in both; what it adds to the difference from the floor scatters by √(2/dof).
    spread = 1.645 * float(np.sqrt(2.0 / len(values))) / max(abs(gap), TINY)
    return Closure(
        measure="held-out log score" if random else "held-out whitened mean square",
        split=INTERVALS if intervals else STRETCHES,
        before=before,
        after=after,
        floor=floor,
        closed=float(closed),
        interval_90=(float(closed - spread), float(closed + spread)),
        by_interval=pd.DataFrame.from_records(records, columns=["interval", "before", "after", "floor", "dof"]),
    )
