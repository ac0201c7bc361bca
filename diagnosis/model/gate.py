"""Recordings whose rates and references do not fit each other at all, which no linear model describes.

A diagnosis has the calibrator's own gate (`gyrocal.calibration.gate`) and asks it of the repaired stream: spikes have been
taken out and the mask leaves out clipped samples, so that real faults of the gyro stay below it. A single
reference that is far off between two that agree is a fault of the references and is left to the diagnosis.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.model.recording_model import RecordingModel
from gyrocal.calibration.gate import LARGEST_RESIDUAL, LargeResidualError, build_refusal, check

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

OUTLIERS = 0.02  # largest share of references that are single outliers; with more of them, something else is wrong


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
    error, kept = _find_large_residuals(model)
    if error is None:
        return
    recording, gyro = model.recording, model.recording.gyro
    number = np.flatnonzero(kept)[error.output]
    name = recording.intervals[model.blocks[model.interval_of_reference[number]].interval].name
    t_s = recording.attitudes.t_s[model.reference_rows[number]]
    repaired = replace(recording, gyro=replace(gyro, rates=rates))
    raise build_refusal(error, repaired, name, t_s, gyro.apriori_G, gyro.apriori_bias)


def has_large_residuals(model: RecordingModel) -> bool:
    """Whether `check_residuals` would refuse the recording, without the search for its reason, which takes seconds."""
    return _find_large_residuals(model)[0] is not None


def _find_large_residuals(model: RecordingModel) -> tuple[LargeResidualError | None, Mask]:
    """The error of residuals that are too large, None if none is, and which references it counts."""
    residuals = np.where(np.isfinite(model.off), model.off, np.inf)
    kept = np.ones(len(residuals), dtype=bool)
    if (np.linalg.norm(residuals, axis=1) <= LARGEST_RESIDUAL).all():
        return None, kept
    if np.isfinite(residuals).all():
        residuals, kept = _drop_outliers(residuals, model.interval_of_reference)
    try:
        check(residuals)
    except LargeResidualError as error:
        return error, kept
    return None, kept


def _drop_outliers(residuals: Array, block: NDArray[np.intp]) -> tuple[Array, Mask]:
    """Residuals (k, 3) of the references that are no single outliers, from the first of those of their block, and which."""
    kept = np.ones(len(residuals), dtype=bool)
    based = residuals.copy()
    for number in np.unique(block):
        rows = np.flatnonzero(block == number)
        turned = Rotation.from_rotvec(residuals[rows])
        good = ~_find_isolated(turned)
        kept[rows] = good
        based[rows] = (turned[int(np.argmax(good))].inv() * turned).as_rotvec()
    if np.sum(~kept) > max(1, OUTLIERS * kept.size):
        return residuals, np.ones(len(residuals), dtype=bool)
    return based[kept], kept


def _find_isolated(turned: Rotation) -> Mask:
    """Which of the residuals of a block are far from both their neighbours, which agree; at an end, from the two nearest."""
    count = len(turned)
    if count < 4:
        return np.zeros(count, dtype=bool)
    before, after = np.arange(count) - 1, np.arange(count) + 1
    before[0], after[-1] = 2, count - 3
    own, left, right = turned, turned[before], turned[after]
    far = [(own.inv() * other).magnitude() > LARGEST_RESIDUAL for other in (left, right)]
    return np.asarray(far[0] & far[1] & ((left.inv() * right).magnitude() <= LARGEST_RESIDUAL))
