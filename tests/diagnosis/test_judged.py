"""From a p-value to an alarm: a gap is one from the stated rate of false alarms on."""

from importlib import import_module

import numpy as np
import pytest

from diagnosis.settings import DEFAULT
from tests.diagnosis.linear_models import linear_model

EXPLAIN = import_module("diagnosis.explain")


@pytest.fixture(scope="module")
def model():
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.standard_normal((60, 3)))[0] * 8
    return linear_model([Q[:, [k]] for k in range(3)], 2 * Q[:, 0] + 0.3 * rng.standard_normal(60))


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01])
def test_a_linear_model_alarms_at_the_rate_that_is_stated(model, monkeypatch, share):
    monkeypatch.setattr(EXPLAIN, "compute_null_p", lambda *_: share * DEFAULT.false_alarm_rate)
    found = EXPLAIN.infer_causes(model, lambda *_: (), DEFAULT, 0, lambda *_: None)
    assert (found.attribution is not None) == (share < 1)


def test_thresholds_are_those_of_the_validation():
    """Every validated figure is of these thresholds; who moves one makes the figures anew, and moves it here."""
    values = (DEFAULT.false_alarm_rate, DEFAULT.named, DEFAULT.unknown, DEFAULT.conformal)
    assert values == (0.002, 0.9, 0.5, 0.762)
