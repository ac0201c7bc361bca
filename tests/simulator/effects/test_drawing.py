"""How effects are drawn for a blind check, and from which size on they show in the samples."""

import numpy as np
import pytest

import simulator
from simulator.effects import EFFECTS, SampleTests, setting
from simulator.simulate import add_gyro_temperature, build_surroundings
from tests.simulator.effects.test_effects import MOTION, PLAIN, SCENARIO

AROUND = build_surroundings(add_gyro_temperature(PLAIN), MOTION)
TESTS = SampleTests(
    power=0.9, quiet=(3000, 800), event_p=1e-6, correlated=1.5, line_p=1e-6, lowest_line_hz=0.02, outlier_sigma=6.0,
    fewest_clipped=5, coarse=0.3, fewest_references=10, reference_p=1e-4, trimming=1.2,
)  # fmt: skip


@pytest.mark.parametrize("name", EFFECTS)
def test_what_is_drawn_can_be_simulated(name):
    effect, rng = EFFECTS[name], np.random.default_rng(3)
    drawn = set()
    for _ in range(20):
        axis, parameters = effect.draw(rng, AROUND)
        size = effect.draw_size(rng, AROUND, axis)
        if effect.drawn:  # all else than what shows in the samples gets its size by its signal-to-noise ratio
            assert (size is not None) == effect.in_samples
        low, high = effect.prior
        made = setting(name, axis, np.sqrt(low * high) if size is None else size, parameters)
        assert low <= abs(made.size) <= high
        drawn.add((axis, *sorted(made.parameters.items())))
    recording = simulator.simulate(SCENARIO, seed=1, effects=[made])
    np.testing.assert_array_equal(recording.gyro.t_s, PLAIN.gyro.t_s)
    np.testing.assert_array_equal(recording.attitudes.sigma, PLAIN.attitudes.sigma)
    if effect.on_references:
        np.testing.assert_array_equal(recording.gyro.rates, simulator.simulate(SCENARIO, seed=1).gyro.rates)
    # Without an axis and parameters there is nothing to draw; the saturation's axis is that of the fastest turn.
    assert len(drawn) > 1 or not (effect.axes or effect.parameters) or name == "rate_saturation"


@pytest.mark.parametrize(
    "name", [name for name, effect in EFFECTS.items() if effect.symptom and effect.smallest(AROUND, TESTS)]
)
def test_the_smallest_size_goes_with_the_thresholds_of_the_tests(name):
    """Finite and plausible here; stricter tests take a larger size, or fewer chances to be seen."""
    effect = EFFECTS[name]
    sizes = np.array([one.size for one in effect.smallest(AROUND, TESTS)])
    assert (sizes > 0).all()
    assert (sizes < effect.prior[1]).all()
    strict = SampleTests(
        **vars(TESTS)
        | {"event_p": 1e-12, "line_p": 1e-12, "outlier_sigma": 12.0, "coarse": 3.0, "reference_p": 1e-12, "fewest_clipped": 500}
    )
    stricter = np.array([one.size for one in effect.smallest(AROUND, strict)])
    if name == "stale_samples":  # exact repeats need no threshold
        np.testing.assert_array_equal(stricter, sizes)
    elif name == "rate_saturation":  # a limit: lower ones are seen more easily
        assert (stricter < sizes).all()
    else:
        assert (stricter > sizes).all()


@pytest.mark.parametrize("name", ["noise_excess", "vibration", "spikes", "reference_noise_excess"])
def test_too_few_samples_show_nothing(name):
    few = SampleTests(**vars(TESTS) | {"quiet": (20,), "fewest_references": 1000})
    (one,) = EFFECTS[name].smallest(AROUND, few)
    assert one.size == np.inf
    assert one.text
