"""A swing with a period of its own in a whole diagnosis: found with its period; a shape that repeats otherwise is not named."""

from dataclasses import replace

import numpy as np
import pytest

from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import recorded

LIBRARY = (
    *("bias_periodic", "bias_orbital", "bias_step", "bias_random_walk", "bias_markov", "noise_flicker"),
    *("reference_periodic", "reference_orbital", "reference_horizon", "reference_correlated"),
)


@pytest.mark.parametrize(
    ("effect", "axis", "size", "period"),
    [
        ("bias_periodic", "z", 0.35, 1730.0),
        pytest.param("reference_periodic", "x", 0.012, 2150.0, marks=pytest.mark.long),
    ],
)
def test_it_is_found_with_its_period_and_size(effect, axis, size, period):
    answer = diagnose(recorded(6, f"{effect}:{axis}={size},period_s={period},phase_deg=-70"), library=LIBRARY)
    assert answer.verdict in ("named", "group")
    (cause,) = answer.causes
    assert f"{effect}:{axis}" in cause.group
    assert abs(cause.parameters["period_s"] - period) < 4 * cause.parameters["period_sigma_s"]
    if cause.effect == effect:
        assert abs(cause.size - size) < 3.5 * cause.sigma
    assert answer.closure.closed > 0.7


@pytest.mark.long
def test_a_sawtooth_is_not_named_as_a_swing():
    """Its second harmonic is half as large as a sine of its period would have to hide."""
    quiet = recorded(6, sample_s=4.0, every_s=240.0)
    rates = quiet.gyro.rates.copy()
    rates[:, 2] += np.deg2rad(1.5 / 3600) * (2 * ((quiet.gyro.t_s / 2400) % 1) - 1)
    answer = diagnose(replace(quiet, gyro=replace(quiet.gyro, rates=rates)))
    assert answer.verdict == "unknown"
    assert any("not as a sine" in label for labels, _ in answer.alternatives[:3] for label in labels)
