"""The one list of causes beside a remainder: where its search begins, and which causes it states."""

from types import SimpleNamespace

import numpy as np
import pytest

from diagnosis import explain, remainder_search
from diagnosis.budget import Step, select_closing
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.inference.attribution import Attribution, CredibleGroup
from diagnosis.inference.search import BASELINE_EXPLANATION
from diagnosis.model.linear import SelectedCandidate
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.recordings import prepared

ALL = list(EFFECTS.values())


def ignore(text, share):
    """No progress."""


def fitted(label, rows, process=False, size=1.0):
    rng = np.random.default_rng(len(label))
    columns = rng.standard_normal((rows, 1))
    return FittedEffect(
        label, label, None, "s", size, 0.1, {}, columns, np.ones(1), np.ones(1), 2.0, process, np.zeros(rows)
    )  # fmt: skip


def slot(label, p):
    return CredibleGroup(SelectedCandidate(0, 0, 0), p, ((label, p),))


@pytest.fixture(scope="module")
def recording():
    return prepared(3, every_s=600.0)


def test_the_remainder_is_first_estimated_beside_the_shapes_that_were_found_without_it(recording, monkeypatch):
    seen = []

    def estimate(model, processes, columns, *_):
        seen.append(columns)
        raise InterruptedError

    monkeypatch.setattr(remainder_search, "estimate_remainder", estimate)
    lag, walk = fitted("rate_lag", recording.model.size), fitted("bias_random_walk", recording.model.size, process=True)
    with pytest.raises(InterruptedError):
        remainder_search.identify_beside_remainder(recording.model, ALL, DEFAULT, ignore, (lag, walk))
    assert np.array_equal(seen[0], 2.0 * lag.columns)


def test_a_cause_is_stated_whose_size_differs_between_parts_and_none_that_closes_less_than_nothing():
    steps = [
        Step("baseline", 5.0, 1.0),
        Step("a", 2.0, 1.0, 0.75, (0.6, 0.9), heterogeneity_p=1e-30, spread=0.003, ramp=(0.007, 0.0135)),
        Step("b", 2.1, 1.0, -0.02, (-0.1, 0.05)),
        Step("remainder", 2.1, 1.0, 0.27, (0.1, 0.4)),
    ]
    a, b = slot("a", 0.99), slot("b", 0.97)
    assert select_closing([a, b], steps) == [a]
    assert steps[1].to_json()["ramp"] == [0.007, 0.0135]


@pytest.mark.parametrize("found", [True, False])
def test_probabilities_budget_and_share_are_of_one_list(recording, monkeypatch, found):
    """Causes that are not on the list beside the remainder are not stated, whatever was stated before."""
    lag, drift = fitted("rate_lag", recording.model.size), fitted("bias_drift", recording.model.size)
    first = Attribution("partial", BASELINE_EXPLANATION, (slot("rate_lag", 0.95), slot("bias_drift", 0.93)), 0.99, ())
    before = explain.AttitudeInference((), 0.0, first, (lag, drift), (), None, np.zeros(12), np.eye(12), first=(lag, drift))
    own = ((slot("rate_lag", 0.97),), (lag,)) if found else ((), ())
    beside = SimpleNamespace(
        slots=own[0], fitted=own[1], budget=("budget",), closed="share" if found else None, model=recording.model,
        change=np.ones(12), covariance=2 * np.eye(12), remainder="left",
    )  # fmt: skip
    given = []
    monkeypatch.setattr(explain, "identify_beside_remainder", lambda *own: given.append(own) or beside)
    monkeypatch.setattr(explain, "list_sample_causes", lambda *_: ())
    answer = explain._add_remainder(recording, before, ALL, DEFAULT, ignore)
    assert given[0][4] == (lag, drift)
    assert [one.label for one in answer.fitted] == [one.group[0][0] for one in answer.attribution.slots]
    assert (answer.attribution.verdict, answer.closed) == (("partial", "share") if found else ("unknown", None))
    assert answer.budget == ("budget",)
