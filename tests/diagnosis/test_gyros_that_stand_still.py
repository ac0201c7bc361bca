"""A gyro whose readings do not change: an answer, and no fault of the program."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import of_rates

SAMPLE_S, ARW = 0.1, 1e-5
NOISE = ARW / np.sqrt(SAMPLE_S)


def turning(seed=3, count=1500):
    """A body that turns slowly and less slowly, about all axes."""
    t_s = SAMPLE_S * np.arange(count)
    rates = 2e-3 * np.sin(2 * np.pi * t_s[:, None] / np.array([170.0, 230.0, 310.0]))
    return of_rates(rates, 50, SAMPLE_S, ARW, 2e-5, seed)


def standing(axes, value, after=0):
    made = turning()
    rates = made.gyro.rates.copy()
    rates[after:, axes] = value
    return replace(made, gyro=replace(made.gyro, rates=rates))


@pytest.mark.parametrize(
    ("axes", "after"),
    [
        pytest.param([0, 1, 2], 0, id="all", marks=pytest.mark.long),
        pytest.param([2], 0, id="one"),
        pytest.param([0], 500, id="one, after a while", marks=pytest.mark.long),
    ],
)
def test_it_is_a_gap(axes, after):
    found = diagnose(standing(axes, 0.0, after))
    assert found.p_value < 1e-100
    assert found.verdict == "unknown"


def test_so_are_readings_on_a_lattice_as_coarse_as_the_motion():
    made, step = turning(), 20
    found = diagnose(replace(made, gyro=replace(made.gyro, rates=step * NOISE * np.round(made.gyro.rates / (step * NOISE)))))
    assert found.p_value < 1e-100
