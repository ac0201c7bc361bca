"""What the checks reject is asked once more, with the references' noise judged without it."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis import explain
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.linear_models import linear_model

LAG, OFFSET, WALK = (SimpleNamespace(effect=name, axis=None, process=name == "bias_random_walk") for name in
                     ("rate_lag", "time_offset", "bias_random_walk"))  # fmt: skip


def explained(fitted=(), rejected=()):
    return SimpleNamespace(fitted=fitted, rejected=rejected)


@pytest.mark.parametrize(
    ("first", "second", "taken"),
    [
        (explained(rejected=(LAG,)), explained((LAG,)), True),
        (explained(rejected=(LAG,)), explained((LAG, OFFSET)), True),
        (explained(rejected=(LAG,)), explained((OFFSET,)), False),
        (explained(rejected=(LAG,)), explained(rejected=(LAG,)), False),
        (explained((LAG,)), explained((OFFSET,)), True),
        (explained(rejected=(WALK,)), explained((WALK,)), None),
        (explained(), explained((LAG,)), None),
    ],
)
def test_another_judgement_is_taken_only_if_what_was_rejected_is_found_again(monkeypatch, first, second, taken):
    """None stands for nothing that could be taken out of the residuals, so that nothing is judged anew."""
    answers = iter((first, second))
    monkeypatch.setattr(explain, "explain", lambda *_: next(answers))
    monkeypatch.setattr(explain, "reclassify_without_effects", lambda prepared, at_work, *_: "anew" if at_work else None)
    monkeypatch.setattr(explain, "_add_remainder", lambda prepared, explained, *_: explained)
    found = explain.explain_prepared("at first", list(EFFECTS.values()), DEFAULT, 0, lambda text, share: None)
    assert found == (("anew", second) if taken else ("at first", first))


def test_what_the_checks_reject_is_kept():
    """A drift in data that are much quieter than stated: the effect is there, and the checks of the size reject it."""
    rng = np.random.default_rng(1)
    drift = np.linspace(-1, 1, 300)[:, None]
    model = linear_model([drift, rng.standard_normal((300, 1))], 40 * drift[:, 0] + 0.3 * rng.standard_normal(300))
    found = explain.infer_causes(model, lambda *_: (SimpleNamespace(name="size", p_value=1e-12),), DEFAULT, 0, lambda *_: None)
    assert found.fitted == ()
    assert [one.effect for one in found.rejected] == ["e0"]
    usual = explain.infer_causes(model, lambda *_: (), DEFAULT, 0, lambda *_: None)
    assert [one.effect for one in usual.fitted] == ["e0"]
    assert usual.rejected == ()


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01])
def test_a_linear_model_alarms_at_the_rate_that_is_stated(monkeypatch, share):
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.standard_normal((60, 3)))[0] * 8
    model = linear_model([Q[:, [k]] for k in range(3)], 2 * Q[:, 0] + 0.3 * rng.standard_normal(60))
    monkeypatch.setattr(explain, "compute_null_p", lambda *_: share * DEFAULT.false_alarm_rate)
    found = explain.infer_causes(model, lambda *_: (), DEFAULT, 0, lambda *_: None)
    assert (found.attribution is not None) == (share < 1)
