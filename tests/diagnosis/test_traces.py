"""What a fault of the samples leaves elsewhere is no further fault: beside a coarse lattice, and at edges of a dead zone."""

from types import SimpleNamespace

import pytest

from diagnosis.assemble import _is_of_a_zone
from diagnosis.detectors.report import Symptom
from diagnosis.explain import _is_of_rounding
from diagnosis.model.symptoms import SampleCause
from diagnosis.settings import DEFAULT

COARSE = SimpleNamespace(samples=SimpleNamespace(lattice=(False, True, False)))
FINE = SimpleNamespace(samples=SimpleNamespace(lattice=(False, False, False)))


def candidate(label, listed=True, process=False):
    effect, _, axis = label.partition(":")
    return SimpleNamespace(label=label, effect=effect, axis=axis or None, listed=listed, process=process)


def explained(*named, ranked=(), probability=0.95):
    """An answer with named effects, or without one and with the shares of explanations."""
    candidates = [
        candidate("g_matrix_step:y"),
        candidate("bias_markov:y", process=True),
        candidate("bias_markov:x", process=True),
        candidate("reference_correlated:y", process=True),
        candidate("rate_deadzone:y"),
        candidate("random bias:y", listed=False, process=True),
    ]
    by_label = {one.label: one for one in candidates}
    fitted = tuple(by_label[label] for label in named)
    attribution = SimpleNamespace(
        slots=tuple(SimpleNamespace(probability=probability) for _ in named),
        ranked=tuple(SimpleNamespace(labels=labels, probability=share) for labels, share in ranked),
    )
    return SimpleNamespace(linear=SimpleNamespace(candidates=candidates), attribution=attribution, fitted=fitted)


@pytest.mark.parametrize(
    ("answer", "is_its"),
    [
        (explained("bias_markov:y"), True),  # a random error of the gyro that is rounded
        (explained("bias_markov:x"), False),  # of another one
        (explained("reference_correlated:y"), False),  # not of a gyro
        (explained("bias_markov:y", "g_matrix_step:y"), False),  # beside an effect that has a shape
        (explained(ranked=[(("random bias:y",), 1.0)]), True),
        (explained(ranked=[(("random bias:y", "g_matrix_step:y"), 0.9), (("random bias:y",), 0.1)]), False),
        (explained(ranked=[(("random bias:y", "g_matrix_step:y"), 0.1), (("random bias:y",), 0.9)]), True),
    ],
)
def test_an_error_of_any_course_beside_a_coarse_lattice_is_what_rounding_leaves(answer, is_its):
    assert _is_of_rounding(COARSE, answer) == is_its
    assert not _is_of_rounding(FINE, answer)


def seen(kind, axis):
    return SampleCause(Symptom(kind, axis, 1.0, "deg/s", 0.1, {}, 1e-30), None, None)


def test_jumps_at_the_edges_of_a_dead_zone_are_no_outliers():
    zone = explained("rate_deadzone:y")
    assert _is_of_a_zone(seen("outliers", "y"), zone, DEFAULT)
    assert _is_of_a_zone(seen("noise_constancy", "y"), zone, DEFAULT)
    assert not _is_of_a_zone(seen("outliers", "x"), zone, DEFAULT)
    assert not _is_of_a_zone(seen("lattice_rounded", "y"), zone, DEFAULT)
    assert not _is_of_a_zone(seen("outliers", "y"), explained("rate_deadzone:y", probability=0.6), DEFAULT)
    assert not _is_of_a_zone(seen("outliers", "y"), explained("g_matrix_step:y"), DEFAULT)
