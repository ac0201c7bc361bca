"""A diagnosis as one page for the terminal and the browser: the answers in plain words, then the sections behind them.

No name of an effect is in the answers: `simulator.effects.base.Effect.sentence` has the clause of each.
"""

import math

from diagnosis.answer import MOST, UNDECIDED, Cause, RemainderSummary
from diagnosis.result import Diagnosis
from diagnosis.settings import DEFAULT
from gyrocal import NAMES
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from studies.report import tables
from studies.report.diagnosis_sections import (
    SIDE_NAMES,
    build_budget_items,
    build_budget_picture,
    build_calibration_items,
    build_cause_items,
    build_place_items,
    build_residual_picture,
    build_sensor_items,
    is_undecided,
)
from studies.report.pages import Answer, Page, ProvenanceFooter, Section
from studies.report.tables import format_p_value, format_percent, join_items

MOST_TOGETHER = 2  # effects in an explanation that a sentence names
MOST_BEHAVIOURS = 2  # of an unknown cause
LEAST_PROBABILITY = 0.01  # of an explanation that is stated in the answer
WIDEST_SHARE = 2.0  # width of the 90 % interval of a closed share above which the share is not stated
VERDICT_STYLES = {"none": "", "not identifiable": "open"}  # of the answer; that of a misfit for all other verdicts
MOST_IN_HEADLINE = 2  # causes
UNLISTED = "an effect outside the library acts"
NOTES = (
    "The calibration removes constant errors of G and b; they are no misfit. An effect below the noise is not seen.",
    "The baseline has constant G and b, and white noise of gyro and references as stated. A positive size makes the gyro read "
    "high. Probabilities hold if one of the compared explanations is true.",
)


def build_diagnosis_page(diagnosis: Diagnosis, provenance: ProvenanceFooter | None = None) -> Page:
    """Build the page of a diagnosis."""
    picture = build_budget_picture(diagnosis) if diagnosis.budget else build_residual_picture(diagnosis)
    answers = list_answers(diagnosis)
    size = diagnosis.misfit_size
    misfit = "gap" if size is None or size.material else "open"
    answer = Answer(VERDICT_STYLES.get(diagnosis.verdict, misfit), picture, describe_closure(diagnosis), answers)
    sections = [
        Section("Causes", build_cause_items(diagnosis)),
        Section("Gap budget on held-out data", build_budget_items(diagnosis)),
        Section("Calibration", build_calibration_items(diagnosis)),
        Section("What this recording cannot show", [[effect.describe() for effect in diagnosis.invisible]]),
        Section("Left out, since it was not measured", [[*diagnosis.masked]]),
        Section("Where the residuals do not fit", build_place_items(diagnosis)),
        Section("Sun and Earth sensors", build_sensor_items(diagnosis.sensors)),
        Section("Limits of this recording", [[*diagnosis.notes, *NOTES]]),
    ]
    title = f"Diagnosis of {diagnosis.recording}"
    return Page(format_headline(diagnosis), [section for section in sections if any(section.items)], answer, provenance, title)


# ---- answers -------------------------------------------------------------------------------------------------------------


def list_answers(diagnosis: Diagnosis) -> dict[str, str]:
    """List the answers by their questions, in the order in which they are read."""
    answers = {"Does the baseline fit?": _describe_fit(diagnosis)}
    if diagnosis.present:
        answers["Does it matter?"] = describe_misfit_size(diagnosis)
    answers["Which cause?"] = _describe_causes(diagnosis)
    answers["What next?"] = describe_next_step(diagnosis)
    if diagnosis.verdict != "none":
        answers["Which maneuver next?"] = (
            "gyrocal plan SCENARIO --effect CAUSE, with the scenario of this recording, states which extra maneuver helps most."
        )
    return answers


def format_headline(diagnosis: Diagnosis) -> str:
    """Answer in one sentence without a full stop."""
    size = diagnosis.misfit_size
    headline = _format_answer(diagnosis)
    if size is None or not diagnosis.present:
        return headline
    added, stated = tables.format_short(size.added_deg), tables.format_short(size.stated_deg)
    return f"{'' if size.material else 'Significant but small: '}{headline} ({added} deg beside {stated} deg as stated)"


def describe_misfit_size(diagnosis: Diagnosis) -> str:
    """State the error that the misfit adds to a held-out attitude beside the stated noise."""
    size = diagnosis.misfit_size
    if size is None:
        return "The attitudes fit the stated noise; the misfit is in the gyro samples or the sensor tables alone."
    added, stated = tables.format_short(size.added_deg), tables.format_short(size.stated_deg)
    span = tables.format_duration(size.over_s)
    return f"{'Yes' if size.material else 'Hardly'}. It adds {added} deg to an attitude over {span}; stated: {stated} deg."


