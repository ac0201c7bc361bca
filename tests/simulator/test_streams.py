import numpy as np
import pytest

from simulator.streams import generator


def draws(entropy: int, case: int, name: str) -> np.ndarray:
    return generator(entropy, case, name).standard_normal(1000)


def test_a_stream_is_reproducible_and_independent_of_the_others():
    first = draws(7, 3, "gyro_noise")
    for name in ("reference_noise", "new_stream"):
        draws(7, 3, name)
    np.testing.assert_array_equal(draws(7, 3, "gyro_noise"), first)


def test_pinned_values():
    """A study must give the same numbers with the next version too."""
    np.testing.assert_array_equal(generator(0, 0, "gyro_noise").integers(0, 2**32, 3), [2083569829, 4087709124, 991660696])


def test_neighbouring_entropies_and_cases_share_nothing():
    keys = [(entropy, case, name) for entropy in range(6) for case in range(6) for name in ("a", "b", "ab", "ba", "")]
    streams = np.array([draws(*key) for key in keys])
    assert np.unique(streams).size == streams.size
    correlation = np.corrcoef(streams)[np.triu_indices(len(keys), 1)]
    # 16 110 pairs, standard deviation 1/sqrt(1000) each: the largest lies near 4.1 sigma, beyond 5.5 with 6e-4.
    assert np.abs(correlation).max() < 5.5 / np.sqrt(1000)


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
