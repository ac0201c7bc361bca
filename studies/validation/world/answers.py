"""What an answer is worth against the truth of its recording.

An answer is **right** if each effect that is there is named on its axis and no other is; **in the group** if what is there is
among what the diagnosis says could stand in the place of a cause. An effect on all axes without one given counts as named when
every axis of it is. What becomes of a case:

- ``right``: no effect, and no misfit is seen; or as above
- ``group``: in the group; of an effect outside the library, an answer by a group of alternatives
- ``part``: of several effects or of a mixed recording, all that is named is there, or has what is there in its group, and
  something is missing; what is outside the library has no right name
- ``unknown``: a misfit is seen and no cause is named, or the verdict is *unknown*
- ``missed``: there is an effect, and no misfit is seen
- ``alarm``: there is none, and a misfit is seen
- ``wrong name``: a cause is named at 0.9 or more that is not there, nor has what is there in its group
- ``other``: the rest
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simulator.effects import EFFECTS

CONFIDENT = 0.9
OUTCOMES = ("right", "group", "part", "unknown", "missed", "wrong name", "alarm", "other")
NAMING = ("named", "group", "partial")  # verdicts that state causes
GOOD = {  # outcomes that count as such
    "none": ("right",),
    "single": ("right", "group"),
    "pair": ("right", "group"),
    "unlisted": ("unknown",),
    "mixed": ("right", "group", "part"),
}
Cause = dict[str, Any]


def label_effect(effect: str, axis: str | None) -> str:
    """Join effect and axis, as in a group."""
    return effect if axis is None else f"{effect}:{axis}"


def merge_axes(causes: Sequence[Cause]) -> list[Cause]:
    """Merge causes of one effect about all three axes into one without an axis, if the effect may act on all at once."""
    out: list[Cause] = []
    for cause in causes:
        effect = EFFECTS.get(cause["effect"])
        same = [other for other in causes if other["effect"] == cause["effect"]]
        if effect is None or not effect.axis_optional or {other["axis"] for other in same} != {"x", "y", "z"}:
            out.append(cause)
        elif cause is same[0]:
            means = {key: float(np.mean([other[key] for other in same])) for key in ("size", "sigma", "probability")}
            group = [cause["effect"], *(item for other in same for item in other["group"])]
            out.append({**cause, **means, "axis": None, "group": group})
    return out


def score_answer(kind: str, truth: Sequence[dict[str, Any]], found: dict[str, Any]) -> dict[str, Any]:
    """Score an answer.

    Parameters
    ----------
    kind : none, single, pair, unlisted or mixed
    truth : effects as of `studies.validation.world.cases.DrawnCase.truth`
    found : the answer as JSON

    Returns
    -------
    The part of a case's row that follows from both, see `studies.validation.world.study`.
    """
    causes = merge_axes(found["causes"])
    listed = [label_effect(one["effect"], one["axis"]) for one in truth if one["listed"]]
    said = [label_effect(cause["effect"], cause["axis"]) for cause in causes]
    named = [{name, *cause["group"]} for name, cause in zip(said, causes, strict=True)]
    wrong = [cause for cause, names in zip(causes, named, strict=True) if not names & set(listed)]
    whole = len(listed) == len(truth) > 0
    exact = whole and sorted(said) == sorted(listed)
    in_group = whole and len(said) == len(listed) and not wrong and all(any(one in names for names in named) for one in listed)
    closure = found.get("closure") or {}
    low, high = closure.get("interval_90") or (np.nan, np.nan)
    return {
        "verdict": found["verdict"],
        "said": " + ".join(said) if said and found["verdict"] in NAMING else found["verdict"],
        "stated": len(causes),
        "stated_right": len(causes) - len(wrong),
        "probability": float(np.prod([cause["probability"] for cause in causes])) if causes else np.nan,
        "unknown_probability": found["unknown_probability"],
        "p_value": found["gap"]["p_value"],
        "outcome": _determine_outcome(kind, causes, wrong, exact, in_group, found),
        "closed": closure.get("closed", np.nan),
        "closed_low": low,
        "closed_high": high,
    }


def _determine_outcome(
    kind: str, causes: Sequence[Cause], wrong: Sequence[Cause], exact: bool, in_group: bool, found: dict[str, Any]
) -> str:
    """Say what becomes of a case, see the module."""
    present = bool(found["gap"]["present"]) or found["verdict"] in (*NAMING, "unknown")
    if kind == "none":
        return "alarm" if present else "right"
    if not present:
        return "missed"
    if found["verdict"] == "unknown" or not causes:
        return "unknown"
    if exact:
        return "right"
    if in_group or (kind == "unlisted" and found["verdict"] == "group"):
        return "group"
    if any(cause["probability"] >= CONFIDENT for cause in wrong) and found["verdict"] != "group":
        return "wrong name"
    return "part" if not wrong and kind in ("pair", "mixed") else "other"


def compute_size_errors(causes: Sequence[Cause], truth: Sequence[dict[str, Any]]) -> list[float]:
    """Compute (size − true size)/sigma of each cause that is there, on its axis and toward the same other one."""
    out = []
    for cause in causes:
        for one in truth:
            same = (cause["effect"], cause["axis"]) == (one["effect"], one["axis"])
            toward = one["parameters"].get("toward")
            if same and cause["parameters"].get("toward", toward) == toward and cause["sigma"]:
                out.append((cause["size"] - one["size"]) / cause["sigma"])
    return out


def compute_calibration_errors(found: dict[str, Any], G: Sequence[Sequence[float]], bias_deg_s: Sequence[float]) -> list[float]:
    """Compute (parameter − true parameter)/sigma of G row by row and b, (12,), with the named causes in the model."""
    stated = found["calibration"]
    value = np.concatenate([np.ravel(stated["G"]), np.ravel(stated["bias_deg_s"])])
    sigma = np.concatenate([np.ravel(stated["sigma_G"]), np.ravel(stated["sigma_bias_deg_s"])])
    return [float(one) for one in (value - np.concatenate([np.ravel(G), np.ravel(bias_deg_s)])) / sigma]
