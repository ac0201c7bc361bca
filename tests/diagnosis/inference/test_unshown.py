"""What a dead zone hides, and what looks like one."""

import numpy as np
import pytest
from diagnosis.inference.unshown import is_of_the_zone, without_unshown

from diagnosis.detectors.deadzone import NARROWEST, SLOW, TRIED, _log_ratios
from diagnosis.detectors.report import StreamCause
from diagnosis.inference.search import Explanation, Search
from diagnosis.model.candidates import build
from diagnosis.model.prepare import prepare
from simulator import scenario
from simulator.effects import parse
from simulator.simulate import simulate

ZONES = np.geomspace(NARROWEST, 1.5 * SLOW, TRIED)


@pytest.fixture(scope="module")
def bank():
    return build(prepare(simulate(scenario.override(scenario.load("trmm_series"), {}), seed=1)).model)


def swaying(middle, amplitude, seed):
    """Means, in units of their noise, of a rate that sways about a drifting middle."""
    rng = np.random.default_rng(seed)
    t = np.arange(1100.0)
    return middle + np.linspace(-0.5, 0.5, t.size) + amplitude * np.cos(2 * np.pi * t / 37.3), rng.standard_normal(t.size)


@pytest.mark.parametrize("amplitude", [2.6, 3.4, 4.2, 5.5, 7.1])
def test_a_turning_point_at_zero_is_no_dead_zone(amplitude):
    """The rate lingers where it turns; with too few trial amplitudes that reads as a zone."""
    for seed in range(3):
        rate, noise = swaying(amplitude, amplitude, seed)
        assert _log_ratios(rate + noise, ZONES).max() < 0


@pytest.mark.parametrize("amplitude", [7.1, 9.0, 12.0])
def test_the_same_motion_through_a_dead_zone_is_one(amplitude):
    rate, noise = swaying(0.3 * amplitude, amplitude, 5)
    half = 0.7 * amplitude
    ratios = _log_ratios(np.where(np.abs(rate) < half, 0.0, rate) + noise, ZONES)
    assert ratios.max() > 50
    assert ZONES[ratios.argmax()] == pytest.approx(half, rel=0.2)


def test_explanations_that_differ_in_hidden_motion_are_one(bank):
    label = {candidate.label: number for number, candidate in enumerate(bank.candidates)}
    search = Search(bank, np.zeros(bank.W.shape[0]))
    single = {e.members[0].candidate: e.members[0] for e in search.singles()}

    def made(posterior, *names):
        return Explanation(tuple(single[label[name]] for name in names), posterior, posterior)

    horizon, correlated, other = "reference_horizon:z", "reference_correlated:z", "bias_drift:x"
    generic = next(c.label for c in bank.candidates if not c.listed and c.label.endswith(":z"))
    found = [made(3.0, horizon, correlated), made(2.0, horizon), made(1.0, generic), made(0.5, other, generic)]
    merged, nothing = without_unshown(bank, found, {"z"})
    assert [e.key for e in merged] == [frozenset([label[horizon]]), frozenset([label[other]])]
    weights = np.exp([3.0, 2.0, 1.0, 0.5])
    assert merged[0].log_posterior == pytest.approx(np.log(weights[:2].sum()))
    assert nothing == pytest.approx(weights[2] / weights.sum())
    # Without a dead zone, and about another axis, nothing is put down to it.
    assert without_unshown(bank, found, set()) == (found, 0.0)
    assert without_unshown(bank, found, {"y"})[0] == found


def test_noise_and_lines_that_edges_of_a_zone_make():
    def noise(factor):
        return StreamCause("noise_excess", "z", factor, "factor", 0.01, {}, 1e-9)

    assert is_of_the_zone(noise(1.03), half_width=0.5, noise=1.0)  # up to sqrt(1 + 0.25/3) = 1.041
    assert not is_of_the_zone(noise(1.05), half_width=0.5, noise=1.0)
    assert not is_of_the_zone(noise(0.97), half_width=0.5, noise=1.0)  # edges make no noise less
    for frequency, expected in ((0.05, True), (0.4, False)):
        tone = StreamCause("vibration", "z", 1e-4, "deg/s", 1e-5, {"apparent_hz": frequency}, 1e-12)
        assert is_of_the_zone(tone, half_width=0.5, noise=1.0) == expected
    assert not is_of_the_zone(StreamCause("spikes", "z", 1e-2, "deg/s", 1e-3, {}, 1e-12), half_width=0.5, noise=1.0)


def test_edges_of_a_zone_are_no_vibration_and_a_vibration_is_no_zone():
    """A slow line about an axis whose readings pile up at zero speaks for a zone; a tone by itself does not."""
    changes = {"gyro.arw_deg_per_sqrt_s": 1.5e-4, "reference.sigma_deg": (0.005, 0.005, 0.008)}
    plan = scenario.override(scenario.load("trmm_series"), changes)
    for seed, (text, zones) in enumerate(
        (("rate_deadzone:z=6e-4", [2]), ("vibration:y=5e-4,apparent_hz=0.05", []), ("vibration:z=6e-4,apparent_hz=0.06", []))
    ):
        assert [zone.stretches.axis for zone in prepare(simulate(plan, seed=seed, effects=[parse(text)])).zones] == zones
