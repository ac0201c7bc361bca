"""The verdict of an answer, from probabilities alone.

| verdict | meaning |
|---|---|
| none | no misfit |
| not identifiable | no misfit, of a recording that could not show one |
| named, group | causes identified, each alone or with what the recording cannot tell from it |
| partial | causes identified beside a remainder, or beside something unlisted that the samples show |
| unknown | a misfit that no identified cause explains |
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from diagnosis.answer import Cause, Verdict
from diagnosis.posterior import Attribution, CredibleGroup
from diagnosis.settings import DEFAULT, DiagnosisSettings


def attribute(
    found: Attribution, slots: tuple[CredibleGroup, ...], remainder: bool, settings: DiagnosisSettings = DEFAULT
) -> Attribution:
    """Decide the verdict on the attitude's causes, beside a remainder or without one, and keep those in an attribution."""
    if not slots:
        return replace(found, verdict="unknown", slots=())
    if remainder:
        return replace(found, verdict="partial", slots=slots)
    named = all(slot.named and slot.probability >= settings.named for slot in slots)
    return replace(found, verdict="named" if named else "group", slots=slots)


def decide_verdict(
    present: bool,
    causes: Sequence[Cause],
    unlisted: float,
    settings: DiagnosisSettings,
    *,
    beside_remainder: bool = False,
    blind: bool = False,
) -> Verdict:
    """Decide the verdict on the whole recording.

    Parameters
    ----------
    present : whether there is a misfit
    causes : those that are stated
    unlisted : probability that something unlisted is at work
    settings : thresholds
    beside_remainder : whether the causes were identified in the presence of a remainder
    blind : whether the recording could not show a misfit
    """
    if not present:
        return "not identifiable" if blind else "none"
    if beside_remainder:
        return "partial"
    if not causes:
        return "unknown"
    if unlisted > settings.unknown:
        return "partial"
    return "named" if all(one.named and one.probability >= settings.named for one in causes) else "group"
