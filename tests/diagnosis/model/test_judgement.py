"""What is judged by the residuals, and judged anew without the effects that were found."""

import numpy as np
import pytest

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.known_effects import KnownEffect, subtract_effects
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared


def fitted(label, amplitudes, **parameters):
    """An effect as the search would have found it; only amplitudes and parameters count here."""
    effect, _, axis = label.partition(":")
    one, none = np.array(amplitudes, dtype=float), np.empty(0)
    columns = np.empty((0, one.size))
    return FittedEffect(label, effect, axis or None, "", float(one[0]), 0.0, parameters, columns, one, one, 1.0, False, none)


@pytest.mark.parametrize(
    ("text", "amplitudes"),
    [
        ("time_offset=1.0", [1.0]),
        ("reference_horizon:x=0.02,phase_deg=30", [0.02 * np.cos(np.pi / 6), 0.02 * np.sin(np.pi / 6)]),
    ],
)
def test_without_an_effect_the_residuals_are_those_of_m0(text, amplitudes):
    """What is left beside G and b differs by second orders from a recording with the same noise and no effect."""
    with_it, clean = prepared(3, text).model, prepared(3).model
    effect = EFFECTS[text.partition("=")[0].partition(":")[0]]
    one = KnownEffect(effect, fitted(text.partition("=")[0], amplitudes))
    left = subtract_effects(with_it, [one])
    size = np.linalg.norm(with_it.y - clean.y)
    assert size > 5
    assert np.linalg.norm(left.y - clean.y) < 0.05 * size
