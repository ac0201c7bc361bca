"""Check predicted covariances against references that were not used.

A prediction starts at many references of a recording and is compared with later ones, each a given horizon later. The error
of an axis over the sigma of the difference of reading and prediction, with the reference's own error in it, has a root mean
square of one where the covariance holds. Parameters come from elsewhere: from the first part of the recording, or from another
recording of the same gyro.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude
from gyrocal.arrays import Array
from gyrocal.calibration.remainder import choose_evenly
from gyrocal.errors import InputError
from gyrocal.estimation.predict import SAME_TIME_S, condition_on_references
from gyrocal.estimation.remainder_noise import KnownCalibration
from gyrocal.recording import Attitudes, Recording, find_reference_rows

HORIZONS_S = (1.0, 5.0, 20.0)
MOST_STARTS = 40
MOST_USED = 60  # references before a start that a prediction uses
HORIZON_TOLERANCE = 0.3  # of a horizon, within which a reference is compared


@dataclass(frozen=True)
class PredictionErrors:
    """Errors of predictions over one horizon."""

    horizon_s: float  # s
    from_s: Array  # (n,) starts, s
    error: Array  # (n, 3) reading less prediction about the body axes, rad
    covariance: Array  # (n, 3, 3) of this, rad²

    @property
    def normalised(self) -> Array:
        """(n, 3) errors over their sigmas."""
        return np.asarray(self.error / np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    @property
    def normalised_rms(self) -> Array:
        """(3,) root mean square of the normalised errors by axis; NaN without any."""
        return np.sqrt(np.mean(np.square(self.normalised), axis=0)) if len(self.error) else np.full(3, np.nan)

    @property
    def rms(self) -> float:
        """Root mean square of the angle of the errors, rad; NaN without any."""
        return float(np.sqrt(np.square(self.error).sum(axis=1).mean())) if len(self.error) else float("nan")


def compute_prediction_errors(
    recording: Recording,
    known: KnownCalibration,
    horizons_s: Sequence[float] = HORIZONS_S,
    most_starts: int = MOST_STARTS,
) -> list[PredictionErrors]:
    """Predict from many starts in a recording, and compare with its later references.

    Returns one for each horizon.

    recording: none of it may be in the calibration
    known: parameters, their covariance and the remainder, of other data
    horizons_s: s, ascending
    most_starts: starts are chosen evenly from all references that have enough references before and after them
    """
    recording = known.apply(recording)
    t_s = recording.attitudes.t_s
    rows = _choose_starts(recording, horizons_s[0], most_starts)
    errors_by_horizon: list[list[tuple[float, Array, Array]]] = [[] for _ in horizons_s]
    for row in rows:
        target_rows = [_find_reference_after(recording, row, horizon) for horizon in horizons_s]
        targets = sorted({target for target in target_rows if target is not None})
        used = _select_references_before(recording, row)
        if not targets:
            continue
        try:
            prediction = condition_on_references(recording, used, t_s[targets], known.covariance, known.noise)
        except InputError:  # the gyro has a gap there
            continue
        observed = attitude.matrix_from_quaternion(recording.attitudes.quaternions[targets])
        errors = attitude.residual(observed, prediction.A)
        covariance = prediction.readings + known.noise.factor * recording.attitudes.select_rows(targets).compute_covariance()
        for k, target in enumerate(target_rows):
            if target is not None:
                place = targets.index(target)
                errors_by_horizon[k].append((float(t_s[row]), errors[place], covariance[place]))
    return [_build_prediction_errors(horizon, entries) for horizon, entries in zip(horizons_s, errors_by_horizon, strict=True)]


def cut_recording(recording: Recording, from_s: float, to_s: float) -> Recording:
    """Cut a recording: its references and intervals from one time to another, s, and the gyro samples that cover them."""
    attitudes, gyro = recording.attitudes, recording.gyro
    references = attitudes.select_rows((attitudes.t_s >= from_s - SAME_TIME_S) & (attitudes.t_s <= to_s + SAME_TIME_S))
    intervals = []
    for interval in recording.intervals:
        times_s = references.t_s[find_reference_rows(references.t_s, interval)]
        if times_s.size >= 2:
            intervals.append(replace(interval, start_s=float(times_s[0]), stop_s=float(times_s[-1])))
    if not intervals:
        raise InputError(f"no interval has two references between {from_s:g} and {to_s:g} s")
    samples = (gyro.t_s >= from_s - 2 * gyro.sample_s) & (gyro.t_s <= to_s + 2 * gyro.sample_s)
    cut = replace(gyro, t_s=gyro.t_s[samples], rates=gyro.rates[samples])
    return replace(recording, gyro=cut, attitudes=references, intervals=tuple(intervals), tables={}, sensors=None)


def _choose_starts(recording: Recording, least_s: float, count: int) -> list[int]:
    """Choose rows of references in an interval with at least two before and a span of `least_s` after them."""
    t_s: Array = recording.attitudes.t_s
    rows = []
    for interval in recording.intervals:
        rows += [int(row) for row in find_reference_rows(t_s, interval)[2:] if t_s[row] <= t_s[-1] - least_s]
    return [rows[k] for k in choose_evenly(len(rows), count)] if rows else []


def _select_references_before(recording: Recording, row: int) -> NDArray[np.bool_]:
    """Mask the latest references up to a row in the interval that holds it."""
    attitudes: Attitudes = recording.attitudes
    start_s = max(interval.start_s for interval in recording.intervals if interval.start_s < attitudes.t_s[row] - SAME_TIME_S)
    used = (attitudes.t_s >= start_s - SAME_TIME_S) & (np.arange(attitudes.t_s.size) <= row)
    used[: max(row + 1 - MOST_USED, 0)] = False
    return np.asarray(used)


def _find_reference_after(recording: Recording, row: int, horizon_s: float) -> int | None:
    """Find the row of the reference nearest to a horizon after another one; None without one within the tolerance."""
    t_s = recording.attitudes.t_s
    target_s = t_s[row] + horizon_s
    nearest = int(np.abs(t_s - target_s).argmin())
    return nearest if nearest > row and abs(t_s[nearest] - target_s) <= HORIZON_TOLERANCE * horizon_s else None


def _build_prediction_errors(horizon_s: float, entries: list[tuple[float, Array, Array]]) -> PredictionErrors:
    """Build the errors of one horizon from the start, s, the error (3,) and the covariance (3, 3) of each prediction."""
    errors = np.reshape([error for _, error, _ in entries], (-1, 3))
    covariances = np.reshape([covariance for *_, covariance in entries], (-1, 3, 3))
    return PredictionErrors(horizon_s, np.array([start_s for start_s, *_ in entries]), errors, covariances)
