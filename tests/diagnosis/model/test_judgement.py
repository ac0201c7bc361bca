"""What is judged by the residuals, and judged anew without the effects that were found."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.known_effects import KnownEffect, subtract_effects
from diagnosis.model.noise_classification import reclassify_without_effects
from diagnosis.model.prepare import prepare
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates, prepared

CHANGE = 2e-2  # of a misalignment, in the middle of the recording


def fitted(label, amplitudes, **parameters):
    """An effect as the search would have found it; only amplitudes and parameters count here."""
    effect, _, axis = label.partition(":")
    one, none = np.array(amplitudes, dtype=float), np.empty(0)
    columns = np.empty((0, one.size))
    return FittedEffect(label, effect, axis or None, "", float(one[0]), 0.0, parameters, columns, one, one, 1.0, False, none)


def spinning(change):
    """A body that spins about z and nutates, with a misalignment of x towards z that changes by so much halfway; 4 Hz."""
    t_s = 0.25 * np.arange(4800)
    rates = np.deg2rad(
        np.column_stack([0.3 * np.sin(0.21 * t_s), 0.3 * np.cos(0.21 * t_s), 6.0 + 0.5 * np.sin(2 * np.pi * t_s / 600)])
    )
    one = of_rates(rates, 16, 0.25, np.deg2rad(2e-4), np.deg2rad(0.004), seed=5)
    read = one.gyro.rates.copy()
    read[2400:, 0] += change * rates[2400:, 2]
    return replace(one, gyro=replace(one.gyro, rates=read))


@lru_cache
def prepared_spinning(change):
    return prepare(spinning(change))


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


def test_noise_of_the_references_is_judged_without_what_changes_it():
    """A changed misalignment of a spinning body makes its references noisier from then on; without it they are as stated."""
    changed, clean = prepared_spinning(CHANGE), prepared_spinning(0.0)
    assert not clean.has_odd_references
    assert changed.has_odd_references
    found = fitted("g_matrix_step:x", [CHANGE * 1e6], time_s=600.0, toward="z")
    again = reclassify_without_effects(changed, [KnownEffect(EFFECTS["g_matrix_step"], found)], DEFAULT)
    assert again is not None
    assert not again.has_odd_references
    # The noise is that which is stated, as without the change.
    sigma, stated = again.model.errors[0], clean.model.errors[0]
    np.testing.assert_allclose(sigma, stated, rtol=1e-6, atol=1e-12 * np.abs(stated).max())
