"""Readout noise of the angle, told from white noise of another level."""

import numpy as np

from diagnosis.detectors.noise_level import fit_noise_level
from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import recorded

SIGMA = 1e-6  # of a sample
SAMPLES = 8000


def drawn(seed, white=1.0, reading=0.0):
    """White noise and readout noise, in SIGMA."""
    rng = np.random.default_rng(seed)
    return SIGMA * (white * rng.standard_normal(SAMPLES) + reading * np.diff(rng.standard_normal(SAMPLES + 1)))


def found_in(x):
    """Readout noise that is likelier than white noise."""
    found = fit_noise_level(x, [(0, x.size)], SIGMA**2)
    return None if found is None or found.readout is None or found.readout.probability < 0.5 else found.readout


def test_its_size_alone_and_beside_white_noise():
    """At a third of the white noise, eighty per cent more power: found every time, with the sigma that it states."""
    found = [found_in(drawn(seed, reading=0.5)) for seed in range(40)]
    assert all(one is not None and one.is_as_stated for one in found)
    pulls = np.array([(one.reading / SIGMA - 0.5) / (one.sigma / SIGMA) for one in found])
    assert abs(pulls.mean()) < 4 / np.sqrt(40)
    assert 0.6 < pulls.std() < 1.4
    for seed in range(10):
        found = found_in(drawn(seed, white=2.0, reading=2.0))
        assert found is not None
        assert not found.is_as_stated
        assert abs(found.reading - 2 * SIGMA) < 4 * found.sigma
        assert abs(found.white - 4 * SIGMA**2) < 4 * found.white_sigma


def test_it_is_named_and_not_an_excess_of_white_noise():
    """On TRMM's plan at a sample of two seconds, about half the white noise of a sample: 0.4 arcsec."""
    answer = diagnose(recorded(20, "noise_angle_white:y=0.4"))
    assert answer.verdict == "named"
    (cause,) = answer.causes
    assert cause.label == "noise_angle_white:y"
    assert abs(cause.size - 0.4) < 3 * cause.sigma
