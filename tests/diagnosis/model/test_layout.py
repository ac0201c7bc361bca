"""What innovations are asked to follow, and what is in progress at a reference."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.inference.criticism import check_explanation
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.layout import tabulate_observations
from diagnosis.model.prepare import prepare
from diagnosis.model.step_index import find_steps
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import of_rates, prepared, slews_between_references

CHANGE = slice(6, 9)


@pytest.fixture(scope="module")
def rested():
    """Slews between references, and a sway at them that is as large as the gyro's noise."""
    return prepare(of_rates(slews_between_references(300, 72, 0.5, 3e-5), 72, 0.5, 3.8e-5, 7e-5, 0)).model


def test_the_rate_at_an_observation_holds_no_reading_from_before_it(rested):
    model = rested
    gyro, at = model.recording.gyro, model.observation_t_s.size // 2
    early = gyro.t_s < model.observation_t_s[at]
    noisy = gyro.rates + 1e-6 * np.random.default_rng(0).standard_normal(gyro.rates.shape) * early[:, None]
    changed = replace(model, recording=replace(model.recording, gyro=replace(gyro, rates=noisy)))
    change = tabulate_observations(changed).regressors - tabulate_observations(model).regressors
    np.testing.assert_allclose(change[at:-1, :9], 0, atol=1e-15)  # after the last one there are no readings


def test_where_noise_is_not_heard_a_change_is_that_since_the_observation_before():
    """Of axes that turn by far more than the noise: an innovation with an error of timing follows what came before it."""
    model = prepared(1).model
    rates = model.rates[find_steps(model, model.observation_t_s, model.observation_block)]
    later = np.flatnonzero(np.diff(model.observation_block) == 0)
    change = tabulate_observations(model).regressors[later + 1, CHANGE]
    for axis in (0, 1):
        assert np.corrcoef(rates[later + 1, axis] - rates[later, axis], change[:, axis])[0, 1] > 0.999


def test_noise_that_is_read_as_a_rate_is_no_dependence_on_it(rested):
    model = rested
    linear = build_linear_model(model, [EFFECTS["bias_drift"]], rivals=False)
    found = {one.name: one for one in check_explanation(linear, (), tabulate_observations(model))}
    assert found["dependence on what is known"].p_value > 1e-3
