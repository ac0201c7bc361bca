"""Whether the references have white noise of the stated size: its factors, and what is no noise of theirs."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from diagnosis.detectors.reference_noise import ReferenceSeries, reference_noise
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.simulate import simulate
from tests.diagnosis.recordings import of_rates, plan, prepared, recorded


@pytest.mark.parametrize(("stated", "axis"), [((1, 1, 1), None), ((1.5, 1.5, 1.5), None), ((1, 1.6, 1), 1)])
def test_noise_of_the_references(stated, axis):
    recording = recorded(22, every_s=60.0)
    sigma = recording.attitudes.sigma / np.array(stated)
    found = prepare(replace(recording, attitudes=replace(recording.attitudes, sigma=sigma)))
    noise = found.reference_noise
    assert noise.departs == (stated != (1, 1, 1))
    if noise.departs:
        assert noise.axis == axis
        assert np.abs((noise.factor - stated) / noise.sigma).max() < 4
        # The model then has the noise there is.
        model = found.model
        assert scipy.stats.chi2.sf(model.y @ model.y, model.degrees_of_freedom) > 1e-4


@pytest.mark.parametrize("text", ["bias_orbital:y=1.0", "reference_orbital:x=0.05", "bias_random_walk:z=1.0"])
def test_noise_of_the_references_is_no_slow_error(text):
    """Second differences leave a drifting bias and a slow reference error out."""
    assert not prepared(23, text, every_s=60.0).reference_noise.departs


@pytest.mark.parametrize("seed", [1, 2])
def test_a_noisy_gyro_is_no_noise_of_the_references(seed):
    found = prepared(seed, "noise_excess:y=3", every_s=60.0).reference_noise
    assert found is not None
    assert not found.departs


def test_a_small_dead_zone_is_no_noise_of_the_references():
    found = prepared(4, "rate_deadzone:z=9e-4", sample_s=0.5, every_s=60.0)
    assert [one.axis for one in found.dead] == [2]
    assert found.reference_noise is None or not found.reference_noise.departs


def test_without_a_series_of_references_their_noise_is_not_tested():
    ends = scenario.override(plan(), {"reference.at": "ends"})
    found = prepare(simulate(ends, seed=1))
    assert found.reference_noise is None
    assert any("degrees of freedom" in note for note in found.notes)


def spinning(change):
    """A body that spins about z and nutates, with a misalignment of x towards z that changes by so much halfway; 4 Hz."""
    t_s = 0.25 * np.arange(4800)
    rates = np.deg2rad(
        np.column_stack([0.3 * np.sin(0.21 * t_s), 0.3 * np.cos(0.21 * t_s), 6.0 + 0.5 * np.sin(2 * np.pi * t_s / 600)])
    )
    one = of_rates(rates, 16, 0.25, np.deg2rad(2e-4), np.deg2rad(0.004), seed=5)
    read = one.gyro.rates.copy()
    read[2400:, 0] += change * rates[2400:, 2]
    return replace(one, gyro=replace(one.gyro, rates=read))


def test_what_follows_the_motion_or_drifts_is_no_noise_of_the_references():
    """Half-way changes of a misalignment, and biases that drift while the body turns, are taken out before it is tested."""
    for calm in (spinning(0.0), spinning(5e-3)):
        assert not prepare(calm).reference_noise.odd
    still = spinning(0.0)
    drift = np.deg2rad(0.02) * np.linspace(-1, 1, still.gyro.t_s.size)[:, None] * [1.0, 0.0, 0.0]
    drifting = replace(still, gyro=replace(still.gyro, rates=still.gyro.rates + drift))
    found = prepare(drifting)
    assert not found.reference_noise.odd
    assert misjudged(found.model)


def misjudged(model):
    """Whether the references' noise is not as stated where nothing that follows the motion is taken out."""
    recording = model.recording
    series = ReferenceSeries(
        t_s=model.references.t_s,
        interval=model.interval_of_reference,
        sigma=recording.attitudes.sigma[model.reference_rows],
        to_inertial=model.at_reference,
        residuals=model.residuals,
        rates=np.zeros((model.references.t_s.size, 3)),
    )
    silent = np.zeros(recording.gyro.rates.shape, dtype=bool)
    return reference_noise(series, np.full(3, recording.gyro.arw**2), recording.gyro.t_s, silent).odd
