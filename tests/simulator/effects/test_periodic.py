"""Swings with a period of their own: their columns against the integral of a sine, and the periods that can show."""

from dataclasses import replace

import numpy as np
import pytest

from gyrocal.errors import InputError
from simulator import scenario
from simulator.effects import EFFECTS, parse, setting
from simulator.effects.periodic import SHORTEST_PERIOD_SPACINGS, compute_period_band
from simulator.effects.registry import REGISTRY
from simulator.simulate import build_surroundings, motion, simulate

PLAN = scenario.override(scenario.load("trmm_series"), {"gyro.sample_s": 2.0, "reference.every_s": 120.0})
AROUND = build_surroundings(simulate(PLAN, noise=False), motion(PLAN))


def test_a_sample_shows_the_mean_of_the_swing():
    """Of size · sin(2π t/P + φ) over the sample, from its integral."""
    period, phase, size = 40.0, 0.7, 3.0
    with_, without = (
        simulate(PLAN, seed=1, effects=texts)
        for texts in ([parse(f"bias_periodic:y={size},period_s={period},phase_deg={np.rad2deg(phase)}")], [])
    )
    added = np.rad2deg(with_.gyro.rates - without.gyro.rates) * 3600
    t = without.gyro.t_s
    angle = [2 * np.pi * edge / period + phase for edge in (t, t + 2.0)]
    expected = size * period / (2 * np.pi * 2.0) * (np.cos(angle[0]) - np.cos(angle[1]))
    late = np.abs(added[:, 1] - expected) > 1e-6  # the last sample of an interval may be a shorter one
    assert late.sum() <= len(without.intervals)
    assert np.abs(added[:, [0, 2]]).max() < 1e-12
    np.testing.assert_array_equal(with_.attitudes.quaternions, without.attitudes.quaternions)


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


def test_size_and_phase_go_through_the_amplitudes_and_back():
    effect = EFFECTS["bias_periodic"]
    size, held = effect.from_amplitudes(effect.amplitudes(setting("bias_periodic", "z", -0.3, {"phase_deg": 50.0})))
    assert (size, held["phase_deg"]) == pytest.approx((0.3, -130.0))


def test_a_scanned_effect_needs_a_period():
    with pytest.raises(InputError, match="period_s"):
        REGISTRY.register(replace(EFFECTS["bias_orbital"], name="another", scanned=True))
