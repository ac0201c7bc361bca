"""Thresholds of the validation."""

from diagnosis.settings import DEFAULT


def test_thresholds_are_those_of_the_validation():
    """Every validated figure is of these thresholds; who moves one makes the figures anew, and moves it here."""
    values = (DEFAULT.false_alarm_rate, DEFAULT.named, DEFAULT.unknown, DEFAULT.conformal)
    assert values == (0.002, 0.9, 0.5, 0.762)
