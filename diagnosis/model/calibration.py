"""Calibrations of a diagnosis: under M0, by Gauss–Newton on the linear model, and with the effects found in the model.

A shape outside the library may be mistaken for a part of G: an error of the references that follows a direction in a body that
swings is nearly one of the scale factors. Such a shape closes more of the misfit than the calibration without it, also on
held-out data, while G is wrong by ten times its sigma. The disagreement of parts of the recording reveals this. Each
calibration is therefore repeated without an eighth of every interval at a time (the jackknife: Efron and Tibshirani, An
Introduction to the Bootstrap, 1993, chapter 11), and the shapes of the remainder are in the model only if these parts agree
better with them.

No linear model describes recordings whose rates and references do not fit each other at all. A diagnosis has the calibrator's
own gate (`gyrocal.calibration.gate`) and applies it to the repaired stream: spikes have been taken out and the mask leaves out
clipped samples, so that real faults of the gyro stay below it. A single reference that is far from two neighbours that agree is
a fault of the references and is left to the diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.arrays import LEAST_POSITIVE
from diagnosis.detectors.sample_report import SampleReport
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.folds import assign_folds
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices, Mask
from gyrocal.calibration.gate import LARGEST_RESIDUAL, LargeResidualError, build_refusal, check_residual_size
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.plausible_ranges import estimate_plausible_ranges
from gyrocal.recording import Interval, Recording, find_reference_rows

RIDGE = 1e-13  # of the information of columns of unit length, against rounding

MOST_ITERATIONS = 10  # of Gauss and Newton at most; two or three are usual
SETTLED = 1e-3  # sigmas of the last correction
# stretches between two references that a calibration starts from, where whole intervals lead too far astray
MOST_SHORT = 200
FEWEST_SHORT = 6  # of them, for twelve parameters
SETTLED_SHORT = 1e-6  # of G

ELEMENTS = (*(f"G_{a}{b}" for a in "xyz" for b in "xyz"), "b_x", "b_y", "b_z")
UNSEEN = 0.5  # of its plausible range: a parameter less certain than that is not observed
IMPLAUSIBLE = np.array([0.2] * 9 + [np.deg2rad(0.1)] * 3)  # changes of G and b, rad/s
OUTLIERS = 0.02  # largest share of references that are single outliers; with more of them, something else is wrong


def calibrate_with_effects(model: RecordingModel, effects: Sequence[FittedEffect]) -> tuple[Array, Array]:
    """Calibrate with effects in the model: the change (12,) of G and b, and its joint covariance with all amplitudes.

    Start attitudes, calibration and the amplitudes of the effects are estimated together, the latter under the prior that their
    evidence used. The covariance has the twelve parameters first, then the amplitudes, effect
    after effect.
    """
    return calibrate_with_columns(model, [(effect.columns, effect.prior_sigma) for effect in effects])


def calibrate_with_remainder(
    model: RecordingModel, causes: Sequence[FittedEffect], unnamed: Sequence[FittedEffect]
) -> tuple[Array, Array]:
    """Calibrate with causes and remainder in the model; returns as `calibrate_with_effects`.

    The sigmas of G and b are at least those by which parts of the recording differ. Shapes of the remainder are in the model,
    and their amplitudes in the covariance, only if the parts agree better with them.
    """
    chosen = [*causes, *unnamed]
    if not unnamed:
        return calibrate_with_effects(model, chosen)
    spread = jackknife_calibration(model, chosen)
    random = [*causes, *(member for member in unnamed if member.process)]
    if len(random) < len(chosen):
        random_spread = jackknife_calibration(model, random)
        # The mean ratio of the sigmas of all parameters, whatever their units.
        if np.sum(np.log(np.maximum(random_spread, LEAST_POSITIVE) / np.maximum(spread, LEAST_POSITIVE))) < 0:
            chosen, spread = random, random_spread
    change, covariance = calibrate_with_effects(model, chosen)
    wider = np.ones(len(covariance))
    wider[:12] = np.maximum(1.0, spread / np.sqrt(np.diag(covariance)[:12]))
    return change, covariance * np.outer(wider, wider)


def jackknife_calibration(model: RecordingModel, effects: Sequence[FittedEffect]) -> Array:
    """Compute the jackknife sigma (12,) of G and b, each time without an eighth of every interval; zero with one part only."""
    fold = np.repeat(assign_folds(model), 3)
    numbers = np.unique(fold)
    if numbers.size < 2:
        return np.zeros(12)
    nuisance = np.hstack([model.starts, model.error_columns])
    Z, y = np.hstack([model.calibration, *(fitted.columns for fitted in effects), nuisance]), model.whiten(model.zeta)
    variances = [np.full(effect.columns.shape[1], 1 / effect.prior_sigma**2) for effect in effects]
    prior = np.concatenate([1e-2 / PLAUSIBLE_RANGE**2, *variances, np.zeros(nuisance.shape[1])])
    scale = 1.0 / np.sqrt(np.maximum(np.sum(Z**2, axis=0) + prior, LEAST_POSITIVE))
    Z = Z * scale
    parts = [(Z[in_fold].T @ Z[in_fold], Z[in_fold].T @ y[in_fold]) for in_fold in (fold == number for number in numbers)]
    information = sum(part for part, _ in parts) + np.diag(prior * scale**2 + RIDGE)
    products = sum(part for _, part in parts)
    estimates = np.array([(scale * np.linalg.solve(information - A, products - b))[:12] for A, b in parts])
    return np.asarray(np.sqrt((numbers.size - 1) / numbers.size * np.sum((estimates - estimates.mean(axis=0)) ** 2, axis=0)))


def calibrate_with_columns(model: RecordingModel, effects: Sequence[tuple[Array, float]]) -> tuple[Array, Array]:
    """Calibrate with effects given as whitened columns (N, k) and the prior sigma of their amplitudes."""
    Q = np.linalg.qr(np.hstack([model.starts, model.error_columns]))[0]
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


def calibrate_baseline(recording: Recording, report: SampleReport, reference_sigma: Array) -> tuple[RecordingModel, Array]:
    """Calibrate under M0; returns the model linearised about the calibration, and the sigma (12,) of G and b.

    Raises an `InputError` if rates and references do not fit each other, before the calibration or after it.
    """
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    sigma, short = PLAUSIBLE_RANGE, False
    for _ in range(MOST_ITERATIONS):
        model = linearise_recording(recording, G, bias, report.rates, report.smooth, report.density, sigma=reference_sigma)
        if has_large_residuals(model):
            better = None if short else _calibrate_short_pieces(recording, report, reference_sigma)
            if better is not None:
                (G, bias), short = better, True
                continue
            check_residuals(model, report.rates)
        change, covariance = compute_correction(model)
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(change / sigma).max() < SETTLED:
            break
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
    return model, sigma


def _calibrate_short_pieces(recording: Recording, report: SampleReport, reference_sigma: Array) -> tuple[Array, Array] | None:
    """Calibrate with pairs of neighbouring references, between which a coarse a-priori calibration errs little.

    None if G and b are not plausible, as with rates in another unit, or if even these pairs have too large residuals.
    """
    pieces = [
        Interval(f"{piece.name}/{number}", piece.activity, float(low), float(high))
        for piece in recording.intervals
        for number, (low, high) in enumerate(
            pairwise(recording.attitudes.t_s[find_reference_rows(recording.attitudes.t_s, piece)])
        )
        if high - low > recording.gyro.sample_s
    ]
    chosen = tuple(pieces[k] for k in np.unique(np.linspace(0, len(pieces) - 1, MOST_SHORT).astype(np.intp))) if pieces else ()
    if len(chosen) < FEWEST_SHORT or not report.rates.any():
        return None
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    for _ in range(MOST_ITERATIONS):
        model = linearise_recording(recording, G, bias, report.rates, report.smooth, report.density, chosen, reference_sigma)
        if has_large_residuals(model):
            return None
        change, _ = compute_correction(model)
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
        if np.abs(change[:9]).max() < SETTLED_SHORT:
            break
    change_from_apriori = np.append((G - recording.gyro.apriori_G).ravel(), bias - recording.gyro.apriori_bias)
    return None if (np.abs(change_from_apriori) > IMPLAUSIBLE).any() else (G, bias)


def compute_correction(model: RecordingModel, ranges: Array = PLAUSIBLE_RANGE) -> tuple[Array, Array]:
    """Compute the least-squares correction (12,) of G and b and its covariance (12, 12), with free start attitudes.

    A broad prior, ten plausible ranges (12,) wide, leaves unobserved parameters unchanged.
    """
    Q = np.linalg.qr(model.starts)[0]
    scaled = (model.calibration - Q @ (Q.T @ model.calibration)) * ranges
    observed = model.whiten(model.zeta)
    observed = observed - Q @ (Q.T @ observed)
    information = scaled.T @ scaled + 1e-2 * np.eye(12)
    covariance = np.linalg.inv(information) * np.outer(ranges, ranges)
    return np.asarray(np.linalg.solve(information, scaled.T @ observed) * ranges), np.asarray(covariance)


def report_unobserved(model: RecordingModel) -> tuple[tuple[str, ...], str]:
    """List the elements of G and b less certain than `UNSEEN` of the plausible range of the gyro's grade; and the grade."""
    plausible = estimate_plausible_ranges(model.recording)
    ranges = plausible.vector(np.arange(12) >= 9)
    sigma = np.sqrt(np.diag(compute_correction(model, ranges)[1]))
    return tuple(name for name, unseen in zip(ELEMENTS, sigma > UNSEEN * ranges, strict=True) if unseen), plausible.reason


