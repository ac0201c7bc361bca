"""What M0 has put into its calibration is taken out of it before effects are compared."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.model.prepare import prepare
from diagnosis.relinearise import beside_the_likeliest
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates

LISTED = [EFFECTS["bias_drift"], *(effect for effect in EFFECTS.values() if effect.symptom == "dead_zone")]
SLOW = 0.003


@pytest.fixture(scope="module")
def slewing():
    """Slews about all axes at up to 0.01 rad/s, and a gyro x that reads nothing but noise below `SLOW`, or as it should."""
    t_s = 0.5 * np.arange(8000)
    rates = 0.01 * np.sin(2 * np.pi * t_s[:, None] / np.array([300.0, 470.0, 710.0]) + np.arange(3))
    made = of_rates(rates, 40, 0.5, 2e-6, 2e-5, 4)
    read = made.gyro.rates.copy()
    read[:, 0] -= np.where(np.abs(rates[:, 0]) < SLOW, rates[:, 0], 0.0)
    return made, replace(made, gyro=replace(made.gyro, rates=read))


def test_the_calibration_beside_a_strong_effect_is_the_true_one(slewing):
    prepared = prepare(slewing[1])
    assert prepared.model.bent
    before = np.abs(prepared.model.G - np.eye(3)).max()
    after = np.abs(beside_the_likeliest(prepared, LISTED, DEFAULT).model.G - np.eye(3)).max()
    assert before > 1e-2
    assert after < 0.1 * before


def test_without_an_effect_the_model_stays(slewing):
    prepared = prepare(slewing[0])
    assert not prepared.model.bent
    assert beside_the_likeliest(prepared, LISTED, DEFAULT) is prepared