def _format_answer(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "none":
        if len(diagnosis.unobserved) == len(NAMES):
            return "No misfit, but these motions determine neither G nor b"
        return "No misfit: the baseline explains this recording"
    if diagnosis.verdict == "unknown":
        clauses = [_format_clause(cause) for cause in diagnosis.causes]
        further = f"; beside it, {join_items(clauses, 'and')}" if clauses else ""
        likeness = "" if diagnosis.remainder is None else _describe_likeness(diagnosis.remainder)
        if diagnosis.unknown_probability < DEFAULT.named:
            return f"The cause of the misfit is unknown; it may be an effect outside the library{likeness}{further}"
        return f"An effect outside the library causes the misfit{likeness}{further}"
    if diagnosis.verdict == "not identifiable" or not diagnosis.causes:
        return f"This recording cannot show {'the cause of its misfit' if diagnosis.present else 'whether there is a misfit'}"
    clauses = [_format_with_alternatives(cause, diagnosis) for cause in diagnosis.causes]
    measured = {step.step for step in diagnosis.budget}
    if diagnosis.verdict == "partial" and measured.isdisjoint(cause.label for cause in diagnosis.causes):
        return _start_with_capital(
            f"{join_items(clauses, 'and')}, in the samples alone; the misfit of the attitude is not explained"
        )
    if diagnosis.verdict == "partial" or (len(clauses) > MOST_IN_HEADLINE and diagnosis.budget):
        return _start_with_capital(f"{clauses[0]}{_state_shares(diagnosis)}")
    return _start_with_capital(("; and " if diagnosis.verdict == "group" else ", and ").join(clauses))


def _describe_likeness(remainder: RemainderSummary) -> str:
    """Describe in a clause how a misfit without a cause acts, if it is random errors of one kind alone; else empty."""
    sizes = {
        "the gyro's rate were off by up to {:.2g} deg/h": max(remainder.gyro_deg_h),
        "the reference attitudes were off by up to {:.2g} deg": max(remainder.reference_deg),
        "the time tags were off by {:.2g} s": remainder.time_tags_s,
    }
    clauses = [text.format(size) for text, size in sizes.items() if size > 0]
    is_doubtful = remainder.side == UNDECIDED and max(remainder.gyro_deg_h) > 0  # the references may drift as much
    return f", as if {clauses[0]} (1 sigma)" if len(clauses) == 1 and not is_doubtful else ""


def _state_shares(diagnosis: Diagnosis) -> str:
    """State the number of causes, the share of the misfit that they remove, and the rest."""
    unexplained = 100 * next((step.closed or 0.0 for step in diagnosis.budget if step.step == "remainder"), 1.0)
    count = len(diagnosis.causes)
    causes = f", the first of {count} causes; together they remove" if count > 1 else "; this removes"
    return f"{causes} {max(100 - unexplained, 0.0):.0f} % of the misfit, {unexplained:.0f} % is not explained"


def _format_clause(cause: Cause) -> str:
    """Format a cause with its size as a clause."""
    if cause.effect not in EFFECTS:
        return f"{UNLISTED} ({cause.effect})"
    if not cause.named:
        subject = "the gyro's rate or the reference attitudes have" if is_undecided(cause) else "the gyro's rate has"
        subject = "the reference attitudes have" if cause.effect.startswith("reference") else subject
        return f"{subject} an error{f' about {cause.axis}' if cause.axis else ''} that changes slowly, as random errors do"
    return EFFECTS[cause.effect].sentence(cause.axis, cause.size, format_magnitude(cause))


def _format_with_alternatives(cause: Cause, diagnosis: Diagnosis, addition: str = "") -> str:
    """Format a cause with its alternatives as a clause, hedged where it is not certain."""
    others = [_format_unsized(member, cause) for member in cause.group if member != cause.label] if cause.named else []
    clause = f"{_format_clause(cause)}{addition}"
    if diagnosis.verdict not in ("group", "partial"):
        return clause
    doubt = "" if (cause.group_probability if others else cause.probability) >= DEFAULT.named else "most likely "
    return f"{doubt}either {clause}, or {join_items(others, 'or')}" if others else f"{doubt}{clause}"


def _format_unsized(label: str, cause: Cause | None = None) -> str:
    """Format an effect as a clause without a size, or with about the size of the cause that it is an alternative to."""
    name, _, axis = label.partition(":")
    if name not in EFFECTS:
        return UNLISTED
    if cause is not None and cause.unit == EFFECTS[name].unit:
        return EFFECTS[name].sentence(axis or None, cause.size, "about as much")
    return EFFECTS[name].sentence(axis or None, 1.0, "some amount")


def _start_with_capital(text: str) -> str:
    return text[0].upper() + text[1:]


def format_magnitude(cause: Cause) -> str:
    """Format the size without its sign, to two digits or three where its sigma is below a percent, and its unit."""
    value = abs(cause.size)
    unit = "" if cause.unit == "factor" else f" {cause.unit.split(',')[0]}"
    if not math.isfinite(value) or value == 0:
        return f"an unknown number of {cause.unit}"
    digits = 3 if 0 < cause.sigma < 0.01 * value else 2
    decimals = digits - 1 - math.floor(math.log10(value))
    return f"{round(value, decimals):.{max(decimals, 0)}f}{unit}"


def _describe_fit(diagnosis: Diagnosis) -> str:
    fit = "No. The residuals do not fit the stated noise" if diagnosis.present else "Yes. The residuals fit the stated noise"
    if diagnosis.verdict == "not identifiable" and not diagnosis.present:
        fit = "This recording cannot show it"
    test = f"{format_p_value(diagnosis.p_value)}; false-alarm rate {100 * diagnosis.false_alarm_rate:g} %"
    return f"{fit} ({test}). Verdict: {diagnosis.verdict}."


def _describe_causes(diagnosis: Diagnosis) -> str:
    """Describe the causes with their probabilities, and the behaviour of an unknown one."""
    clauses = [
        _start_with_capital(_format_with_alternatives(cause, diagnosis, f" (probability {format_percent(cause.probability)})"))
        for cause in diagnosis.causes
    ]
    if diagnosis.verdict == "none":
        return "None."
    if diagnosis.verdict == "unknown":
        behaviours = [
            f"{' together with '.join(map(_format_behaviour, effects))} ({format_percent(share)})"
            for effects, share in diagnosis.alternatives
            if share >= LEAST_PROBABILITY and len(effects) <= MOST_TOGETHER
        ]
        behaviour = f". It behaves most like this: {join_items(behaviours[:MOST_BEHAVIOURS], 'or')}" if behaviours else ""
        clauses.insert(0, f"With a probability of {format_percent(diagnosis.unknown_probability)} {UNLISTED}{behaviour}")
    return " ".join(f"{clause}." for clause in clauses) or "This recording cannot show it."


def _format_behaviour(label: str) -> str:
    return _format_unsized(label) if label.partition(":")[0] in EFFECTS else label.replace(":", ", axis ")


_IN_MODEL = 'Use the calibration with the causes (table "Calibration", column "with causes")'
_TAGS = "Undo the delay of the time tags or of the filter by the size found (gyrocal import --align auto), and calibrate again"
_SAMPLES = "Correct the samples where they are made, in the unit's settings or its telemetry, and calibrate again"
_REFERENCES = f"Leave the gyro and correct the reference attitudes. {_IN_MODEL}"
REMEDIES = {
    "rate": _IN_MODEL,
    "random_rate": f"{_IN_MODEL}. Repeat the calibration before the bias has changed by more than is acceptable",
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
    "reference_telemetry": "Leave out the false references; this result already does",
    "sensor": "Put the values found into the sensor's model, determine the references again, and calibrate with those",
}


def describe_next_step(diagnosis: Diagnosis) -> str:
    """Recommend the next step, without the maneuvers to fly."""
    if diagnosis.verdict == "none":
        if len(diagnosis.unobserved) == len(NAMES):
            return "Keep the calibration that the gyro had: these motions add nothing to it."
        if not diagnosis.unobserved:
            return "Use the calibration as it is."
        return f"Use the calibration but for {join_items(diagnosis.unobserved, 'and')}, which these motions do not show."
    if diagnosis.verdict == "unknown":
        place = next((finding.interval for finding in diagnosis.where if finding.interval), None)
        first = f"Compare {place} with the other intervals" if place else "Compare the intervals"
        return f"{first} (mode, temperature, sensors in use). Until it is explained, the errors of G and b exceed their sigmas."
    if not diagnosis.causes:
        return "Do not decide by this recording; make another one."
    stages = [
        EFFECTS[cause.effect].stage if cause.effect in EFFECTS and not is_undecided(cause) else "rate"
        for cause in diagnosis.causes
    ]
    remedies = list(dict.fromkeys(part for stage in stages for part in REMEDIES[stage].split(". ")))
    if diagnosis.remainder is not None and diagnosis.remainder.share > MOST and diagnosis.remainder.side != UNDECIDED:
        remedies.insert(0, f"Look at {SIDE_NAMES[diagnosis.remainder.side]} first, the source of most of the misfit")
    return " ".join(f"{remedy}." for remedy in remedies)


def describe_closure(diagnosis: Diagnosis) -> str:
    """State the share of the misfit that the causes remove on held-out data."""
    closure = diagnosis.closure
    unexplained = next((step.closed for step in diagnosis.budget if step.step == "remainder"), None)
    if diagnosis.verdict == "none":
        return "There is no misfit to explain."
    if not diagnosis.causes:
        return "No cause is identified, so nothing removes the misfit."
    if closure is None and unexplained is None:
        return "Not measured: the cause is seen in the samples alone, or too little of this recording can be held out."
    if closure is not None and closure.interval_90[1] - closure.interval_90[0] > WIDEST_SHARE:
        return "The held-out data show too little of the misfit to measure the share that the causes remove."
    share = closure.closed if unexplained is None and closure is not None else 1.0 - (unexplained or 0.0)
    interval = (
        ""
        if closure is None
        else f" (90 % interval {100 * closure.interval_90[0]:.0f} to {100 * closure.interval_90[1]:.0f} %)"
    )
    causes = "This cause removes" if len(diagnosis.causes) == 1 else f"These {len(diagnosis.causes)} causes remove"
    return f"{causes} {100 * min(max(share, 0.0), 1.0):.0f} % of the misfit on held-out data{interval}."
