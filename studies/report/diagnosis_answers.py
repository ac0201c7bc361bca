"""The answer of a diagnosis on the first screen of its page, in plain words.

No name of an effect is in it; each effect says itself what is so when it is at work (`simulator.effects.base.Effect.sentence`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from diagnosis.answer import Cause, Finding
from diagnosis.inference.attribution import REMAINDER
from diagnosis.plan import Extra, Plan, plan
from diagnosis.plan.result import Progress
from diagnosis.result import Diagnosis
from diagnosis.settings import DEFAULT
from simulator.effects import EFFECTS as PLANNED_EFFECTS
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from simulator.scenario import Scenario
from studies.report import diagnosis_words as words
from studies.report import gap_budget, pointing_cost

MOST_FINDINGS = 2
LEAST_PROBABILITY = 0.01  # of an explanation that is stated; none with a remainder says how the gap behaves
ORDINALS = ("First", "Second", "Third", "Fourth", "Fifth", "Sixth", "Seventh", "Eighth")


def list_answers(diagnosis: Diagnosis, orbit_s: float = math.nan, next_flight: str = "") -> dict[str, str]:
    """List the answers by their questions, in the order in which they are read.

    Parameters
    ----------
    diagnosis : the answer
    orbit_s : period of the orbit, NaN if unknown; an hour is then what pointing is told for
    next_flight : what to fly next, in a sentence of `describe_next_flight`; without a plan by default
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
    answers["What next?"] = describe_next_step(diagnosis)
    if diagnosis.verdict != "none":
        answers["Which maneuver next?"] = next_flight or describe_next_flight(diagnosis)
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
            if share >= LEAST_PROBABILITY and REMAINDER not in one
        ]
        surely = diagnosis.unknown_probability >= DEFAULT.named
        count = sum(effect.is_nameable for effect in EFFECTS.values())
        none = f"None of the {count} that are known" if surely else "None that could be named"
        told.insert(0, f"{none}. It behaves most like this: {words.join_items(like[:MOST_FINDINGS], 'or')}" if like else none)
        if diagnosis.remainder is not None:
            told.append(gap_budget.describe_side(diagnosis.remainder).rstrip("."))
    elif not told:
        return "It cannot be told."
    return " ".join(f"{one}." for one in told)


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
    where = diagnosis.where[:MOST_FINDINGS] if diagnosis.present else ()
    places = list(dict.fromkeys(map(_describe_place, where)))
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


# ---- what to do and to fly next ---------------------------------------------------------------------------------------------

HELPS = 0.9  # ratio of the smallest visible size with the maneuver over that without, below which it is worth naming


def list_suspected_effects(diagnosis: Diagnosis) -> list[str]:
    """Labels of what may be at work: the causes with what cannot be told from them, or else the next best explanations."""
    labels = [member for cause in diagnosis.causes for member in (cause.label, *cause.group)]
    labels = labels or [label for effects, _ in diagnosis.alternatives for label in effects]
    return [label for label in dict.fromkeys(labels) if label.partition(":")[0] in PLANNED_EFFECTS]


def plan_next_flight(diagnosis: Diagnosis, scenario: Scenario, progress: Progress | None = None, seed: int = 0) -> Plan | None:
    """The plan of a scenario for what may be at work; None if that is nothing that a plan knows."""
    names = list(dict.fromkeys(label.partition(":")[0] for label in list_suspected_effects(diagnosis)))
    return plan(scenario, effects=names, progress=progress, seed=seed) if names else None


def describe_next_flight(diagnosis: Diagnosis, found: Plan | None = None) -> str:
    """Describe the recommended next flight, or where it can be asked for.

    Parameters
    ----------
    diagnosis : the answer
    found : of `plan_next_flight`, if a scenario was given
    """
    if diagnosis.verdict == "none":
        return "No further recording is needed."
    if found is None or not found.extras:
        return "gyrocal diagnose --plan SCENARIO, with the scenario of this recording, states which extra maneuver helps most."
    labels = list_suspected_effects(diagnosis)
    pairs = {frozenset((a, b)) for a in labels for b in labels if a != b}
    apart = [(len(pairs & {frozenset(pair) for pair in one.resolved}), one) for one in found.extras]
    most, best = max(apart, key=lambda one: (one[0], -one[1].ratio))
    if most:
        return f"{best.name} ({best.hours:.1f} h): it separates causes that this recording cannot separate."
    ratio, helpful = min(((_find_best_ratio(one, labels), one) for one in found.extras), key=lambda one: one[0])
    if ratio > HELPS:
        return "No extra maneuver on the list makes the cause much better visible."
    visible = f"the smallest visible size of the cause is then {ratio:.2g} times that of this recording"
    return f"{helpful.name} ({helpful.hours:.1f} h): {visible}."


def _find_best_ratio(extra: Extra, labels: list[str]) -> float:
    """The best ratio of what may be at work; a label of the plan may say more, as in effect:z<y."""
    own = [ratio for name, ratio in extra.by_effect.items() if name.partition("<")[0] in labels]
    return min(own, default=1.0)


_IN_MODEL = "Take scale, alignment and bias from the calibration with the cause in it, which the answer holds"
_TAGS = "Mend the gyro's time tags or undo its filter, by the size found, and calibrate again"
_SAMPLES = "Have the gyro's samples mended where they are made, in the unit's settings or its telemetry, and calibrate again"
_REFERENCES = (
    "Leave the gyro; mend the reference attitudes or take the calibration that allows for their error, which the answer holds"
)
REMEDIES = {
    "rate": _IN_MODEL,
    "random_rate": f"{_IN_MODEL}, and repeat it as often as the bias wanders by more than you can bear",
    "filter": _TAGS,
    "clock": _TAGS,
    "threshold": _SAMPLES,
    "white_noise": "State the gyro's noise as found, and calibrate again: the sigmas change",
    "pickup": _IN_MODEL,
    "outliers": _SAMPLES,
    "range": _SAMPLES,
    "resolution": _SAMPLES,
    "telemetry": _SAMPLES,
    "reference": _REFERENCES,
    "random_reference": _REFERENCES,
    "reference_noise": "State the references' noise as found, and calibrate again: the sigmas change",
    "reference_telemetry": "Leave out the references found false; the answer already does",
    "sensor": "Put the values found into the sensor's model, determine the references again, and calibrate with those",
}


def describe_next_step(diagnosis: Diagnosis) -> str:
    """Describe the next step, without the maneuvers to fly."""
    if diagnosis.verdict == "none":
        return "Use the calibration as it is."
    if diagnosis.verdict == "unknown":
        place = next((one.interval for one in diagnosis.where if one.interval), None)
        first = f"Look at {place} first: what" if place else "Look at what"
        return (
            f"{first} was different there (mode, temperature, sensors in use)? Until it is explained the calibration's errors "
            "are larger than its sigmas."
        )
    if not diagnosis.causes:
        return "Do not decide by this recording: make another one."
    stages = [EFFECTS[one.effect].stage if one.effect in EFFECTS else "rate" for one in diagnosis.causes]
    remedies = list(dict.fromkeys(REMEDIES[stage] for stage in stages))
    left = diagnosis.remainder
    if left is not None and left.share > 0.5:
        remedies.insert(0, f"Look at {gap_budget.SIDE_NAMES[left.side]} first, from which most of the gap comes")
    return " ".join(f"{one}." for one in remedies)
