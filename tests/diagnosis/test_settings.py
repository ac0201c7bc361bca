"""Thresholds: each says what it means, its unit and how it was chosen, and a wrong one is seen."""

from dataclasses import fields, replace

import pytest

from diagnosis.settings import DEFAULT, DiagnosisSettings

UNITS = {"probability", "draws", "effects"}


@pytest.mark.parametrize("one", fields(DiagnosisSettings), ids=lambda one: one.name)
def test_every_threshold_is_documented(one):
    assert set(one.metadata) == {"meaning", "unit", "chosen"}
    assert all(
        isinstance(words, str) and len(words.split()) >= 2 for words in (one.metadata["meaning"], one.metadata["chosen"])
    )
    assert one.metadata["unit"] in UNITS
    value = getattr(DEFAULT, one.name)
    assert (0 < value < 1) if one.metadata["unit"] == "probability" else (isinstance(value, int) and value >= 1)


def test_a_description_has_the_values_in_force():
    changed = {row["name"]: row for row in replace(DEFAULT, named=0.9).describe()}
    assert changed["named"] == {"name": "named", "value": 0.9} | dict(
        next(one for one in fields(DiagnosisSettings) if one.name == "named").metadata
    )
    assert list(changed) == [one.name for one in fields(DiagnosisSettings)]


def test_thresholds_are_those_of_the_validation():
    """Every validated figure is of these thresholds; who moves one makes the figures anew, and moves it here."""
    values = (DEFAULT.false_alarm_rate, DEFAULT.named, DEFAULT.unknown, DEFAULT.conformal)
    assert values == (0.002, 0.9, 0.5, 0.762)
