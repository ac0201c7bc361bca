"""Random effects by their statistics, and what happens to the samples in closed form."""

from dataclasses import replace

import numpy as np
import pytest

import simulator
from gyrocal.allan import compute_allan_variance, overlapping_allan_deviation
from gyrocal.allan.terms import ANGLE_WHITE
from simulator.effects import EFFECTS, ProcessTimes, References, Stream, Surroundings, parse
from simulator.effects.chain import prepare_effects, simulate_readings
from simulator.truth.rotation import separation
from tests.simulator.effects.test_effects import MOTION, PLAIN, SCENARIO

DEG_H = np.deg2rad(1 / 3600)
FLOOR = np.sqrt(2 * np.log(2) / np.pi)  # of the Allan deviation of flicker noise, per B


def still(count, sample_s=1.0, starts=(0.0,)):
    """Samples of a gyro at rest, in intervals of equal length."""
    t_s = np.concatenate([start + sample_s * (np.arange(count) + 0.5) for start in starts])
    zero = np.zeros((t_s.size, 3))
    parts = tuple(slice(k * count, (k + 1) * count) for k in range(len(starts)))
    return Stream(t_s, np.full(t_s.size, sample_s), zero, zero, parts, 5500.0, (t_s[0], t_s[-1]))


def applied(text, stream, seed=0, case=0, arw=0.0, noisy=False):
    rng = simulator.generator(seed, case, "gyro_noise") if noisy else None
    return simulate_readings(around(stream, arw), prepare_effects([parse(text)], seed, case), rng)


def around(stream, arw=0.0):
    """A stream with two references at rest."""
    references = References(np.array(stream.span_s), np.eye(4)[[3, 3]], np.zeros(2, dtype=np.intp), np.array(["", ""]), 5500.0)
    return Surroundings(stream, references, arw, float(stream.duration_s[0]), np.full((2, 3), 1e-4))


