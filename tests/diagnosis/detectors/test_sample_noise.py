"""Level of the noise of a body that never rests: how precise it is, and that no motion passes for noise."""

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.noise_spectrum import fit_noise_spectrum
from diagnosis.detectors.samples import examine
from diagnosis.diagnose import diagnose
from tests.diagnosis.recordings import of_rates, recorded


def swing(count, size=1000.0):
    """A smooth motion, in sigmas of the noise."""
    return size * np.sin(2 * np.pi * 0.04 * np.arange(count))


def steps(rng, count, number, size=8.0):
    """A rate that changes at once, now and then."""
    jerks = np.zeros(count)
    jerks[rng.choice(count, number, replace=False)] = size
    return np.cumsum(jerks)


def found_in(x):
    return fit_noise_spectrum(x, [(0, x.size)], 1.0)


@pytest.mark.parametrize(("count", "draws"), [(600, 300), (3000, 200)])
def test_level_and_p_value_are_calibrated(count, draws):
    """Beside a swing. The two templates go together, so that twice the smaller p-value is a little more than uniform."""
    rng = np.random.default_rng(count)
    found = [found_in(rng.standard_normal(count) + swing(count)) for _ in range(draws)]
    found = [one for one in found if one is not None]
    assert len(found) > 0.97 * draws
    pulls = np.array([(one.variance - 1) / (one.sigma / one.variance) for one in found])
    assert abs(pulls.mean()) < 4 / np.sqrt(len(found))
    assert pulls.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(found)))
    p = np.array([one.p_value for one in found])
    for at in (0.5, 0.1, 0.02):
        assert scipy.stats.binom.sf(np.sum(p < at) - 1, p.size, at) > 1e-3
    assert np.mean(p < 0.5) > 0.25


def test_jerks_are_no_noise():
    """Of rates that step at some places or at very many, of every size: the p-value stays above what an alarm needs."""
    rng = np.random.default_rng(12)
    least = 1.0
    for size in (1.0, 3.0, 8.0, 100.0):
        for number in (20, 200, 2000):
            x = rng.standard_normal(20_000) + steps(rng, 20_000, number, size)
            one = found_in(x)
            least = min(least, 1.0 if one is None else one.p_value)
    assert least > 1e-3
    assert found_in(rng.standard_normal(60_000) + steps(rng, 60_000, 12_000)) is None


def band(rng, count, low, high, power):
    """Noise in a band of frequencies, in cycles a sample."""
    spectrum = np.fft.rfft(rng.standard_normal(count))
    at = np.fft.rfftfreq(count)
    part = np.fft.irfft(np.where((at > low) & (at < high), spectrum, 0.0), count)
    return np.sqrt(power) * part / part.std()


def symptoms_of(noise, seed=1):
    """What the samples show of bodies that hardly turn, whose rates have some more noise, in sigmas of the stated one."""
    arw, sample_s = 1e-5, 0.1
    swing = np.deg2rad(0.2) * np.sin(2 * np.pi * sample_s * np.arange(len(noise))[:, None] / np.array([400.0, 300.0, 500.0]))
    return examine(of_rates(swing + arw / np.sqrt(sample_s) * noise, 20, sample_s, arw, 1e-4, seed)).symptoms


def test_a_shaking_body_has_no_symptom_and_noise_of_the_same_power_has():
    rng = np.random.default_rng(5)
    shaking = np.column_stack([band(rng, 12_000, 0.3, 0.36, 0.25) for _ in range(3)])
    assert symptoms_of(shaking) == ()
    assert [one.kind for one in symptoms_of(0.5 * rng.standard_normal((12_000, 3)))] == ["white_noise_level"]


SIGMA = 1e-6  # of a sample
SAMPLES = 8000


def drawn(seed, white=1.0, reading=0.0):
    """White noise and readout noise, in SIGMA."""
    rng = np.random.default_rng(seed)
    return SIGMA * (white * rng.standard_normal(SAMPLES) + reading * np.diff(rng.standard_normal(SAMPLES + 1)))


def find_readout(x):
    """Readout noise that is likelier than white noise."""
    found = fit_noise_spectrum(x, [(0, x.size)], SIGMA**2)
    return None if found is None or found.readout is None or found.readout.probability < 0.5 else found.readout


def test_its_size_alone_and_beside_white_noise():
    """At a third of the white noise, eighty per cent more power: found every time, with the sigma that it states."""
    found = [find_readout(drawn(seed, reading=0.5)) for seed in range(40)]
    assert all(one is not None and one.is_as_stated for one in found)
    pulls = np.array([(one.reading / SIGMA - 0.5) / (one.sigma / SIGMA) for one in found])
    assert abs(pulls.mean()) < 4 / np.sqrt(40)
    assert 0.6 < pulls.std() < 1.4
    for seed in range(10):
        found = find_readout(drawn(seed, white=2.0, reading=2.0))
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
