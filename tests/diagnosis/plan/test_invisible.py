"""Effects that G, b and the start attitudes absorb, against calibrations of recordings with and without them."""

import numpy as np
import pytest

import gyrocal
import simulator
from diagnosis.plan.invisible import find_invisible_effects
from simulator.effects import parse

SCENARIO = simulator.load("trmm_series")


@pytest.fixture(scope="module")
def found():
    recording = simulator.simulate(SCENARIO, seed=1)
    result = gyrocal.calibrate(recording)
    effects = find_invisible_effects(recording, result.parameters.G, result.parameters.bias, result.sigma)
    return result, {one.label: one for one in effects}


@pytest.mark.parametrize("label", ["scale_quadratic:z", "scale_asymmetry:x"])
def test_a_hidden_effect_moves_the_calibration_as_predicted_and_leaves_no_misfit(found, label):
    """The noise of both recordings is the same, so that their difference is that of the effect."""
    plain, effects = found
    one = effects[label]
    moved = gyrocal.calibrate(simulator.simulate(SCENARIO, seed=1, effects=[parse(f"{label}={one.size}")]))
    change = moved.parameters.vector - plain.parameters.vector
    np.testing.assert_allclose(change, one.change, atol=0.3 * plain.sigma.max() + 0.02 * np.abs(one.change).max())
    assert np.abs(one.sigmas).max() > 10
    assert moved.p_value > 1e-3
    assert "would show it" in one.describe()


def test_effects_that_leave_a_misfit_are_not_listed(found):
    """The slews about y go both ways, and a bias that follows the orbit is seen within an interval."""
    _, effects = found
    assert not {"scale_asymmetry:z", "bias_orbital:y"} & set(effects)
