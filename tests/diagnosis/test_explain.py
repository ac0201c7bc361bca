"""What the attitude shows: the gate, the judgement of the references' noise, idle causes, and the sides of a remainder."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis import explain
from diagnosis.answer import Closure
from diagnosis.budget import Step
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.inference.search import BASELINE_EXPLANATION
from diagnosis.model.linear import SelectedCandidate
from diagnosis.model.processes import BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER
from diagnosis.posterior import Attribution, CredibleGroup
from diagnosis.remainder import find_remainder_side
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.linear_models import linear_model
from tests.diagnosis.recordings import prepared


def ignore(text, share):
    """No progress."""


def find(name):
    """An effect that was found."""
    return SimpleNamespace(effect=name, axis=None, process=name == "bias_random_walk")


@pytest.mark.parametrize("names", [("rate_lag",), ("bias_random_walk",), ()])
def test_the_noise_of_the_references_is_judged_anew_without_the_shapes_that_are_found(monkeypatch, names):
    first, second = (explain.AttitudeInference((), 0.0, fitted=tuple(map(find, own))) for own in (names, ()))
    answers = iter((first, second))
    monkeypatch.setattr(explain, "explain", lambda *_: next(answers))
    monkeypatch.setattr(
        explain, "reclassify_without_effects", lambda prepared, known_effects, *_: "anew" if known_effects else None
    )
    found = explain.explain_prepared("at first", list(EFFECTS.values()), DEFAULT, 0, ignore)
    assert found == (("anew", second) if names == ("rate_lag",) else ("at first", first))


@pytest.mark.parametrize("share", [0.5, 0.99, 1.01])
def test_a_linear_model_alarms_at_the_rate_that_is_stated(monkeypatch, share):
    rng = np.random.default_rng(3)
    Q = np.linalg.qr(rng.standard_normal((60, 3)))[0] * 8
    model = linear_model([Q[:, [k]] for k in range(3)], 2 * Q[:, 0] + 0.3 * rng.standard_normal(60))
    monkeypatch.setattr(explain, "compute_null_p", lambda *_: share * DEFAULT.false_alarm_rate)
    found, inferred = explain.infer_causes(model, DEFAULT, 0, ignore)
    assert (found.attribution is not None) == (inferred is not None) == (share < 1)


@pytest.mark.parametrize(("process", "share", "sure", "stated"), [
    (False, -0.02, True, 1), (True, -0.02, True, 1), (False, 0.02, False, 1), (False, 0.02, True, 2)
])  # fmt: skip
def test_a_cause_that_does_not_close_anything_is_not_stated(monkeypatch, process, share, sure, stated):
    """A random error then belongs to the remainder. A cause whose size differs between parts is stated with what it is like."""
    model = prepared(3, every_s=600.0).model
    rng = np.random.default_rng(1)
    a, b = (
        FittedEffect(name, name, None, "s", 1.0, 0.1, {}, rng.standard_normal((model.size, 1)), np.ones(1), np.ones(1), 2.0,
                     process and name == "bias_drift", np.zeros(model.size))
        for name in ("rate_lag", "bias_drift")
    )  # fmt: skip
    slots = tuple(CredibleGroup(SelectedCandidate(k, 0, 0), 0.99, 0.99, ((one.label, 0.99),)) for k, one in enumerate((a, b)))
    steps = {
        "rate_lag": Step("rate_lag", 2.0, 1.0, 0.75, (0.6, 0.9), size=0.01, sigma=0.001, spread=0.003, ramp=(0.007, 0.0135)),
        "bias_drift": Step("bias_drift", 2.1, 1.0, share, (-0.1, 0.05), size=1.0, sigma=0.1),
    }

    def measure(model, fitted, beside, probabilities):
        own = [steps[one.label] for one in fitted]
        return None, (Step("baseline", 5.0, 1.0), *own, Step("remainder", 2.0, 1.0, 0.55, (0.1, 0.7)), Step("floor", 1.0, 1.0))

    monkeypatch.setattr(explain, "measure_causes", measure)
    monkeypatch.setattr(explain, "is_surely_closing", lambda *_: sure)
    monkeypatch.setattr(explain, "summarise_closure", lambda held: Closure("", "", 5.0, 2.0, 1.0, 0.75, (0.6, 0.9), None))
    monkeypatch.setattr(explain, "summarise_remainder", lambda model, budget, fitted, beside, _: [one.label for one in beside])
    attribution = Attribution("named", BASELINE_EXPLANATION, slots, 0.0, ())
    found = explain.measure_explained(model, explain.AttitudeInference((), 0.0, attribution, (a, b)), DEFAULT)
    sizes = {one.label: one.size for one in found.fitted}
    assert sizes == dict([("rate_lag", 0.01), ("bias_drift", 1.0)][:stated])
    assert [slot.group[0][0] for slot in found.attribution.slots] == list(sizes)
    assert found.remainder == (["bias_drift"] if process else None)
    assert (found.attribution.verdict, found.attribution.unknown) == (("partial", 1.0) if stated == 1 else ("named", 0.0))
    assert found.budget[1 + list(sizes).index("rate_lag")].to_json()["ramp"] == [0.007, 0.0135]


@pytest.mark.parametrize(
    ("powers", "side"), [((8.0, 1.0, 1.0), "gyro"), ((1.0, 9.0, 0.0), "reference"), ((4.0, 5.0, 1.0), "undecided")]
)
def test_a_side_has_two_thirds_of_the_power_of_all_members(powers, side):
    members = [SimpleNamespace(effect=effect) for effect in (BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER)]
    assert find_remainder_side(members, powers) == side
    assert find_remainder_side([SimpleNamespace(effect="rate_lag")], (1.0,)) == "time tags"
