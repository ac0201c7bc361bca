"""Streams of draws, and quick draws: numpy's own, to the bit, which leave the generator where numpy's would."""

import numpy as np
import pytest

from simulator import draws
from simulator.sensors.gyro import add_white_noise
from simulator.streams import generator


def test_a_million_draws_are_numpys():
    ours, numpys = (generator(20, 0, "gyro_noise") for _ in range(2))
    noise = add_white_noise(ours, np.zeros((333_334, 3)), 1.0, np.ones(333_334))
    np.testing.assert_array_equal(noise, numpys.standard_normal(noise.shape))
    # Of so many draws, hundreds were in the tail beyond all layers, which takes two words and two logarithms.
    assert np.count_nonzero(np.abs(noise) > 3.6541528853610088) > 100
    assert ours.standard_normal() == numpys.standard_normal()
    assert ours.bit_generator.random_raw() == numpys.bit_generator.random_raw()


def test_noise_follows_the_duration_of_each_sample():
    rng = np.random.default_rng(1)
    rates, duration = rng.normal(size=(60, 3)), np.repeat([0.1, 0.02, 0.1], 20)
    expected = rates + generator(3, 1, "gyro_noise").standard_normal((60, 3)) * (0.7 / np.sqrt(duration))[:, None]
    np.testing.assert_array_equal(add_white_noise(generator(3, 1, "gyro_noise"), rates, 0.7, duration), expected)


def test_layers_are_those_of_a_ziggurat():
    width, bound = draws.read_layers()
    x = width[1:256] * 2.0**52
    # The edges x_i of the layers rise to the tail's, and all layers have the area of the lowest with its tail.
    assert x[-1] == pytest.approx(3.6541528853610088, rel=1e-14)
    area = x[1:-1] * (np.exp(-(x[:-2] ** 2) / 2) - np.exp(-(x[1:-1] ** 2) / 2))
    np.testing.assert_allclose(area, width[0] * 2.0**52 * np.exp(-(x[-1] ** 2) / 2), rtol=1e-11)
    assert np.flatnonzero(bound == 0).tolist() == [1, 257], "every other layer has quick draws"
    assert bound[:256].mean() / 2**52 == pytest.approx(0.985, abs=1e-3), "and nearly all draws are quick"


def test_pinned_values():
    """A study must give the same numbers with the next version too."""
    np.testing.assert_array_equal(generator(0, 0, "gyro_noise").integers(0, 2**32, 3), [2083569829, 4087709124, 991660696])


@pytest.mark.parametrize("entropy", [0, 1998, 2**32, 2**127 + 5, 2**200 + 17])
def test_a_stream_is_the_child_of_its_seed_sequence(entropy):
    for key in [(0, b"gyro_noise"), (2**32 - 1, b""), (7, "größe".encode())]:
        child = np.random.SFC64(np.random.SeedSequence(entropy, spawn_key=(key[0], *key[1])))
        ours = generator(entropy, key[0], key[1].decode()).bit_generator
        np.testing.assert_array_equal(ours.random_raw(5), child.random_raw(5))


@pytest.mark.parametrize(("entropy", "case", "words"), [(-1, 0, "entropy"), (0, -1, "case must"), (0, 2**32, "case must")])
def test_what_is_out_of_range_is_refused(entropy, case, words):
    with pytest.raises(ValueError, match=words):
        generator(entropy, case, "gyro_noise")
