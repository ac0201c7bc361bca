from dataclasses import replace

import numpy as np
import pytest

from diagnosis.adopt import adopt_causes, write_adopted_scenario
from diagnosis.answer import RemainderSummary
from diagnosis.diagnose import diagnose
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.processes import BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER
from gyrocal import load, save
from simulator import adopted_scenario as scenarios
from simulator.effects import REGISTRY, parse
from tests import diagnosis_cases
from tests.diagnosis.recordings import recorded

ORBITAL = "bias_orbital:z=0.3,phase_deg=60"
COARSE = {"sample_s": 4.0, "every_s": 240.0}


@pytest.fixture(scope="module")
def found():
    return diagnose(recorded(5, ORBITAL, **COARSE), library=["bias_orbital"])


def test_the_posterior_holds_the_truth(found):
    adoption = adopt_causes(found)
    assert [one.label() for one in adoption.effects] == ["bias_orbital:z"]
    effect = REGISTRY["bias_orbital"]
    off = effect.amplitudes(adoption.effects[0]) - effect.amplitudes(parse(ORBITAL))
    assert off @ np.linalg.solve(adoption.covariance, off) < 18.4  # χ² of two, one in 10 000
    # The sigma of the size that is stated is that of the amplitudes, along them.
    (cause,) = found.causes
    along = effect.amplitudes(adoption.effects[0]) / cause.size
    assert np.sqrt(along @ adoption.covariance @ along) == pytest.approx(cause.sigma, rel=0.1)


def test_a_verdict_that_names_nothing_adopts_nothing():
    adoption = adopt_causes(diagnosis_cases.unknown())
    assert adoption.effects == ()
    assert "without effects" in adoption.sentence()


def test_random_errors_of_the_remainder_are_processes_of_the_scenario(found, tmp_path):
    """In the units of their effects, and flown with the causes; what has no effect is left out."""
    empty = np.zeros((0, 0))

    def member(effect, axis, size, tau):
        parameters = {"time_constant_s": tau}
        sigma, none = 0.1 * size, np.zeros(0)
        return FittedEffect(effect, effect, axis, "", size, sigma, parameters, empty, empty, empty, size, True, none)

    arcsec = np.deg2rad(1 / 3600)
    unnamed = (
        member(BIAS_WANDERS, "x", 2 * arcsec, 300.0),
        member(REFERENCES_WANDER, "y", 5 * arcsec, 600.0),
        member(TAGS_WANDER, None, 0.02, 900.0),
        member("scale factor or misalignment wanders", "z", 1e-4, 900.0),
    )
    rest = RemainderSummary(0.3, (0.2, 0.4), (2, 0, 0), (0, 5 / 3600, 0), 0.02, 0.0, 1.3, "gyro", 300.0, ())
    both = replace(found, details=replace(found.details, unnamed=unnamed), remainder=rest)
    adoption = adopt_causes(both)
    assert [one.label() for one in adoption.remainder] == [
        "bias_markov:x", "reference_correlated:y", "clock_wander", "reference_noise_excess",
    ]  # fmt: skip
    assert [one.size for one in adoption.remainder] == pytest.approx([2.0, 5 / 3600, 0.02, 1.3])
    assert np.sqrt(np.diag(adoption.covariance))[-4:] == pytest.approx([0.2, 0.5 / 3600, 0.002, 0.0])
    save(recorded(5, ORBITAL, **COARSE), tmp_path / "rec")
    recording = load(tmp_path / "rec")
    text, _ = write_adopted_scenario(both, recording, tmp_path / "rec", tmp_path / "adopted.toml")
    (tmp_path / "adopted.toml").write_text(text)
    flown, plain = scenarios.load(tmp_path / "adopted.toml"), adopt_causes(found)
    np.testing.assert_allclose(flown.plan.bias, both.bias)
    moved = flown.fly(seed=3, noise=False).gyro.rates - flown.fly(seed=3, effects=plain.effects, noise=False).gyro.rates
    assert np.rad2deg(moved[:, 0].std()) * 3600 == pytest.approx(2.0, rel=0.6)  # few time constants
    assert "the remainder as" in adoption.sentence()


def test_effects_with_and_without_amplitudes_keep_their_places(found):
    (cause,) = found.causes
    noise = replace(cause, effect="noise_excess", axis="x", size=1.4, sigma=0.05, unit="factor", parameters={})
    both = replace(found, causes=(noise, cause))
    covariance = adopt_causes(both).covariance
    assert covariance[0, 0] == pytest.approx(0.05**2)
    np.testing.assert_array_equal(covariance[1:, 1:], adopt_causes(found).covariance)
    assert not covariance[0, 1:].any()
