"""The calibration with the named effects in the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.recording_model import RecordingModel
from gyrocal.calibration.observability import PLAUSIBLE_RANGE

Array = NDArray[np.float64]


def calibrate_with_effects(model: RecordingModel, effects: Sequence[FittedEffect]) -> tuple[Array, Array]:
    """Change of G and b with the effects in the model, (12,), and the joint covariance of it and all amplitudes.

    Start attitudes, calibration and the amplitudes of the effects are estimated together, the
    latter under the prior that their evidence used. The covariance has the twelve parameters first, then the amplitudes, effect
    after effect.
    """
    return calibrate_beside(model, [(one.columns, one.prior_sigma) for one in effects])


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
