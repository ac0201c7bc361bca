"""Swings with a period of their own: their columns against the integral of a sine, and the periods that can show."""

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import InputError
from simulator import scenario
from simulator.effects import EFFECTS
from simulator.effects.periodic import SHORTEST_PERIOD_SPACINGS, compute_period_band
from simulator.effects.registry import REGISTRY
from simulator.simulate import build_surroundings, motion, simulate

PLAN = scenario.override(scenario.load("trmm_series"), {"gyro.sample_s": 2.0, "reference.every_s": 120.0})
AROUND = build_surroundings(simulate(PLAN, noise=False), motion(PLAN))


@pytest.mark.parametrize("name", ["bias_periodic", "reference_periodic"])
def test_periods_are_those_that_the_references_can_show(name):
    effect = EFFECTS[name]
    low, high = compute_period_band(AROUND)
    assert low == pytest.approx(SHORTEST_PERIOD_SPACINGS * 120.0)
    assert high == np.ptp(AROUND.references.t_s)
    trials = effect.trials(AROUND)
    assert sum(trial.weight for trial in trials) == pytest.approx(1.0)
    assert (trials[0].parameters["period_s"], trials[-1].parameters["period_s"]) == pytest.approx((low, high))
    ends = replace(AROUND, references=replace(AROUND.references, interval=np.arange(AROUND.references.t_s.size)))
    assert "series" in effect.missing(ends)
    assert effect.trials(ends) == ()


def test_a_scanned_effect_needs_a_period():
    with pytest.raises(InputError, match="period_s"):
        REGISTRY.register(replace(EFFECTS["bias_orbital"], name="another", scanned=True))
