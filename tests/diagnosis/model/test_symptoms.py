"""From symptoms to causes: who claims which, an effect's own test before a general symptom, and what is left over."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis.detectors.reference_noise import ReferenceNoise
from diagnosis.detectors.sample_report import Symptom
from diagnosis.model.symptoms import (
    list_sample_causes,
    weigh_symptom,
)
from diagnosis.settings import DEFAULT
from simulator.effects.base import Detection, Effect
from tests.diagnosis.recordings import prepared

OUTLIERS = Symptom("outliers", "y", 0.02, "deg/s", 1e-3, {"fraction": 0.01}, 1e-40, "three samples stick out")
NOISE = ReferenceNoise(np.array([1.0, 1.6, 1.0]), np.full(3, 0.1), p_value=1e-9, axis=1)


class Claims(Effect):
    """Claims a symptom of the samples."""

    def apply(self, rng, samples, stream, setting):
        return samples


class Detects(Claims):
    """Has a test of its own, whose p-value is its summary."""

    def detect(self, view):
        assert view.rates.shape == view.motion.shape
        return [Detection("own", "y", 0.05, "deg/s", 1e-3, {}, 0.0, float(self.summary), "its own test")]


def effect(kind, name, symptom, summary=""):
    return kind(name=name, summary=summary, unit="deg/s", stage="outliers", prior=(1e-3, 1.0), symptom=symptom)


def causes(effects, symptoms=(OUTLIERS,), noise=None):
    found = prepared(3)
    samples = SimpleNamespace(**vars(found.samples) | {"symptoms": list(symptoms)})
    return list_sample_causes(replace(found, samples=samples, reference_noise=noise), effects, DEFAULT)


def test_a_symptom_is_the_effect_that_claims_it_and_otherwise_unlisted():
    (claimed,) = causes([effect(Claims, "mine", "outliers"), effect(Claims, "other", "plateau")])
    (unlisted,) = causes([effect(Claims, "other", "plateau")])
    assert (claimed.effect, unlisted.effect) == ("mine", None)
    assert claimed.finding == unlisted.finding
    assert (claimed.finding.signal, claimed.finding.axis, claimed.finding.p_value) == ("gyro stream", "y", 1e-40)


def test_the_posterior_of_a_symptom_weighs_chance_motion_and_the_unlisted_at_once():
    symptom = replace(OUTLIERS, p_value=1e-6, probability=0.8, likeness=0.3)
    found = weigh_symptom(symptom, DEFAULT)
    assert found.listed + found.unlisted + found.motion + found.chance == pytest.approx(1.0)
    assert found.motion / found.listed == pytest.approx(0.25)
    assert found.chance / found.listed == pytest.approx(np.e * 1e-6 * np.log(1e6) * 30 * 9)
    # How it behaves speaks for the effect, or for something unlisted.
    likeness = [weigh_symptom(replace(symptom, likeness=p), DEFAULT).unlisted for p in (0.5, 1e-2, 1e-4)]
    assert likeness[0] < 0.04 < likeness[1] < 0.3 < 0.8 < likeness[2]
    # What no effect claims is unlisted, or chance and motion.
    nobodys = weigh_symptom(symptom, DEFAULT, is_claimed=False)
    assert (nobodys.listed, nobodys.unlisted + nobodys.motion + nobodys.chance) == (0.0, pytest.approx(1.0))
    assert nobodys.motion / nobodys.unlisted == pytest.approx(0.25)
    # At the threshold of the tests an effect is more probable than not; of a p-value by chance it is not.
    assert weigh_symptom(replace(OUTLIERS, p_value=DEFAULT.sample_event), DEFAULT).listed > 0.8
    assert weigh_symptom(replace(OUTLIERS, p_value=0.01), DEFAULT).chance > 0.9
    assert weigh_symptom(replace(OUTLIERS, p_value=1.0), DEFAULT).chance > 0.99


def test_an_effects_own_test_says_more_than_the_symptom_it_makes_as_well():
    (own,) = causes([effect(Detects, "own", "outliers", "1e-30")])
    assert (own.effect, own.symptom.size, own.finding.text) == ("own", 0.05, "its own test")
    # Where the test of the effect finds nothing, the symptom is nobody's.
    (left,) = causes([effect(Detects, "own", "outliers", "0.5")])
    assert left.effect is None
    assert left.symptom == OUTLIERS


def test_noise_of_the_references_is_a_symptom_only_where_it_departs():
    mine = [effect(Claims, "mine", "reference_noise_level")]
    assert causes(mine, (), replace(NOISE, p_value=0.3)) == ()
    (one,) = causes(mine, (), NOISE)
    assert (one.effect, one.symptom.axis, one.symptom.size, one.symptom.sigma) == ("mine", "y", 1.6, 0.1)
    assert one.finding.signal == "attitude"
    (every,) = causes(mine, (), replace(NOISE, axis=None))
    assert every.symptom.axis is None
    assert (every.symptom.size, every.symptom.sigma) == pytest.approx((1.2, 0.1 / np.sqrt(3)))
