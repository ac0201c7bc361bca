"""What innovations are asked to follow holds none of the noise that they hold."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.checks import residual_checks
from diagnosis.model.candidates import linear_model
from diagnosis.model.layout import layout, turned
from diagnosis.model.prepare import prepare
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates, prepared

RATE = slice(0, 3)
CHANGE = slice(6, 9)


def with_readings(model, rates):
    gyro = replace(model.recording.gyro, rates=rates)
    return replace(model, recording=replace(model.recording, gyro=gyro))


def resting(seed, gaps=300, each=72):
    """A body that slews now and then between two references and hardly sways at them, where the gyro's noise is as large."""
    t_s = 0.5 * np.arange(gaps * each)
    rates = 3e-5 * np.sin(2 * np.pi * t_s[:, None] / np.array([143.0, 217.0, 331.0]) + np.arange(3))
    for gap in range(5, gaps, 10):
        rates[gap * each + 10 : gap * each + 50, gap // 10 % 3] += 0.004 * (-1) ** (gap // 30)
    return of_rates(rates, each, 0.5, 3.8e-5, 7e-5, seed)


def test_the_rate_at_an_observation_holds_no_reading_from_before_it():
    model = prepare(resting(0)).model
    gyro, at = model.recording.gyro, model.observation_t_s.size // 2
    early = gyro.t_s < model.observation_t_s[at]
    noisy = gyro.rates + 1e-6 * np.random.default_rng(0).standard_normal(gyro.rates.shape) * early[:, None]
    change = layout(with_readings(model, noisy)).regressors - layout(model).regressors
    np.testing.assert_allclose(change[at:-1, RATE], 0, atol=1e-15)  # after the last one there are no readings
    assert (change[at, CHANGE] != 0).all()
    np.testing.assert_allclose(change[at + 2 : -1, CHANGE], 0, atol=1e-15)


@pytest.mark.parametrize("seed", range(2))
def test_noise_that_is_read_as_a_rate_is_no_dependence_on_it(seed):
    model = prepare(resting(seed)).model
    linear = linear_model(model, [EFFECTS["bias_drift"]], rivals=False)
    found = {one.name: one for one in residual_checks(linear, (), layout(model))}
    assert found["dependence on what is known"].p_value > 1e-3


def test_the_angle_turned_begins_anew_with_each_interval():
    model = prepared(1).model
    angle, steps = turned(model), model.rates * model.dt[:, None]
    assert len(model.blocks) > 1
    for block in model.blocks:
        np.testing.assert_allclose(
            angle[block.steps], np.cumsum(steps[block.steps], axis=0) - steps[block.steps][:1], atol=1e-9
        )
    last = np.flatnonzero(np.append(np.diff(model.observation_block) != 0, True))
    ends = [block.steps.stop - 1 for block in model.blocks]
    np.testing.assert_allclose(layout(model).turned[last], angle[ends], atol=2 * np.abs(steps).max())
