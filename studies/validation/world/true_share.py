"""The share of the held-out misfit that stated causes close in truth: what goes when they are taken out of the world."""

from __future__ import annotations

from collections.abc import Collection

from diagnosis.budget import SETTINGS as BUDGET
from diagnosis.budget import predict_held_out
from diagnosis.model.prepare import prepare
from diagnosis.settings import DEFAULT
from gyrocal.recording import Recording
from studies.validation.world.answers import label
from studies.validation.world.cases import Drawn


def measure_true_share(drawn: Drawn, stated: Collection[str]) -> float:
    """Measure the share that goes when the stated effects are taken out of the world, with all noise as it was.

    Parameters
    ----------
    drawn : the case
    stated : labels of the causes that an answer states; those that are not there close nothing
    """
    kept = [one for one in drawn.settings if not {label(one.effect, one.axis), one.effect} & set(stated)]
    whole, left = (_measure_misfit(drawn.world.recording(settings)) for settings in (drawn.settings, kept))
    return (whole - left) / (whole - BUDGET.floor)


def _measure_misfit(recording: Recording) -> float:
    """Measure the whitened mean square of held-out errors under M0."""
    model = prepare(recording, DEFAULT, lambda text, share: None).model
    return float(predict_held_out(model, model, ()).misfit[0])
