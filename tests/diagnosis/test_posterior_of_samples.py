"""Symptoms of one kind have one unlisted cause or none, and the verdict follows from causes and probabilities."""

from dataclasses import replace

import pytest

from diagnosis.answer import Cause
from diagnosis.detectors.sample_report import Symptom
from diagnosis.model.symptoms import SampleCause, compute_posterior
from diagnosis.posterior import list_listed
from diagnosis.settings import DEFAULT
from diagnosis.verdict import decide_verdict

SURE = 1 - DEFAULT.unlisted_in_samples


def seen(kind, axis, effect="an_effect", probability=1.0):
    return SampleCause(Symptom(kind, axis, 1.0, "", 0.1, {}, 1e-30, probability=probability), effect, None)


LESS = compute_posterior(seen("outliers", "y", probability=0.6).symptom, DEFAULT).listed


@pytest.mark.parametrize(
    ("samples", "likely"),
    [
        ([seen("outliers", "x")], [SURE]),
        ([seen("outliers", "x"), seen("outliers", "y")], [SURE, 1.0]),  # as one
        ([seen("outliers", "x"), seen("plateau", "y")], [SURE, SURE]),  # each for itself
        ([seen("white_noise_level", "x"), seen("readout_noise", "y")], [SURE, 1.0]),  # of the noise, both
        ([seen("outliers", "x"), seen("outliers", "y", probability=0.6)], [SURE, LESS / SURE]),  # the least of them
        ([seen("outliers", "x", effect=None), seen("outliers", "y")], [0.0, 0.0]),  # no effect claims one
    ],
)
def test_symptoms_of_one_kind_have_one_unlisted_cause_or_none(samples, likely):
    assert list_listed(samples, DEFAULT) == pytest.approx(likely)


CERTAIN = Cause("bias_drift", "x", 1.0, "deg/h per day", 0.1, {}, 0.95, ("bias_drift:x",), 0.95)
OPEN = replace(CERTAIN, probability=0.6)


@pytest.mark.parametrize(
    ("present", "causes", "unlisted", "further", "verdict"),
    [
        (False, [], 0.0, {}, "none"),
        (False, [], 0.0, {"blind": True}, "not identifiable"),
        (True, [CERTAIN], 0.1, {}, "named"),
        (True, [CERTAIN, OPEN], 0.1, {}, "group"),
        (True, [CERTAIN], 0.51, {}, "partial"),
        (True, [], 0.1, {}, "unknown"),
        (True, [CERTAIN], 0.99, {"beside_remainder": True}, "partial"),
        (True, [CERTAIN], 0.1, {"blind": True}, "named"),
    ],
)
def test_the_verdict_of_causes_and_probabilities(present, causes, unlisted, further, verdict):
    assert decide_verdict(present, causes, unlisted, DEFAULT, **further) == verdict