def describe_unobserved(model: RecordingModel) -> tuple[str, ...]:
    """Write a sentence on the elements of G and b that are not observed; none if all are."""
    names, reason = report_unobserved(model)
    return (
        (f"Not observed by these motions: {', '.join(names)} ({reason}); effects that act like them cannot be seen either",)
        if names
        else ()
    )


def check_residuals(model: RecordingModel, rates: Array) -> None:
    """Refuse a recording whose residuals are too large to be linearised, with repaired raw rates (samples, 3), rad/s.

    A `LargeResidualError` has the interval, the time and the reading that would fit.
    """
    error, is_counted = _find_large_residuals(model)
    if error is None:
        return
    recording, gyro = model.recording, model.recording.gyro
    number = np.flatnonzero(is_counted)[error.output]
    name = recording.intervals[model.blocks[model.interval_of_reference[number]].interval].name
    t_s = recording.attitudes.t_s[model.reference_rows[number]]
    repaired = replace(recording, gyro=replace(gyro, rates=rates))
    raise build_refusal(error, repaired, name, t_s, gyro.apriori_G, gyro.apriori_bias)


def has_large_residuals(model: RecordingModel) -> bool:
    """Check whether `check_residuals` would refuse the recording, without searching for the reason, which takes seconds."""
    return _find_large_residuals(model)[0] is not None


