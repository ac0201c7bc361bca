"""Every threshold of the diagnosis, in one place.

A threshold decides something: whether there is a gap, whether a cause is named, whether a test of the samples rejects M0. Each
has its meaning, its unit, and how it was chosen. Where the choice came from data, they are simulated recordings that were
looked at in development; the figures in the README come from other ones (`studies.withheld`). Numbers that belong to a method
rather than to a decision, such as the length of a window or the points of a grid, stand beside the method.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


def define_threshold(value: Any, meaning: str, unit: str, chosen: str) -> Any:
    """Define a field of the settings with its documentation."""
    return field(default=value, metadata={"meaning": meaning, "unit": unit, "chosen": chosen})


@dataclass(frozen=True)
class DiagnosisSettings:
    """Thresholds of a diagnosis; the metadata of each field say what it means, in which unit, and how it was chosen."""

    false_alarm_rate: float = define_threshold(
        0.002,
        "rate of false alarms of the attitude test for which its threshold stands",
        "probability",
        "a fifth of the 1 % that a diagnosis as a whole may alarm falsely, the rest being shared by the tests of the samples",
    )
    null_draws: int = define_threshold(
        1060,
        "simulated observations of M0 for the null distribution of the attitude test",
        "draws",
        "a tenth of them fits the tail beyond which a recording alarms; its p-value is then known to about a half of itself",
    )
    scanned_share: float = define_threshold(
        0.05,
        "share of the attitude test's false alarms that the scan for swings of any period may have",
        "probability",
        "by judgement; a swing needs 3 more of natural log evidence for it, and the other test loses next to nothing",
    )
    misfit_share: float = define_threshold(
        0.05,
        "share of the attitude test's false alarms that the statistics of all references, which name no cause, may have",
        "probability",
        "by judgement, as for the scan: what is no candidate's has to show for certain",
    )
    unlisted_share: float = define_threshold(
        0.3,
        "prior probability that what is at work is on no list",
        "probability",
        "62 explanations of simulated recordings are likeliest with three to eight times the odds of a fifth: "
        "what stands for the unlisted in the search is never quite what is at work; a step towards that",
    )
    another: float = define_threshold(
        0.1, "prior probability that one more effect is at work, given those that are", "probability", "by judgement"
    )
    named: float = define_threshold(
        0.9,
        "probability of a cause from which on it is named alone",
        "probability",
        "what is unlisted may have a few percent of it before any check is looked at, so that 0.95 would name nothing",
    )
    unknown: float = define_threshold(
        0.5,
        "probability of an unlisted effect from which on no cause is named",
        "probability",
        "more likely than not",
    )
    group_share: float = define_threshold(
        0.02, "share of a slot's probability below which an alternative is not offered", "probability", "by judgement"
    )
    largest_group: int = define_threshold(4, "alternatives shown in one group", "effects", "a longer list helps nobody")
    largest_set: int = define_threshold(
        9,
        "effects and random errors in one explanation of the attitude",
        "members",
        "five effects of a shape, and what is beside",
    )
    largest_sensor_set: int = define_threshold(
        5,
        "effects in one explanation of raw sensor tables",
        "effects",
        "sensors are mounted and calibrated one by one; those of TRMM were off by four effects",
    )
    chi2_sensors: float = define_threshold(
        1e-4,
        "p-value of χ² below which the noise of raw sensor tables is taken from their own residuals",
        "probability",
        "one table in ten thousand by chance",
    )
    unlisted_in_samples: float = define_threshold(
        0.05,
        "prior probability that something unlisted makes what a listed effect would show in the samples",
        "probability",
        "in the first 149 cases 36 of 37, by the rule of succession",
    )
    conformal: float = define_threshold(
        0.99,
        "how much less likely than the likeliest, as a share of it, an explanation in the 90 % conformal set may be",
        "probability",
        "the sets hold the truth in 88 % of 158 simulated recordings; in the others it has next to no probability",
    )
    sample_event: float = define_threshold(
        1e-5,
        "p-value below which a test of the samples speaks",
        "probability",
        "thirty tests a recording leave 0.03 % false alarms",
    )
    line: float = define_threshold(
        1e-6,
        "p-value below which a line of the spectrum of the samples is one, all frequencies counted",
        "probability",
        "three gyros leave 0.0003 % false lines of white noise, whose strongest line has the p-value that is stated",
    )


DEFAULT = DiagnosisSettings()