def allan_deviation(rate, count):
    """Non-overlapping, at a time of `count` samples."""
    means = rate[: len(rate) // count * count].reshape(-1, count).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means) ** 2))


def test_flicker_has_a_flat_allan_deviation_at_0_664_B():
    """Six seeds of 2¹⁷ samples; the relative error of a deviation from m pairs is about 0.6 √(2/m)/√6 at this noise."""
    stream = still(2**17)
    rates = [applied("noise_flicker:y=2", stream, seed) for seed in range(6)]
    assert not any(rate[:, [0, 2]].any() for rate in rates)
    for count in (32, 128, 512):
        floor = np.sqrt(np.mean([allan_deviation(rate[:, 1], count) ** 2 for rate in rates])) / DEG_H
        error = np.sqrt(2 / (6 * 2**17 / count))
        assert floor == pytest.approx(2 * FLOOR, rel=5 * error + 0.01)


def test_noise_excess_scales_the_very_same_noise():
    plain = simulator.simulate(SCENARIO, seed=3)
    for text, factor in (("noise_excess=2.5", [2.5, 2.5, 2.5]), ("noise_excess:y=0.5", [1, 0.5, 1])):
        made = simulator.simulate(SCENARIO, seed=3, effects=[parse(text)])
        np.testing.assert_allclose(
            made.gyro.rates - PLAIN.gyro.rates, (plain.gyro.rates - PLAIN.gyro.rates) * factor, atol=1e-17
        )
        np.testing.assert_array_equal(made.attitudes.quaternions, plain.attitudes.quaternions)
    made = simulator.simulate(SCENARIO, seed=3, effects=[parse("reference_noise_excess=3")]).attitudes.quaternions
    errors = separation(plain.attitudes.quaternions, PLAIN.attitudes.quaternions)
    np.testing.assert_allclose(separation(made, PLAIN.attitudes.quaternions), 3 * errors, atol=1e-15)


def test_an_effect_leaves_all_other_draws_as_they_were():
    plain = simulator.simulate(SCENARIO, seed=5)
    walk = simulator.simulate(SCENARIO, seed=5, effects=[parse("bias_random_walk:x=5")])
    np.testing.assert_array_equal(walk.gyro.rates[:, 1:], plain.gyro.rates[:, 1:])
    np.testing.assert_array_equal(walk.attitudes.quaternions, plain.attitudes.quaternions)
    both = simulator.simulate(
        SCENARIO,
        seed=5,
        effects=[parse("bias_random_walk:y=5"), parse("reference_correlated:z=1"), parse("bias_random_walk:x=5")],
    )
    np.testing.assert_array_equal(both.gyro.rates[:, [0, 2]], walk.gyro.rates[:, [0, 2]])
    walks = both.gyro.rates - plain.gyro.rates
    assert np.abs(walks[:, 0] - walks[:, 1]).max() > 1e-9


def shown(text, seed=None):
    return simulator.simulate(SCENARIO, seed=seed or 0, noise=seed is not None, effects=[parse(text)]).gyro.rates


STEP, LIMIT = np.deg2rad(1e-3), np.deg2rad(0.3)


@pytest.mark.parametrize(
    ("text", "axes", "change"),
    [
        ("rate_saturation:z=0.3", [2], lambda x: np.clip(x, -LIMIT, LIMIT)),
        ("rate_quantization=1e-3", [0, 1, 2], lambda x: STEP * np.round(x / STEP)),
        ("rate_truncation=1e-3", [0, 1, 2], lambda x: STEP * np.trunc(x / STEP)),
    ],
)
def test_readings_are_clipped_and_come_to_steps_with_their_noise(text, axes, change):
    plain = simulator.simulate(SCENARIO, seed=6).gyro.rates
    expected = plain.copy()
    expected[:, axes] = change(plain[:, axes])
    assert (expected != plain).any()
    np.testing.assert_allclose(shown(text, 6), expected, rtol=0, atol=1e-9 * STEP)


def test_spikes_have_their_share_size_and_sign():
    """200 000 samples a axis, 2000 of them hit: 5 sigma."""
    spikes = np.rad2deg(applied("spikes:z=2,fraction=0.01", still(200_000)))
    assert not spikes[:, :2].any()
    hit = spikes[spikes[:, 2] != 0, 2]
    assert hit.size == pytest.approx(2000, abs=5 * np.sqrt(2000))
    assert np.abs(hit).mean() == pytest.approx(2.0, rel=5 / np.sqrt(hit.size))
    assert hit.mean() == pytest.approx(0, abs=5 * 2 * np.sqrt(2 / hit.size))


def test_stale_samples_repeat_all_axes_within_an_interval():
    plain = simulator.simulate(SCENARIO, seed=6).gyro.rates
    made = shown("stale_samples=5,fraction=0.2", 6)
    changed = (made != plain).any(axis=1)
    assert changed.mean() == pytest.approx(0.2, abs=0.1)
    np.testing.assert_array_equal(made[1:][changed[1:]], made[:-1][changed[1:]])
    assert not changed[[part.start for part in MOTION.intervals]].any()


TIMES = still(12, 30.0, (0.0, 2000.0))
AT = ProcessTimes(TIMES.t_s, np.cumsum(TIMES.duration_s) - 0.5 * TIMES.duration_s, np.repeat([0, 1], 12))
REFERENCES = References(TIMES.t_s, np.tile([0.0, 0, 0, 1], (24, 1)), AT.interval, np.full(24, ""), 5500.0)
DRAWS = 3000


def drawn(setting):
    """Draws of a process on its axis, (DRAWS, 24)."""
    effect, rng = EFFECTS[setting.effect], np.random.default_rng(6)
    if effect.on_references:
        return np.array([effect.reference_wander(rng, REFERENCES, setting)[:, 0] for _ in range(DRAWS)])
    return np.array([effect.wander(rng, TIMES, setting)[:, 0] for _ in range(DRAWS)])


@pytest.mark.parametrize(
    "text",
    [
        "bias_random_walk:x=2,gaps=hold",
        "bias_random_walk:x=2,gaps=reset",
        "noise_flicker:x=2",
        "bias_markov:x=2,time_constant_s=300",
        "reference_correlated:x=2,time_constant_s=300",
    ],
)
def test_a_covariance_is_that_of_the_draws(text):
    """Less the first time's value, which M0 takes up as a bias; six sigma of a covariance from so many draws."""
    made = parse(text)
    expected = 4 * EFFECTS[made.effect].covariance(AT, made.parameters)
    values = drawn(made)
    if EFFECTS[made.effect].stage == "random_rate":
        values = values - values[:, :1]
        expected = expected - expected[:1] - expected[:, :1] + expected[0, 0]
    variance = np.diag(expected)
    error = np.sqrt((np.outer(variance, variance) + expected**2) / DRAWS)
    assert (np.abs(values.T @ values / DRAWS - expected) <= 6 * error + 1e-12 * variance.max()).all()


def test_every_process_has_a_covariance_for_all_its_trials():
    surroundings = replace(around(TIMES), references=REFERENCES)
    for name, effect in EFFECTS.items():
        if effect.is_process:
            trials = effect.trials(surroundings)
            assert sum(trial.weight for trial in trials) == pytest.approx(1.0), name
            for trial in trials:
                K = effect.covariance(AT, trial.parameters)
                assert np.linalg.eigvalsh(K).min() > -1e-9 * np.trace(K)


def test_angle_white_noise_is_that_of_readings_and_does_not_add_up():
    size, plan = np.deg2rad(2 / 3600), simulator.load("trmm_series")
    with_, without = (simulator.simulate(plan, seed=1, effects=one) for one in ([parse("noise_angle_white:z=2")], []))
    difference, sample_s = (with_.gyro.rates - without.gyro.rates)[:, 2], with_.gyro.sample_s
    edges = np.searchsorted(with_.gyro.t_s, [[interval.start_s, interval.stop_s] for interval in with_.intervals])
    parts = [difference[low:high] for low, high in edges]
    found = overlapping_allan_deviation(parts, sample_s, [1, 8, 64])
    expected = size**2 * compute_allan_variance(ANGLE_WHITE, found.tau_s)
    assert np.all(np.abs(found.variance / expected - 1) < 4 * np.sqrt(2 * 35 / 18 / found.counts))
    for part in parts:  # only the first and the last reading remain
        assert abs(np.sum(part) * sample_s) < 6 * np.sqrt(2) * size
