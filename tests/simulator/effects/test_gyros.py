"""Effects on one of several gyros: what they do to it, and to no other."""

import numpy as np
import pytest

import simulator
from gyrocal import InputError
from simulator.effects import EFFECTS, parse
from simulator.effects.base import SampleView
from simulator.effects.registry import ARRAY_EFFECTS
from simulator.simulate import compute_true_gyros
from tests.simulator.effects.test_effects import SCENARIO

FOUR = simulator.override(
    SCENARIO,
    {"gyro.array": {"axes": [[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]}},
)
PLAIN = simulator.simulate(FOUR, noise=False)
T_S = PLAIN.gyro.t_s


def changed(*texts, noise=False):
    effects = [parse(text) for text in texts]
    return simulator.simulate(FOUR, noise=noise, effects=effects).gyro.rates


def test_gyros_read_the_rate_about_their_axes():
    K, c = compute_true_gyros(FOUR)
    truth = simulator.motion(FOUR).rates
    np.testing.assert_allclose(PLAIN.gyro.rates, truth @ K.T + c, atol=1e-17)
    assert PLAIN.gyro.names == ("1", "2", "3", "4")


def test_errors_of_scale_axis_and_bias_are_those_of_the_scenario():
    errors = {"scale_ppm": [0.0, 1000.0, 0.0, 0.0], "bias_deg_s": [0.0, 0.0, 1e-3, 0.0]}
    errors["misalignment_deg"] = [[0.0, 0.0, 0.0]] * 3 + [[0.1, 0.0, 0.0]]
    other = simulator.override(FOUR, {f"gyro.array.{name}": value for name, value in errors.items()})
    K, c = compute_true_gyros(FOUR)
    K_new, c_new = compute_true_gyros(other)
    np.testing.assert_allclose(K_new[:3], K[:3] * np.array([[1], [1.001], [1]]), rtol=1e-13)
    unit = np.linalg.inv(np.array(FOUR.gyro.true_G))
    np.testing.assert_allclose(K_new[3] - K[3], np.deg2rad(0.1) * unit[0], rtol=1e-9)
    np.testing.assert_allclose(c_new[2] - c[2], np.deg2rad(1e-3), rtol=1e-9)


def test_a_step_of_bias_and_of_scale_is_on_its_gyro_alone():
    late = T_S >= 2500.0
    step = changed("bias_step:4=5,time_s=2500") - PLAIN.gyro.rates
    np.testing.assert_allclose(step[late, 3], np.deg2rad(5 / 3600), rtol=1e-9)
    assert not step[~late].any()
    assert not step[:, :3].any()
    scale = changed("gyro_scale_step:2=100,time_s=2500") - PLAIN.gyro.rates
    bias = compute_true_gyros(FOUR)[1][1]
    np.testing.assert_allclose(scale[late, 1], 1e-4 * (PLAIN.gyro.rates[late, 1] - bias), rtol=2e-3, atol=1e-10)
    assert not scale[:, [0, 2, 3]].any()


def test_noise_and_death_are_on_their_gyro_alone():
    noise = changed(noise=True) - PLAIN.gyro.rates
    more = changed("noise_excess:3=2", noise=True) - PLAIN.gyro.rates
    np.testing.assert_allclose(more, noise * [1, 1, 2, 1], atol=1e-17)
    dead = changed("gyro_dead:1=0.01,time_s=4000", noise=True)
    late = T_S >= 4000
    assert (dead[late, 0] == np.deg2rad(0.01)).all()
    np.testing.assert_array_equal(dead[~late], noise[~late] + PLAIN.gyro.rates[~late])


def test_what_has_no_axis_is_common_to_all_gyros():
    stale = changed("stale_samples=2,fraction=0.05", noise=True)
    repeats = stale[1:] == stale[:-1]
    assert repeats.any()
    assert (repeats.all(axis=1) == repeats.any(axis=1)).all()
    spiked = changed("spikes=0.05,fraction=0.01") != PLAIN.gyro.rates
    assert 0 < np.mean(spiked.all(axis=1)) + np.mean(spiked) < 0.05
    assert not spiked.all(axis=1).any()  # each gyro has its own


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bias_step:9=5,time_s=2500", "bias_step:9: no gyro 9; there are 1, 2, 3, 4"),
        ("bias_step:x=5,time_s=2500", "no gyro x; there are 1, 2, 3, 4"),
        ("g_matrix_step:2=5,time_s=2500,toward=x", "acts on the gyros x, y and z only"),
    ],
)
def test_what_cannot_act_is_said(text, words):
    with pytest.raises(InputError, match=words):
        changed(text)


def test_a_gyro_of_three_has_no_number():
    with pytest.raises(InputError, match="no gyro 4; there are x, y, z"):
        simulator.simulate(SCENARIO, effects=[parse("bias_step:4=5,time_s=2500")])


def view(rates, gyros):
    n = len(rates)
    t_s, sigma = np.arange(n) + 0.5, np.full(rates.shape[1], 1e-6)
    return SampleView(t_s, 1.0, rates, sigma, np.ones(n, dtype=bool), (slice(0, n),), rates, gyros)


def test_a_dead_gyro_is_told_from_one_that_pauses():
    dead = ARRAY_EFFECTS["gyro_dead"]
    rates = np.random.default_rng(0).normal(size=(500, 4))
    assert not dead.detect(view(rates, ("1", "2", "3", "4")))
    paused = rates.copy()
    paused[200:400, 1] = 0.0
    assert not dead.detect(view(paused, ("1", "2", "3", "4")))
    paused[200:, 1] = 0.0
    (found,) = dead.detect(view(paused, ("1", "2", "3", "4")))
    assert (found.axis, found.size, found.parameters["time_s"]) == ("2", 0.0, 200.0)
    assert not dead.detect(view(np.round(0.2 * rates), ("1", "2", "3", "4")))  # a coarse converter
    paused[200:] = 0.0  # all of them: lost telemetry
    assert not dead.detect(view(paused, ("1", "2", "3", "4")))
    assert not dead.detect(view(rates[:, :3] * [1, 0, 1], ("x", "y", "z")))
    assert not set(ARRAY_EFFECTS) & set(EFFECTS)
