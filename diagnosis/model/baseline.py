"""The calibration under M0 that a diagnosis starts from: Gauss–Newton on the linear model."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.sample_report import SampleReport, Tell, ignore_progress
from diagnosis.model.gate import check_residuals, has_large_residuals
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.recording_model import RecordingModel
from gyrocal.calibration.observability import PLAUSIBLE_RANGE
from gyrocal.calibration.plausible_ranges import estimate_plausible_ranges
from gyrocal.recording import Interval, Recording, find_reference_rows

Array = NDArray[np.float64]

ITERATIONS = 10  # of Gauss and Newton at most; two or three are usual
SETTLED = 1e-3  # sigmas of the last correction
# stretches between two references that a calibration starts from, where whole intervals lead too far astray
MOST_SHORT = 200
FEWEST_SHORT = 6  # of them, for twelve parameters
SETTLED_SHORT = 1e-6  # of G

ELEMENTS = (*(f"G_{a}{b}" for a in "xyz" for b in "xyz"), "b_x", "b_y", "b_z")
UNSEEN = 0.5  # of its plausible range: a parameter less certain than that is not observed
IMPLAUSIBLE = np.array([0.2] * 9 + [np.deg2rad(0.1)] * 3)  # changes of G and b, rad/s


def calibrate_baseline(
    recording: Recording,
    report: SampleReport,
    pieces: tuple[Interval, ...],
    reference_sigma: Array,
    tell: Tell = ignore_progress,
) -> tuple[RecordingModel, Array]:
    """The model about its own calibration, and the (12,) sigma of that.

    An `InputError` if rates and references do not fit each other, before the calibration or after it.
    """
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    sigma, short = PLAUSIBLE_RANGE, False
    for number in range(ITERATIONS):
        tell(f"first calibration, step {number + 1}", number / ITERATIONS)
        model = linearise_recording(recording, G, bias, report.rates, report.smooth, report.density, pieces, reference_sigma)
        tell(f"first calibration, step {number + 1}: residuals", (number + 0.5) / ITERATIONS)
        if has_large_residuals(model):
            better = None if short else _calibrate_short_pieces(recording, report, pieces, reference_sigma)
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


def _calibrate_short_pieces(
    recording: Recording, report: SampleReport, pieces: tuple[Interval, ...], reference_sigma: Array
) -> tuple[Array, Array] | None:
    """G and b from references next to each other, between which a coarse a-priori calibration does not lead far astray.

    None where they are not plausible, as with rates in another unit, or where even those are too far off.
    """
    gaps = [
        Interval(f"{piece.name}/{number}", piece.activity, float(low), float(high))
        for piece in pieces
        for number, (low, high) in enumerate(
            pairwise(recording.attitudes.t_s[find_reference_rows(recording.attitudes.t_s, piece)])
        )
        if high - low > recording.gyro.sample_s
    ]
    some = tuple(gaps[k] for k in np.unique(np.linspace(0, len(gaps) - 1, MOST_SHORT).astype(np.intp))) if gaps else ()
    if len(some) < FEWEST_SHORT or not report.rates.any():
        return None
    G, bias = recording.gyro.apriori_G.copy(), recording.gyro.apriori_bias.copy()
    for _ in range(ITERATIONS):
        model = linearise_recording(recording, G, bias, report.rates, report.smooth, report.density, some, reference_sigma)
        if has_large_residuals(model):
            return None
        change, _ = compute_correction(model)
        G, bias = G + change[:9].reshape(3, 3), bias + change[9:]
        if np.abs(change[:9]).max() < SETTLED_SHORT:
            break
    moved = np.append((G - recording.gyro.apriori_G).ravel(), bias - recording.gyro.apriori_bias)
    return None if (np.abs(moved) > IMPLAUSIBLE).any() else (G, bias)


def compute_correction(model: RecordingModel, ranges: Array = PLAUSIBLE_RANGE) -> tuple[Array, Array]:
    """Least-squares correction of G and b with the start attitudes as nuisance parameters, (12,), and its covariance (12, 12).

    A broad prior, ten plausible ranges (12,) wide, keeps what cannot be observed where it is.
    """
    Q = np.linalg.qr(model.starts)[0]
    scaled = (model.calibration - Q @ (Q.T @ model.calibration)) * ranges
    observed = model.whiten(model.zeta)
    observed = observed - Q @ (Q.T @ observed)
    information = scaled.T @ scaled + 1e-2 * np.eye(12)
    covariance = np.linalg.inv(information) * np.outer(ranges, ranges)
    return np.asarray(np.linalg.solve(information, scaled.T @ observed) * ranges), np.asarray(covariance)


def report_unobserved(model: RecordingModel) -> tuple[tuple[str, ...], str]:
    """Elements of G and b that stay less certain than `UNSEEN` of the plausible range of the gyro's grade, and that grade."""
    plausible = estimate_plausible_ranges(model.recording)
    ranges = plausible.vector(np.arange(12) >= 9)
    sigma = np.sqrt(np.diag(compute_correction(model, ranges)[1]))
    return tuple(name for name, unseen in zip(ELEMENTS, sigma > UNSEEN * ranges, strict=True) if unseen), plausible.reason


def describe_unobserved(model: RecordingModel) -> tuple[str, ...]:
    """Sentence with the elements of G and b that are not observed; none if all are."""
    names, reason = report_unobserved(model)
    return (
        (f"Not observed by these motions: {', '.join(names)} ({reason}); effects that act like them cannot be seen either",)
        if names
        else ()
    )
