"""The answer of a diagnosis on the first screen of its page, in plain words.

No name of an effect is in it; each effect says itself what is so when it is at work (`simulator.effects.base.Effect.sentence`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from diagnosis.answer import Cause, Finding
from diagnosis.inference.attribution import REMAINDER
from diagnosis.result import Diagnosis
from diagnosis.settings import DEFAULT
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from studies.report import diagnosis_words as words
from studies.report import gap_budget, next_step, pointing_cost
from studies.report import next_flight as flights

MOST_FINDINGS = 2
LEAST_PROBABILITY = 0.01  # of an explanation that is stated
ORDINALS = ("First", "Second", "Third", "Fourth", "Fifth", "Sixth", "Seventh", "Eighth")


def list_answers(diagnosis: Diagnosis, orbit_s: float = math.nan, next_flight: str = "") -> dict[str, str]:
    """List the answers by their questions, in the order in which they are read.

    Parameters
    ----------
    diagnosis : the answer
    orbit_s : period of the orbit, NaN if unknown; an hour is then what pointing is told for
    next_flight : what to fly next, in a sentence, of `studies.report.next_flight`; without a plan by default
    """
    answers = {
        "Does it agree with the simulator?": _describe_gap(diagnosis),
        "Where not?": _describe_places(diagnosis),
        "Which cause?": _describe_causes(diagnosis),
        "How sure?": _describe_certainty(diagnosis),
        "How far does the gap shrink?": words.describe_closure_briefly(diagnosis),
    }
    if diagnosis.causes:
        cost = pointing_cost.describe_pointing_cost(diagnosis.details.regressors, orbit_s)
        answers["What does it cost in pointing?"] = cost
    answers["What next?"] = next_step.describe_next_step(diagnosis)
    if diagnosis.verdict != "none":
        answers["Which maneuver next?"] = next_flight or flights.describe_next_flight(diagnosis)
    return {**answers, "What can it not tell?": _describe_limits(diagnosis)}


# ---- sentences -----------------------------------------------------------------------------------------------------------


def format_headline(diagnosis: Diagnosis) -> str:
    """The answer as a sentence that anyone can read."""
    if diagnosis.verdict == "none":
        return "This recording shows nothing that the simulator would not do"
    if diagnosis.verdict == "unknown":
        beside = [format_clause(cause) for cause in diagnosis.causes]
        more = f"; beside it, {words.join_items(beside, 'and')}" if beside else ""
        if diagnosis.unknown_probability < DEFAULT.named:
            return f"There is a gap whose cause is not known; it may be on no list of known causes{more}"
        return f"Something is at work that is on no list of known causes{more}"
    if diagnosis.verdict == "not identifiable" or not diagnosis.causes:
        there = "There is a gap, and this" if diagnosis.present else "This"
        return f"{there} recording cannot show {'its cause' if diagnosis.present else 'whether there is a gap'}"
    told = [_format_alternatives(cause, diagnosis) for cause in diagnosis.causes]
    if diagnosis.verdict == "partial":
        return _start_with_capital(f"{told[0]}{_state_shares(diagnosis)}")
    return _start_with_capital(("; and " if diagnosis.verdict == "group" else ", and ").join(told))


def _state_shares(diagnosis: Diagnosis) -> str:
    """State how many causes there are, what they close of the gap, and what is left."""
    left = 100 * next((step.closed or 0.0 for step in diagnosis.budget if step.step == "remainder"), 1.0)
    count = len(diagnosis.causes)
    causes = f", the first of {count} causes; together they close" if count > 1 else "; this closes"
    return f"{causes} {max(100 - left, 0.0):.0f} % of the gap, {left:.0f} % is not explained"


def format_clause(cause: Cause) -> str:
    """Format the clause that states a cause with its size."""
    if cause.effect not in EFFECTS:
        return f"something acts that is on no list ({cause.effect})"
    return EFFECTS[cause.effect].sentence(cause.axis, cause.size, format_magnitude(cause))


def _format_alternatives(cause: Cause, diagnosis: Diagnosis, more: str = "") -> str:
    """A cause and more of it, or that it or another is at work where these cannot be told apart; with doubt, where there is."""
    others = [_format_unsized(member) for member in cause.group if member != cause.label]
    told = f"{format_clause(cause)}{more}"
    if diagnosis.verdict not in ("group", "partial"):
        return told
    doubt = "" if (cause.group_probability if others else cause.probability) >= DEFAULT.named else "most likely "
    return f"{doubt}either {told}, or {words.join_items(others, 'or')}" if others else f"{doubt}{told}"


def _format_unsized(label: str) -> str:
    """Format the clause that states an effect without a size."""
    name, _, axis = label.partition(":")
    if name not in EFFECTS:
        return "something acts that is on no list"
    # A size that nobody knows here: the clause is told by an amount.
    return EFFECTS[name].sentence(axis or None, 1.0, "some amount")


def format_magnitude(cause: Cause) -> str:
    """The size without its sign to two digits, three where its sigma is below a percent, and its unit."""
    value = abs(cause.size)
    unit = "" if cause.unit == "factor" else f" {cause.unit.split(',')[0]}"
    if not math.isfinite(value) or value == 0:
        return f"an unknown number of {cause.unit}"
    digits = 3 if 0 < cause.sigma < 0.01 * value else 2
    decimals = digits - 1 - math.floor(math.log10(value))
    return f"{round(value, decimals):.{max(decimals, 0)}f}{unit}"


def _describe_gap(diagnosis: Diagnosis) -> str:
    answer = "No, there is a gap" if diagnosis.present else "Yes, no gap is seen"
    if diagnosis.verdict == "not identifiable" and not diagnosis.present:
        answer = "This recording cannot show it"
    return (
        f"{answer}: noise as stated would depart so far with {words.format_p_value(diagnosis.p_value)}; of recordings without "
        f"a gap {100 * diagnosis.false_alarm_rate:g} % would be said to have one."
    )


def _describe_causes(diagnosis: Diagnosis) -> str:
    """The causes with their sizes; of an unknown one what it behaves like."""
    told = [
        _start_with_capital(
            _format_alternatives(
                cause, diagnosis, f" ({'; '.join([words.format_cause_size(cause), *words.describe_onset(cause, diagnosis)])})"
            )
        )
        for cause in diagnosis.causes
    ]
    if diagnosis.verdict == "none":
        return "None is called for."
    if diagnosis.verdict == "unknown":
        like = [
            f"{_describe_behaviour(one)} ({words.format_percent(share)})"
            for one, share in diagnosis.alternatives
            if _is_telling(one, share)
        ]
        surely = diagnosis.unknown_probability >= DEFAULT.named
        none = f"None of the {len(EFFECTS)} that are known" if surely else "None that could be named"
        told.insert(0, f"{none}. It behaves most like this: {words.join_items(like[:MOST_FINDINGS], 'or')}" if like else none)
        if diagnosis.remainder is not None:
            told.append(gap_budget.describe_side(diagnosis.remainder).rstrip("."))
    elif not told:
        return "It cannot be told."
    return " ".join(f"{one}." for one in told)


def _is_telling(effects: Sequence[str], share: float) -> bool:
    """Tell whether an explanation says how the gap behaves: no unlikely one, nor a remainder."""
    return share >= LEAST_PROBABILITY and REMAINDER not in effects


def _describe_behaviour(effects: Sequence[str]) -> str:
    """An explanation in plain words, without sizes."""
    known = [_format_unsized(one) if one.partition(":")[0] in EFFECTS else one.replace(":", ", axis ") for one in effects]
    return " together with ".join(known)


def _start_with_capital(text: str) -> str:
    return text[0].upper() + text[1:]


def _describe_certainty(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "none":
        return "A gap smaller than the noise would not be seen."
    unknown = words.format_percent(diagnosis.unknown_probability)
    if diagnosis.verdict == "not identifiable":
        return f"This recording cannot tell: a probability of {unknown} for something that is on no list."
    if diagnosis.verdict == "unknown":
        return f"With a probability of {unknown} something is at work that is on no list."
    parts = []
    for number, cause in enumerate(diagnosis.causes):
        which = f"{ORDINALS[number]}: p" if len(diagnosis.causes) > 1 else "P"
        text = f"{which}robability {words.format_percent(cause.probability)}"
        if len(cause.group) > 1:
            text += f", {words.format_percent(cause.group_probability)} that it is this or what cannot be told from it"
        parts.append(f"{text}.")
    return " ".join(dict.fromkeys(parts))


def _describe_places(diagnosis: Diagnosis) -> str:
    places = list(dict.fromkeys(_describe_place(one) for one in diagnosis.where[:MOST_FINDINGS]))
    return f"Most of all {words.join_items(places, 'and')}." if places else "Nowhere."


def _describe_place(one: Finding) -> str:
    axis = f" about {one.axis}" if one.axis else ""
    interval = f" in {one.interval}" if one.interval else ""
    window = f", {one.window_s[0]:.0f} to {one.window_s[1]:.0f} s after its start" if one.window_s and one.interval else ""
    what = "gyro's own samples" if one.signal == "gyro stream" else one.signal
    return f"in the {what}{axis}{interval}{window}"


def _describe_limits(diagnosis: Diagnosis) -> str:
    others = [_format_unsized(member) for cause in diagnosis.causes for member in cause.group if member != cause.label]
    if others:
        return f"Whether it is not rather that {words.join_items(list(dict.fromkeys(others)), 'or')}."
    return "Constant errors of scale, alignment and bias, which the calibration takes up, and what is below the noise."
