"""Slews that separate two effects: information of intervals against the whole recording's model, and brute force."""

from itertools import product

import numpy as np
import pytest

from diagnosis.plan.columns import linearise_noise_free
from diagnosis.plan.objectives import SeparationObjective
from diagnosis.plan.optimise import exchange_designs, optimise_plan
from diagnosis.plan.separate import evaluate_separation
from diagnosis.plan.slew_design import IntervalDesign, SlewLimits, build_interval
from gyrocal import InputError
from simulator.scenario import load, override

LIMITS = SlewLimits(*np.deg2rad([0.5, 0.02]), slew_s=400.0)
EFFECTS = "scale_quadratic", "bias_drift"
STILL = IntervalDesign(0, 0)


@pytest.fixture(scope="module")
def objective():
    """A long interval, which keeps its orbit rate, and two short ones."""
    whole = override(load("trmm_series"), {"gyro.sample_s": 5.0, "reference.every_s": 120.0})
    return SeparationObjective(
        whole.model_copy(update={"interval": tuple(whole.interval[k] for k in (0, 1, 5))}), LIMITS, *EFFECTS
    )


def turn(x, y, z):
    return IntervalDesign(0, 0, tuple(np.deg2rad([x, y, z]).tolist()), (0.0, 1.0))


def test_information_adds_to_the_size_of_the_whole_recordings_model(objective):
    """Two plans; the columns of the second effect count their time from the start of the recording."""
    scenario = objective.scenario
    for designs in ([turn(0, 0, 40), turn(30, 0, 0), turn(0, 45, 0)], [STILL, turn(0, 20, 20), turn(50, 0, 30)]):
        sections = [build_interval(one, design, LIMITS) for one, design in zip(scenario.interval, designs, strict=True)]
        model = linearise_noise_free(scenario.model_copy(update={"interval": tuple(sections)}))
        size = evaluate_separation("", model, *EFFECTS, None).size
        assert np.exp(objective.compute_values(designs).max()) == pytest.approx(size, rel=1e-6)


def test_the_exchange_reaches_the_best_of_all_combinations(objective):
    """Brute force: all sets of slews on a grid of axes and angles in the two short intervals, by the smooth worst size."""

    def compute(plan):
        return float(objective.compute_smooth_worst(sum(objective.measure(k, one).information for k, one in enumerate(plan))))

    grid = [STILL] + [turn(*(angle * np.array(axis))) for angle in (20, 45) for axis in np.vstack([np.eye(3), -np.eye(3)])]
    values = []
    for pair in product(grid, repeat=2):
        plan = [STILL, *pair]
        fits = all(objective.measure(k, one).is_allowed for k, one in enumerate(plan))
        if fits and objective.compute_slew_time(plan) <= LIMITS.slew_s:
            values.append(compute(plan))
    assert len(values) > 15
    designs = exchange_designs(objective, [STILL] * 3)
    assert compute(designs) <= min(values) + 1e-6
    assert objective.compute_slew_time(designs) <= LIMITS.slew_s


def test_the_sizes_of_a_plan_are_those_of_its_whole_recording(objective, monkeypatch):
    """Without the exchange, for time; the first plan has one slew and separates nothing."""
    monkeypatch.setattr("diagnosis.plan.optimise.exchange_designs", lambda objective, designs: designs)
    found = optimise_plan(objective.scenario, LIMITS, separate=EFFECTS)
    before, after = found.separation
    assert (before.size, after.size) == pytest.approx(
        [evaluate_separation("", linearise_noise_free(one), *EFFECTS, None).size for one in (found.baseline, found.scenario)]
    )
    assert found.to_json()["separation"]["after"]["size"] == after.size
    assert found.slew_s <= LIMITS.slew_s


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        (("bias_random_walk", "bias_drift"), "is a random effect"),
        (("bias_temperature", "bias_orbital"), "depends on the others"),
        (("bias_step", "bias_orbital"), "bias_step: a diagnosis searches its time"),
        (("acceleration_sensitivity", "bias_orbital"), "acceleration_sensitivity: the scenario cannot show it"),
    ],
)
def test_effects_that_slews_cannot_be_searched_for_are_refused(effects, words):
    series = override(load("trmm_series"), {"gyro.sample_s": 5.0, "reference.every_s": 240.0})
    with pytest.raises(InputError, match=words):
        SeparationObjective(series, LIMITS, *effects)