def _find_large_residuals(model: RecordingModel) -> tuple[LargeResidualError | None, Mask]:
    """Return the error of residuals that are too large, None if none is, and the mask of the references it counts."""
    residuals = np.where(np.isfinite(model.off), model.off, np.inf)
    is_counted = np.ones(len(residuals), dtype=bool)
    if (np.linalg.norm(residuals, axis=1) <= LARGEST_RESIDUAL).all():
        return None, is_counted
    if np.isfinite(residuals).all():
        residuals, is_counted = _drop_outliers(residuals, model.interval_of_reference)
    try:
        check_residual_size(residuals)
    except LargeResidualError as error:
        return error, is_counted
    return None, is_counted


def _drop_outliers(residuals: Array, block: Indices) -> tuple[Array, Mask]:
    """Drop single outliers of the residuals (k, 3) and refer the others to the first of their block; also their mask."""
    is_counted = np.ones(len(residuals), dtype=bool)
    referred = residuals.copy()
    for number in np.unique(block):
        rows = np.flatnonzero(block == number)
        turned = Rotation.from_rotvec(residuals[rows])
        is_inlier = ~_find_isolated(turned)
        is_counted[rows] = is_inlier
        referred[rows] = (turned[int(np.argmax(is_inlier))].inv() * turned).as_rotvec()
    if np.sum(~is_counted) > max(1, OUTLIERS * is_counted.size):
        return residuals, np.ones(len(residuals), dtype=bool)
    return referred[is_counted], is_counted


def _find_isolated(turned: Rotation) -> Mask:
    """Mark the residuals of a block that are far from both neighbours, which agree; at an end, from the two nearest."""
    count = len(turned)
    if count < 4:
        return np.zeros(count, dtype=bool)
    before, after = np.arange(count) - 1, np.arange(count) + 1
    before[0], after[-1] = 2, count - 3
    current, previous, following = turned, turned[before], turned[after]
    far = [(current.inv() * neighbour).magnitude() > LARGEST_RESIDUAL for neighbour in (previous, following)]
    return np.asarray(far[0] & far[1] & ((previous.inv() * following).magnitude() <= LARGEST_RESIDUAL))
