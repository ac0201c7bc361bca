"""`gyrocal study withheld`: what a family is, and that its report tells unknown from a wrong name."""

import json

import pandas as pd
import pytest

from simulator.effects import EFFECTS
from studies.montecarlo.study import find
from studies.validation.wide import withheld
from studies.validation.wide.withheld import WithheldConfig


def rows(unknown, wrong):
    """Made-up rows of 100 cases, of which some are unknown and some have a confident wrong name; the others are missed."""
    outcome = ["unknown"] * unknown + ["wrong name"] * wrong + ["missed"] * (100 - unknown - wrong)
    other = next(iter(EFFECTS))
    posterior = {
        "unknown": [{"effects": ["unknown"], "probability": 0.9}],
        "wrong name": [{"effects": [f"{other}:x"], "probability": 1.0}],
        "missed": [{"effects": [], "probability": 1.0}],
    }
    truth = json.dumps([{"effect": other, "axis": "y"}])
    table = {
        "case": range(100),
        "kind": "unlisted",
        "family": ["a", "b"] * 50,
        "plan": "p",
        "grade": "g",
        "snr": 20.0,
        "attitude_snr": 20.0,
        "novelty": 9.0,
        "effects": "",
        "truth": truth,
        "outcome": outcome,
        "said": "",
        "probability": 0.9,
        "posterior": [json.dumps(posterior[one]) for one in outcome],
    }
    return pd.DataFrame(table)


def test_the_study_is_found_by_its_name():
    assert find("studies.validation.wide.withheld:STUDY") == withheld.STUDY


def test_families_part_the_list_and_kin_is_never_apart():
    families = withheld.families()
    assert sorted(name for family in families for name in family) == sorted(EFFECTS)
    assert len(families) > 4
    of = {name: number for number, family in enumerate(families) for name in family}
    for name, effect in EFFECTS.items():
        alike = [other for other in EFFECTS if EFFECTS[other].kin == effect.kin != ""]
        assert {of[other] for other in alike} <= {of[name]}


@pytest.mark.parametrize(
    ("unknown", "wrong", "verdicts"), [(95, 0, ["pass", "pass"]), (95, 5, ["pass", "pass"]), (80, 8, ["fail", "fail"])]
)
def test_sets_without_unknown_and_wrong_names_are_told(unknown, wrong, verdicts):
    report = withheld.report(WithheldConfig(), rows(unknown, wrong))
    assert [one.verdict for one in report.checks] == verdicts
    assert report.tables["families"].data["cases"].tolist() == [50, 50]
    assert len(report.tables["misses"].data) == 100 - unknown


def test_a_case_holds_an_effect_of_the_family_that_its_diagnosis_lacks():
    for number in (0, 3):
        drawn, family = withheld.draw(WithheldConfig(part="setting"), number)
        assert family == withheld.families()[number]
        (one,) = drawn.settings
        assert one.effect in family
        assert drawn.novelty > 3
