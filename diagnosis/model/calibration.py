"""Calibration of G and b on the linear model: under M0, by Gauss–Newton, and with the identified effects in the model.

Rates and references that do not fit each other at all are described by no linear model. A diagnosis has the calibrator's own
gate (`gyrocal.calibration.gate`) and applies it to the repaired stream: spikes have been taken out and the attitude is not
propagated over clipped samples, so that real faults of the gyro stay below it. A single reference that is far off between two
that agree is a fault of the references and is left to the diagnosis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.detectors.report import SampleReport, Tell, silent
from diagnosis.inference.amplitudes import Fitted
from diagnosis.model.linearise import linearised
from diagnosis.model.recording import RecordingModel
from gyrocal.calibration.gate import LARGEST_RESIDUAL, LargeResidualError, check, refusal
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.recording import Interval, Recording, reference_rows

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Parameters = tuple[Array, Array]  # G (3, 3) and b (3,) rad/s


@dataclass(frozen=True)
class CalibrationSettings:
    """Constants of `diagnosis.model.calibration`."""

    iterations: int = 10  # of Gauss and Newton at most; two or three are usual
    settled: float = 1e-3  # sigmas of the last correction
    # stretches between two references that a calibration starts from, where whole intervals lead too far astray
    most_short: int = 200
    fewest_short: int = 6  # of them, for twelve parameters
    outliers: float = 0.02  # largest share of references that are single outliers; with more of them, something else is wrong


SETTINGS = CalibrationSettings()


IMPLAUSIBLE = np.array([0.2] * 9 + [np.deg2rad(0.1)] * 3)  # changes of G and b, rad/s


def calibrate_baseline(
    recording: Recording, report: SampleReport, pieces: tuple[Interval, ...], reference_sigma: Array, tell: Tell = silent
) -> tuple[RecordingModel, Array]:
    """Linearise a recording about its own calibration under M0; also the (12,) sigma of that.

    Raises
    ------
    LargeResidualError
        Rates and references do not fit each other, before the calibration or after it.
    """
    apriori = recording.gyro.apriori_G, recording.gyro.apriori_bias
    try:
        return _iterate(recording, report, pieces, reference_sigma, apriori, tell)
    except LargeResidualError:
        better = _calibrate_short_pieces(recording, report, pieces, reference_sigma)
        if better is None:
            raise
        return _iterate(recording, report, pieces, reference_sigma, better, tell)


def _iterate(
    recording: Recording,
    report: SampleReport,
    pieces: tuple[Interval, ...],
    reference_sigma: Array,
    start: Parameters,
    tell: Tell = silent,
) -> tuple[RecordingModel, Array]:
    """Calibrate by Gauss–Newton from a start, each step of which must leave residuals that a linear model describes."""
    G, bias = start
    for number in range(SETTINGS.iterations):
        tell(f"first calibration, step {number + 1}", number / SETTINGS.iterations)
        model = linearised(recording, G, bias, report.rates, report.smooth, report.density, pieces, reference_sigma)
        check_residuals(model, report.rates)
        change, covariance = calibrated(model, ())
        sigma = np.sqrt(np.diag(covariance))
        if np.abs(change / sigma).max() < SETTINGS.settled:
            break
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
    return model, sigma


def _calibrate_short_pieces(
    recording: Recording, report: SampleReport, pieces: tuple[Interval, ...], reference_sigma: Array
) -> Parameters | None:
    """Calibrate by references next to each other, between which a coarse a-priori calibration does not lead far astray.

    None where G and b are not plausible, as with rates in another unit, or where even those are too far off.
    """
    gaps = [
        Interval(f"{piece.name}/{number}", piece.activity, float(low), float(high))
        for piece in pieces
        for number, (low, high) in enumerate(pairwise(recording.attitudes.t_s[reference_rows(recording.attitudes.t_s, piece)]))
        if high - low > recording.gyro.sample_s
    ]
    some = tuple(gaps[k] for k in np.unique(np.linspace(0, len(gaps) - 1, SETTINGS.most_short).astype(np.intp))) if gaps else ()
    if len(some) < SETTINGS.fewest_short or not report.rates.any():
        return None
    apriori = recording.gyro.apriori_G, recording.gyro.apriori_bias
    try:
        model, _ = _iterate(recording, report, some, reference_sigma, apriori)
    except LargeResidualError:
        return None
    moved = np.append((model.G - apriori[0]).ravel(), model.bias - apriori[1])
    return None if (np.abs(moved) > IMPLAUSIBLE).any() else (model.G, model.bias)


def calibrated(model: RecordingModel, effects: Sequence[Fitted]) -> tuple[Array, Array]:
    """Change of G and b with the effects in the model, (12,), and the joint covariance of it and all amplitudes.

    Start attitudes, mountings that are estimated, calibration and the amplitudes of the effects are estimated together, the
    latter under the prior that their evidence used. A broad prior of G and b, ten plausible ranges wide, keeps the directions
    that cannot be observed where they are. The covariance has the twelve parameters first, then the amplitudes, effect
    after effect.
    """
    return calibrate_beside(model, [(one.columns, one.prior_sigma) for one in effects])


def calibrate_beside(model: RecordingModel, effects: Sequence[tuple[Array, float]]) -> tuple[Array, Array]:
    """The same of effects that are whitened columns (N, k), and the prior sigma of their amplitudes."""
    Q = np.linalg.qr(model.attitude_nuisance)[0]
    columns = np.hstack([model.calibration, *(part for part, _ in effects)])
    columns = columns - Q @ (Q.T @ columns)
    y = model.whitened(model.zeta)
    y = y - Q @ (Q.T @ y)
    prior = np.concatenate([1e-2 / PLAUSIBLE_RANGE**2, *(np.full(part.shape[1], 1 / sigma**2) for part, sigma in effects)])
    scale = 1.0 / np.sqrt(np.sum(columns**2, axis=0) + prior)  # which makes the diagonal of the information one
    information = (columns * scale).T @ (columns * scale) + np.diag(prior * scale**2)
    covariance = np.linalg.pinv(information, rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    change = covariance @ (columns.T @ y)
    return np.asarray(change[:12]), np.asarray(covariance)


# ---- the gate ------------------------------------------------------------------------------------------------------------


def check_residuals(model: RecordingModel, rates: Array) -> None:
    """Refuse a recording whose residuals are too large to be linearised.

    Parameters
    ----------
    model : of the recording, at any parameters
    rates : (samples, 3) repaired raw rates, rad/s

    Raises
    ------
    LargeResidualError
        With the interval, the time and the reading that would fit.
    """
    error, kept = _too_large(model)
    if error is None:
        return
    recording, gyro = model.recording, model.recording.gyro
    number = np.flatnonzero(kept)[error.output]
    name = recording.intervals[model.blocks[model.interval_of_reference[number]].interval].name
    t_s = recording.attitudes.t_s[model.reference_rows[number]]
    repaired = replace(recording, gyro=replace(gyro, rates=rates))
    raise refusal(error, repaired, name, t_s, gyro.apriori_G, gyro.apriori_bias)


def _too_large(model: RecordingModel) -> tuple[LargeResidualError | None, Mask]:
    """The error of residuals that are too large, None if none is, and which references it counts."""
    residuals = np.where(np.isfinite(model.off), model.off, np.inf)
    kept = np.ones(len(residuals), dtype=bool)
    if (np.linalg.norm(residuals, axis=1) <= LARGEST_RESIDUAL).all():
        return None, kept
    if np.isfinite(residuals).all():
        residuals, kept = _without_outliers(residuals, model.interval_of_reference)
    try:
        check(residuals)
    except LargeResidualError as error:
        return error, kept
    return None, kept


def _without_outliers(residuals: Array, block: NDArray[np.intp]) -> tuple[Array, Mask]:
    """Residuals (k, 3) of the references that are no single outliers, from the first of those of their block, and which."""
    kept = np.ones(len(residuals), dtype=bool)
    based = residuals.copy()
    for number in np.unique(block):
        rows = np.flatnonzero(block == number)
        turned = Rotation.from_rotvec(residuals[rows])
        good = ~_alone(turned)
        kept[rows] = good
        based[rows] = (turned[int(np.argmax(good))].inv() * turned).as_rotvec()
    if np.sum(~kept) > max(1, SETTINGS.outliers * kept.size):
        return residuals, np.ones(len(residuals), dtype=bool)
    return based[kept], kept


def _alone(turned: Rotation) -> Mask:
    """Which of the residuals of a block are far from both their neighbours, which agree; at an end, from the two nearest."""
    count = len(turned)
    if count < 4:
        return np.zeros(count, dtype=bool)
    before, after = np.arange(count) - 1, np.arange(count) + 1
    before[0], after[-1] = 2, count - 3
    own, left, right = turned, turned[before], turned[after]
    far = [(own.inv() * other).magnitude() > LARGEST_RESIDUAL for other in (left, right)]
    return np.asarray(far[0] & far[1] & ((left.inv() * right).magnitude() <= LARGEST_RESIDUAL))
