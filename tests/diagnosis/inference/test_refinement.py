"""Finer options around what explains best, and around what nearly does."""

from dataclasses import replace

import numpy as np

from diagnosis.inference.joint_search import JointSearch, infer_set
from diagnosis.inference.refinement import find_near_alternatives
from diagnosis.inference.search import Search
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.linear import ParameterChoice
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS
from tests.diagnosis.linear_models import linear_model
from tests.diagnosis.recordings import prepared

SIZE = 3.0


def between_two_options():
    """A listed effect whose column lies between its two options, beside a rival that is nearer to it than either, and noise."""
    rng = np.random.default_rng(21)
    Q = np.linalg.qr(rng.standard_normal((80, 4)))[0] * 8
    true = (Q[:, 0] + Q[:, 1]) / np.sqrt(2)
    rival = 0.9 * true + np.sqrt(1 - 0.9**2) * Q[:, 2]
    y = SIZE * true + rng.standard_normal(80)
    columns = [[Q[:, [0]], Q[:, [1]]], rival[:, None], Q[:, [3]]]

    def refine(model, member):
        entry = model.candidate(member)
        if member.candidate != 0 or len(entry.options) > 2:
            return model
        fine = ParameterChoice(model.W.shape[1], 1, entry.options[0].log_weight, {})
        return model.replace_options(0, [*entry.options, fine], true[:, None], true[:, None])

    return replace(linear_model(columns, y, changes={1: {"listed": False}}), refine=refine)


def test_an_effect_between_two_options_wins_with_finer_ones_and_is_looked_at_beside_a_rival():
    model = between_two_options()
    assert 1 in JointSearch(Search(model)).find().key
    found = infer_set(Search(model), DEFAULT)
    assert len(found.linear.candidates[0].options) == 3
    assert found.best.key == {0}
    assert found.best.members[0].option == 2
    # Also one with one option, as of what is not linear in the rate; the third effect explains nothing.
    model = between_two_options()
    first = model.candidates[0]
    model = replace(model, candidates=(replace(first, options=first.options[:1]), *model.candidates[1:]))
    search = Search(model)
    assert [member.candidate for member in find_near_alternatives(search, search.find_explanation(("e1",)))] == [0]


STRONG = "reference_correlated:y=0.03,time_constant_s=600"


def test_a_strong_process_is_not_taken_for_several():
    """Beside a rival process of its axis, which the columns that are usual let in."""
    model = prepared(1, STRONG).model
    linear = build_linear_model(model, [EFFECTS["reference_correlated"], EFFECTS["bias_markov"]], rivals=False)

    found = infer_set(Search(linear), DEFAULT)
    assert {found.linear.candidate(member).label for member in found.best.members} == {"reference_correlated:y"}
