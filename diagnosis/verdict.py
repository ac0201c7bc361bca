"""The verdict of an answer, from probabilities alone.

| verdict | meaning |
|---|---|
| none | no misfit |
| not identifiable | no misfit, of a recording that could not show one |
| named, group | causes identified, each alone or with alternatives that the recording cannot distinguish from it |
| partial | causes identified beside a remainder, or beside an unlisted effect that the samples show |
| unknown | a misfit that no identified cause explains |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from diagnosis.answer import Cause, Verdict
from diagnosis.posterior import Attribution, CredibleGroup
from diagnosis.settings import DEFAULT, DiagnosisSettings


def decide_attitude_verdict(
    attribution: Attribution, slots: tuple[CredibleGroup, ...], remainder: bool, settings: DiagnosisSettings = DEFAULT
) -> Attribution:
    """Decide the verdict on the attitude's causes, with a remainder or without one; returns the attribution with both."""
    if not slots:
        return replace(attribution, verdict="unknown", slots=())
    if remainder:
        return replace(attribution, verdict="partial", slots=slots)
    named = all(slot.named and slot.probability >= settings.named for slot in slots)
    return replace(attribution, verdict="named" if named else "group", slots=slots)


def decide_verdict(
    present: bool,
    causes: Sequence[Cause],
    unlisted: float,
    settings: DiagnosisSettings,
    *,
    has_remainder: bool = False,
    blind: bool = False,
) -> Verdict:
    """Decide the verdict on the whole recording.

    Parameters
    ----------
    present : whether there is a misfit
    causes : those that are stated
    unlisted : probability that something unlisted is at work
    settings : thresholds
    has_remainder : whether the causes were identified in the presence of a remainder
    blind : whether the recording could not show a misfit
    """
    if not present:
        return "not identifiable" if blind else "none"
    if has_remainder:
        return "partial"
    if not causes:
        return "unknown"
    if unlisted > settings.unknown:
        return "partial"
    return "named" if all(cause.named and cause.probability >= settings.named for cause in causes) else "group"
