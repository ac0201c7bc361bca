"""The calibration with the named effects and the remainder in the model.

A shape outside the library may take the place of a part of G: an error of the references that follows a direction in a body
that swings is nearly one of the scale factors. Such a shape closes more of the misfit than the calibration without it, also on
held-out data, while G is wrong by ten times its sigma. It shows in that the parts of the recording disagree. Each calibration
is therefore made again without an eighth of every interval at a time (the jackknife: Efron and Tibshirani, An Introduction to
the Bootstrap, 1993, chapter 11), and the shapes of the remainder are in the model only where they make these agree better.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from diagnosis.arrays import LEAST_POSITIVE, Array
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.folds import assign_folds
from diagnosis.model.recording_model import RecordingModel
from gyrocal.calibration.observability import PLAUSIBLE_RANGE

RIDGE = 1e-13  # of the information of columns of unit length, against rounding


def calibrate_with_effects(model: RecordingModel, effects: Sequence[FittedEffect]) -> tuple[Array, Array]:
    """Change of G and b with the effects in the model, (12,), and the joint covariance of it and all amplitudes.

    Start attitudes, calibration and the amplitudes of the effects are estimated together, the
    latter under the prior that their evidence used. The covariance has the twelve parameters first, then the amplitudes, effect
    after effect.
    """
    return calibrate_beside(model, [(one.columns, one.prior_sigma) for one in effects])


def calibrate_beside_remainder(
    model: RecordingModel, causes: Sequence[FittedEffect], beside: Sequence[FittedEffect]
) -> tuple[Array, Array]:
    """The same with causes and what is in the model beside them.

    The sigmas of G and b are at least those by which parts of the recording differ; the covariance is of the amplitudes of the
    causes and of those members of the remainder that the calibration is made with.
    """
    chosen = [*causes, *beside]
    if not beside:
        return calibrate_with_effects(model, chosen)
    spread = jackknife_calibration(model, chosen)
    random = [*causes, *(one for one in beside if one.process)]
    if len(random) < len(chosen):
        other = jackknife_calibration(model, random)
        # The mean ratio of the sigmas of all parameters, whatever their units.
        if np.sum(np.log(np.maximum(other, LEAST_POSITIVE) / np.maximum(spread, LEAST_POSITIVE))) < 0:
            chosen, spread = random, other
    change, covariance = calibrate_with_effects(model, chosen)
    wider = np.ones(len(covariance))
    wider[:12] = np.maximum(1.0, spread / np.sqrt(np.diag(covariance)[:12]))
    return change, covariance * np.outer(wider, wider)


def jackknife_calibration(model: RecordingModel, effects: Sequence[FittedEffect]) -> Array:
    """(12,) sigma of G and b by the jackknife, each time without an eighth of every interval; zero where there is one part."""
    fold = np.repeat(assign_folds(model), 3)
    numbers = np.unique(fold)
    if numbers.size < 2:
        return np.zeros(12)
    nuisance = np.hstack([model.starts, model.line_columns])
    Z, y = np.hstack([model.calibration, *(one.columns for one in effects), nuisance]), model.whiten(model.zeta)
    variances = [np.full(one.columns.shape[1], 1 / one.prior_sigma**2) for one in effects]
    prior = np.concatenate([1e-2 / PLAUSIBLE_RANGE**2, *variances, np.zeros(nuisance.shape[1])])
    scale = 1.0 / np.sqrt(np.maximum(np.sum(Z**2, axis=0) + prior, LEAST_POSITIVE))
    Z = Z * scale
    parts = [(Z[own].T @ Z[own], Z[own].T @ y[own]) for own in (fold == number for number in numbers)]
    whole = sum(part for part, _ in parts) + np.diag(prior * scale**2 + RIDGE)
    along = sum(part for _, part in parts)
    each = np.array([(scale * np.linalg.solve(whole - A, along - b))[:12] for A, b in parts])
    return np.asarray(np.sqrt((numbers.size - 1) / numbers.size * np.sum((each - each.mean(axis=0)) ** 2, axis=0)))


def calibrate_beside(model: RecordingModel, effects: Sequence[tuple[Array, float]]) -> tuple[Array, Array]:
    """The same of effects that are whitened columns (N, k), and the prior sigma of their amplitudes."""
    Q = np.linalg.qr(np.hstack([model.starts, model.line_columns]))[0]
    columns = np.hstack([model.calibration, *(part for part, _ in effects)])
    columns = columns - Q @ (Q.T @ columns)
    y = model.whiten(model.zeta)
    y = y - Q @ (Q.T @ y)
    prior = np.concatenate([1e-2 / PLAUSIBLE_RANGE**2, *(np.full(part.shape[1], 1 / sigma**2) for part, sigma in effects)])
    scale = 1.0 / np.sqrt(np.sum(columns**2, axis=0) + prior)  # which makes the diagonal of the information one
    information = (columns * scale).T @ (columns * scale) + np.diag(prior * scale**2)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    change = covariance @ (columns.T @ y)
    return np.asarray(change[:12]), np.asarray(covariance)
