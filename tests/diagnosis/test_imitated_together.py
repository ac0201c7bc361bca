"""What imitates an effect on one gyro does so on others: causes of one kind in the samples are imitated together."""

import pytest

from diagnosis.detectors.report import Symptom
from diagnosis.model.symptoms import SampleCause, compute_posterior
from diagnosis.posterior import not_imitated
from diagnosis.settings import DEFAULT

SURE = 1 - DEFAULT.imitation_in_samples


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
        ([seen("outliers", "x", effect=None), seen("outliers", "y")], [0.0, 0.0]),  # one is on no list
    ],
)
def test_causes_of_one_kind_are_imitated_together_or_not_at_all(samples, likely):
    assert not_imitated(samples, DEFAULT) == pytest.approx(likely)


def test_whatever_their_order_the_probability_that_none_is_imitated_is_the_same():
    first = [seen("outliers", "x", probability=0.6), seen("outliers", "y"), seen("plateau", "x")]
    products = []
    for samples in (first, first[::-1]):
        product = 1.0
        for one in not_imitated(samples, DEFAULT):
            product *= one
        products.append(product)
    assert products == pytest.approx([LESS * SURE] * 2)
