"""What is left of a recording's residuals without effects that are known to be at work.

Whether the references' noise is as stated is judged by what M0 leaves of the references
(`diagnosis.model.noise_classification`). An effect that moves those residuals is visible there, too: a changed misalignment
makes the references of a spinning body look noisier from some moment on. Once the search has found effects with columns, the
noise is judged anew without them:

    ζ' = ζ − Σ e_k a_k − e_p δp,

e_k the attitude errors of the effects' columns, a_k their amplitudes, and δp the change of G and b that fits ζ − Σ e_k a_k
best.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.baseline import compute_correction
from diagnosis.model.misfit import compute_attitude_errors
from diagnosis.model.recording_model import RecordingModel, build_parameter_errors
from simulator.effects.base import Effect

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnownEffect:
    """An effect with columns, and their amplitudes (k,)."""

    effect: Effect
    fitted: FittedEffect

    def errors(self, model: RecordingModel) -> Array | None:
        """(m, 3) attitude errors at every reference, rad; None where the columns are not those of its amplitudes."""
        columns = compute_attitude_errors(model, self.effect, self.fitted.axis, self.fitted.parameters)
        same = columns.shape[2] == self.fitted.amplitudes.size
        return np.asarray(columns @ self.fitted.amplitudes) if same else None


def select_known_effects(fitted: Sequence[FittedEffect], effects: Mapping[str, Effect]) -> tuple[KnownEffect, ...]:
    """Select the identified effects whose attitude errors are known, and not only their statistics."""
    return tuple(
        KnownEffect(effects[one.effect], one)
        for one in fitted
        if not one.process and one.effect in effects and effects[one.effect].has_columns
    )


def subtract_effects(model: RecordingModel, at_work: Sequence[KnownEffect]) -> RecordingModel:
    """The model with the residuals that are left without some effects."""
    errors = [error for one in at_work if (error := one.errors(model)) is not None]
    if not errors:
        return model
    left = _replace_residuals(model, model.residuals - np.sum(errors, axis=0))
    change, _ = compute_correction(left)
    high = -np.einsum("ij,njk->nik", np.linalg.inv(model.G), build_parameter_errors(model.raw))
    return _replace_residuals(model, left.residuals - model.compute_attitude_turns(high) @ change)


def _replace_residuals(model: RecordingModel, residuals: Array) -> RecordingModel:
    observations, start = [], 0
    for block in model.blocks:
        observations.append(block.average_references(residuals[start : start + block.references.size]).ravel())
        start += block.references.size
    return replace(model, residuals=residuals, zeta=np.concatenate(observations))
