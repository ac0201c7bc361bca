import numpy as np
import pytest

from simulator.streams import generator


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
