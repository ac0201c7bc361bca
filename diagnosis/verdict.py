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

from diagnosis.answer import Cause, Verdict
from diagnosis.settings import DiagnosisSettings


def decide_verdict(
    present: bool,
    causes: Sequence[Cause],
    unlisted: float,
    settings: DiagnosisSettings,
    *,
    beside_remainder: bool = False,
    blind: bool = False,
) -> Verdict:
    """Decide the verdict.

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
