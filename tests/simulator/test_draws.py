"""Streams of draws, and quick draws: numpy's own, to the bit, which leave the generator where numpy's would."""

import numpy as np
import pytest

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


def test_pinned_values():
    """A study must give the same numbers with the next version too."""
    np.testing.assert_array_equal(generator(0, 0, "gyro_noise").integers(0, 2**32, 3), [2083569829, 4087709124, 991660696])


@pytest.mark.parametrize("entropy", [0, 2**32, 2**200 + 17])
def test_a_stream_is_the_child_of_its_seed_sequence(entropy):
    for key in [(0, b"gyro_noise"), (2**32 - 1, b""), (7, "größe".encode())]:
        child = np.random.SFC64(np.random.SeedSequence(entropy, spawn_key=(key[0], *key[1])))
        ours = generator(entropy, key[0], key[1].decode()).bit_generator
        np.testing.assert_array_equal(ours.random_raw(5), child.random_raw(5))
