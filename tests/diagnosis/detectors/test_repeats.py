"""Samples that repeat the one before on all axes: told from repeats by chance."""

import numpy as np
import pytest

from diagnosis.detectors.repeats import find_repeats, is_measured

SAMPLES = 6000


def repeat(share, seed=2):
    """Continuous readings (n, 3) of which a share repeats the one before, and which those are."""
    rng = np.random.default_rng(seed)
    repeats = rng.random(SAMPLES) < share
    repeats[0] = False
    source = np.maximum.accumulate(np.where(repeats, 0, np.arange(SAMPLES)))
    return rng.standard_normal((SAMPLES, 3))[source], repeats


@pytest.mark.parametrize("share", [0.01, 0.3, 0.7])
def test_continuous_readings_repeat_by_faults_alone_however_many_there_are(share):
    readings, repeats = repeat(share)
    found = find_repeats(readings, np.ones(SAMPLES, dtype=bool))
    assert found.p_value < 1e-100
    np.testing.assert_array_equal(found.mask, repeats)
    assert found.fraction == repeats.mean()
    assert abs(found.size - 1 / (1 - share)) < 4 * found.sigma


def test_readings_of_which_chance_repeats_nearly_all_tell_no_fault():
    """A lattice as coarse as the motion: most samples repeat, and nothing shows that chance does not do it."""
    t = np.arange(SAMPLES)
    readings = np.trunc(3.0 * np.sin(2 * np.pi * t[:, None] / np.array([1700.0, 2300.0, 3100.0])))
    assert find_repeats(readings, np.ones(SAMPLES, dtype=bool)) is None


@pytest.mark.parametrize(("value", "measured"), [(0.3, True), (50.0, False)])
def test_a_repeated_value_equal_to_its_neighbours_was_measured_also_where_the_lattice_hides_all_noise(value, measured):
    """Most readings are the same lattice value, so that neither the noise nor the change of the rate is above zero."""
    readings = np.full((200, 3), 0.3)
    repeated = np.zeros(200, dtype=bool)
    repeated[20::20] = True
    readings[19::20], readings[20::20] = value, value
    with np.errstate(all="raise"):
        assert is_measured(readings, repeated) is measured
