"""What an effect makes elsewhere in the samples is no further effect: jumps at a dead zone's edges, noise of a process."""

import pytest

from diagnosis.detectors.sample_report import Symptom
from diagnosis.model.symptoms import SampleCause, list_symptoms, weigh_consequences
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS


def seen(kind, axis, probability=1.0):
    return SampleCause(Symptom(kind, axis, 1.0, "deg/s", 0.1, {}, 1e-30, probability=probability), None, None)


def weigh(cause, effect, axis="y", probability=1.0):
    return weigh_consequences([cause], [(EFFECTS[effect], axis, probability)], DEFAULT)


@pytest.mark.parametrize(
    ("effect", "kind"),
    [
        ("rate_deadzone", "outliers"),
        ("reference_correlated", "reference_noise_level"),
    ],
)
def test_what_an_effect_makes_needs_no_other_one(effect, kind):
    assert kind in list_symptoms(EFFECTS[effect])
    assert weigh(seen(kind, "y"), effect) == []
    assert weigh(seen(kind, None), effect) == []  # of all axes
    assert weigh(seen(kind, "x"), effect) == [seen(kind, "x")]
    assert len(weigh(seen(kind, "y"), effect, probability=0.2)) == 1
    assert weigh(seen("plateau", "y"), effect) == [seen("plateau", "y")]


def test_one_more_effect_has_its_prior_probability():
    (left,) = weigh(seen("outliers", "y"), "rate_deadzone", probability=0.5)
    assert left.symptom.probability == pytest.approx(1 - 0.5 * (1 - DEFAULT.another))


def test_an_effect_with_columns_makes_nothing_in_the_samples():
    assert list_symptoms(EFFECTS["bias_step"]) == ()
