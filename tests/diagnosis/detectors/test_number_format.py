"""Number formats: the lattice of readings, the noise that it adds, and the mean error of readings that are cut."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.special

from diagnosis.detectors.number_format import compute_cut_error, find_lattice_step, find_lattices
from diagnosis.detectors.sample_report import Stream
from tests.diagnosis.recordings import recorded


def test_a_lattice_shows_through_numbers_printed_with_five_digits():
    x = np.round(np.cumsum(np.random.default_rng(9).standard_normal(5000)) * 40) / 2048
    exponent = np.floor(np.log10(np.maximum(np.abs(x), 1e-9)))
    printed = np.round(x / 10.0 ** (exponent - 4)) * 10.0 ** (exponent - 4)
    assert np.abs(printed * 2048 - np.round(printed * 2048)).max() > 0.02
    assert find_lattice_step(printed) == pytest.approx(1 / 2048, rel=1e-4)
    assert find_lattice_step(printed + 2e-4 * np.random.default_rng(1).standard_normal(x.size)) == 0.0


@pytest.mark.parametrize("level", [0.0, 2.0, -40.0])
def test_the_mean_error_of_cut_readings_is_that_of_its_formula(level):
    noisy = level + 9.0 * np.random.default_rng(8).standard_normal(400_000)
    assert abs(np.mean(np.trunc(noisy)) - level - compute_cut_error(np.array(level), 1.0, 9.0)) < 5 * 9.0 / np.sqrt(400_000)
    assert compute_cut_error(np.array(level), 1.0, 9.0) == pytest.approx(-0.5 * scipy.special.erf(level / 9 / np.sqrt(2)))


def test_rounding_adds_noise_as_long_as_a_reading_stays():
    """Each sample has another reading, or five in a row have one, or there is no lattice."""
    recording, step, rng = recorded(3), 1e-3, np.random.default_rng(2)
    n, sample_s = recording.gyro.t_s.size, recording.gyro.sample_s
    fresh = step * rng.permutation(n)
    rates = np.column_stack([fresh, np.repeat(fresh, 5)[:n], rng.standard_normal(n)])
    recording = replace(recording, gyro=replace(recording.gyro, rates=rates))
    stream = Stream(recording, rates, np.zeros((n, 3)), np.zeros(n, dtype=bool), np.ones(n, dtype=bool))
    density = find_lattices(rates, 0.1 * step).add_noise(stream).density
    assert density[100:400].mean(axis=0) == pytest.approx(step**2 / 12 * sample_s * np.array([1.0, 5.0, 0.0]))
