"""A diagnosis as one page for the terminal and the browser: the answers in plain words, then the tables behind them.

No name of an effect is in the answers: `simulator.effects.base.Effect.sentence` has the clause of each.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from diagnosis.answer import MOST, UNDECIDED, Cause, Finding, RemainderSummary, format_span
from diagnosis.budget import Step
from diagnosis.result import Details, Diagnosis
from diagnosis.sensor_result import RejectedExplanation, SensorDiagnosis
from diagnosis.settings import DEFAULT
from gyrocal import NAMES
from simulator.effects.base import ON_REFERENCES
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from studies.report import diagnosis_figures as figures
from studies.report import tables
from studies.report.pages import Answer, Item, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.tables import format_p_value, format_percent, join_items
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES

MOST_TOGETHER = 2  # effects in an explanation that a sentence names
MOST_PLACES = 2  # in the answer
MOST_FINDINGS = 6
MOST_EXPLANATIONS = 12
SHOWN_EXPLANATIONS = 5  # on the terminal
LEAST_PROBABILITY = 0.01  # of an explanation that is stated in the answer
UNCHANGED_SIGMAS = 1e-3  # change of a parameter that counts as none
WIDEST_SHARE = 2.0  # width of the 90 % interval of a closed share above which the share is not stated
HETEROGENEOUS = 0.01  # p-value below which the sizes by part do not agree
HOUR_S = 3600.0
ARCSEC_PER_DEG = 3600.0
VERDICT_STYLES = {"none": "", "not identifiable": "open"}  # of the answer; that of a misfit for all other verdicts
COUNT = 12  # elements of G and b
MOST_IN_HEADLINE = 2  # causes
UNLISTED = "an effect outside the library acts"
SIDE_NAMES = {
    "gyro": "the gyro",
    "reference": "the reference attitudes",
    "time tags": "the time tags",
    "white noise": "white noise larger than stated",
}
NOTES = (
    "The calibration removes constant errors of G and b; they are no misfit. An effect below the noise is not seen.",
    "The baseline has constant G and b, and white noise of gyro and references as stated. A positive size makes the gyro read "
    "high. Probabilities hold if one of the compared explanations is true.",
)


def build_diagnosis_page(diagnosis: Diagnosis, made: ProvenanceFooter | None = None, orbit_s: float = math.nan) -> Page:
    """Build the page; orbit_s is the period of the orbit, NaN if unknown: the pointing error is then that of an hour."""
    picture = _build_budget_picture(diagnosis) if diagnosis.budget else _build_residual_picture(diagnosis)
    answers = list_answers(diagnosis, orbit_s)
    size = diagnosis.misfit_size
    misfit = "gap" if size is None or size.material else "open"
    answer = Answer(VERDICT_STYLES.get(diagnosis.verdict, misfit), picture, describe_closure(diagnosis), answers)
    sections = [
        Section("Causes", _build_cause_items(diagnosis)),
        Section("Gap budget on held-out data", _build_budget_items(diagnosis)),
        Section("Calibration", _build_calibration_items(diagnosis)),
        Section("What this recording cannot show", [[one.describe() for one in diagnosis.invisible]]),
        Section("Left out, since it was not measured", [[*diagnosis.masked]]),
        Section("Where the residuals do not fit", _build_place_items(diagnosis)),
        Section("Sun and Earth sensors", _build_sensor_items(diagnosis.sensors)),
        Section("Compared explanations", _build_explanation_items(diagnosis.details.explanations)),
        Section("Limits of this recording", [[*diagnosis.notes, *NOTES]]),
    ]
    title = f"Diagnosis of {diagnosis.recording}"
    return Page(format_headline(diagnosis), [one for one in sections if any(one.items)], answer, made, title)


# ---- answers -------------------------------------------------------------------------------------------------------------


def list_answers(diagnosis: Diagnosis, orbit_s: float = math.nan) -> dict[str, str]:
    """List the answers by their questions, in the order in which they are read; arguments as of `build_diagnosis_page`."""
    answers = {"Does the baseline fit?": _describe_fit(diagnosis), "Where not?": _describe_places(diagnosis)}
    if diagnosis.present:
        answers["Does it matter?"] = describe_misfit_size(diagnosis)
    answers["Which cause?"] = _describe_causes(diagnosis)
    if diagnosis.causes:
        answers["What does it cost in pointing?"] = describe_pointing_cost(diagnosis.details.regressors, orbit_s)
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
    """State what the misfit adds to a held-out attitude beside the stated noise."""
    size = diagnosis.misfit_size
    if size is None:
        return "The attitudes fit the stated noise; the misfit is in the gyro samples or the sensor tables alone."
    added, stated = tables.format_short(size.added_deg), tables.format_short(size.stated_deg)
    span = format_duration(size.over_s)
    return f"{'Yes' if size.material else 'Hardly'}. It adds {added} deg to an attitude over {span}; stated: {stated} deg."


def format_duration(seconds: float) -> str:
    """Format a time in s up to two minutes, in min up to five hours, or in h."""
    if seconds < 120:
        return f"{seconds:.2g} s" if seconds < 10 else f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 18000 else f"{seconds / 3600:.1f} h"


def _format_answer(diagnosis: Diagnosis) -> str:
    if diagnosis.verdict == "none":
        if len(diagnosis.unobserved) == COUNT:
            return "No misfit, but these motions determine neither G nor b"
        return "No misfit: the baseline explains this recording"
    if diagnosis.verdict == "unknown":
        clauses = [_format_clause(cause) for cause in diagnosis.causes]
        more = f"; beside it, {join_items(clauses, 'and')}" if clauses else ""
        like = "" if diagnosis.remainder is None else _describe_likeness(diagnosis.remainder)
        if diagnosis.unknown_probability < DEFAULT.named:
            return f"The cause of the misfit is unknown; it may be an effect outside the library{like}{more}"
        return f"An effect outside the library causes the misfit{like}{more}"
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


def _describe_likeness(left: RemainderSummary) -> str:
    """Clause that says how a misfit without a cause acts, where it is random errors of one kind alone."""
    sizes = {
        "the gyro's rate were off by up to {:.2g} deg/h": max(left.gyro_deg_h),
        "the reference attitudes were off by up to {:.2g} deg": max(left.reference_deg),
        "the time tags were off by {:.2g} s": left.time_tags_s,
    }
    seen = [text.format(size) for text, size in sizes.items() if size > 0]
    is_doubtful = left.side == UNDECIDED and max(left.gyro_deg_h) > 0  # the references may drift as much
    return f", as if {seen[0]} (1 sigma)" if len(seen) == 1 and not is_doubtful else ""


def _state_shares(diagnosis: Diagnosis) -> str:
    """State the number of causes, the share of the misfit that they remove, and the rest."""
    left = 100 * next((step.closed or 0.0 for step in diagnosis.budget if step.step == "remainder"), 1.0)
    count = len(diagnosis.causes)
    causes = f", the first of {count} causes; together they remove" if count > 1 else "; this removes"
    return f"{causes} {max(100 - left, 0.0):.0f} % of the misfit, {left:.0f} % is not explained"


def _format_clause(cause: Cause) -> str:
    """Clause that states a cause with its size."""
    if cause.effect not in EFFECTS:
        return f"{UNLISTED} ({cause.effect})"
    if not cause.named:
        whose = "the gyro's rate or the reference attitudes have" if _is_undecided(cause) else "the gyro's rate has"
        whose = "the reference attitudes have" if cause.effect.startswith("reference") else whose
        return f"{whose} an error{f' about {cause.axis}' if cause.axis else ''} that changes slowly, as random errors do"
    return EFFECTS[cause.effect].sentence(cause.axis, cause.size, format_magnitude(cause))


def _is_undecided(cause: Cause) -> bool:
    """Whether neither side is known to make a cause."""
    return cause.levels is not None and cause.levels.side.name == UNDECIDED


def _format_with_alternatives(cause: Cause, diagnosis: Diagnosis, more: str = "") -> str:
    """Clause that states a cause with its alternatives, and hedges it where it is not certain."""
    others = [_format_unsized(member, cause) for member in cause.group if member != cause.label] if cause.named else []
    clause = f"{_format_clause(cause)}{more}"
    if diagnosis.verdict not in ("group", "partial"):
        return clause
    doubt = "" if (cause.group_probability if others else cause.probability) >= DEFAULT.named else "most likely "
    return f"{doubt}either {clause}, or {join_items(others, 'or')}" if others else f"{doubt}{clause}"


def _format_unsized(label: str, beside: Cause | None = None) -> str:
    """Clause that states an effect without a size, or with about that of the cause whose place it may have."""
    name, _, axis = label.partition(":")
    if name not in EFFECTS:
        return UNLISTED
    if beside is not None and beside.unit == EFFECTS[name].unit:
        return EFFECTS[name].sentence(axis or None, beside.size, "about as much")
    return EFFECTS[name].sentence(axis or None, 1.0, "some amount")


def _start_with_capital(text: str) -> str:
    return text[0].upper() + text[1:]


def format_magnitude(cause: Cause) -> str:
    """The size without its sign to two digits, three where its sigma is below a percent, and its unit."""
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


def _describe_places(diagnosis: Diagnosis) -> str:
    where = sorted(diagnosis.where, key=lambda one: one.interval is None)[:MOST_PLACES] if diagnosis.present else ()
    places = list(dict.fromkeys(map(_describe_place, where)))
    return f"Most of all {join_items(places, 'and')}." if places else "Nowhere."


def _describe_place(one: Finding) -> str:
    axis = f" about {one.axis}" if one.axis else ""
    interval = f" in {one.interval}" if one.interval else ""
    window = f", {format_span(*one.window_s)} after its start" if one.window_s and one.interval else ""
    what = "samples of the gyro" if one.signal == "gyro stream" else one.signal
    return f"in the {what}{axis}{interval}{window}"


def _describe_causes(diagnosis: Diagnosis) -> str:
    """The causes with their probabilities; the behaviour of an unknown one."""
    clauses = [
        _start_with_capital(_format_with_alternatives(cause, diagnosis, f" (probability {format_percent(cause.probability)})"))
        for cause in diagnosis.causes
    ]
    if diagnosis.verdict == "none":
        return "None."
    if diagnosis.verdict == "unknown":
        like = [
            f"{' together with '.join(map(_format_behaviour, effects))} ({format_percent(share)})"
            for effects, share in diagnosis.alternatives
            if share >= LEAST_PROBABILITY and len(effects) <= MOST_TOGETHER
        ]
        behaviour = f". It behaves most like this: {join_items(like[:MOST_PLACES], 'or')}" if like else ""
        clauses.insert(0, f"With a probability of {format_percent(diagnosis.unknown_probability)} {UNLISTED}{behaviour}")
        if diagnosis.remainder is not None:
            clauses.append(_describe_side(diagnosis.remainder).rstrip("."))
    return " ".join(f"{one}." for one in clauses) or "This recording cannot show it."


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
        if len(diagnosis.unobserved) == COUNT:
            return "Keep the calibration that the gyro had: these motions add nothing to it."
        if not diagnosis.unobserved:
            return "Use the calibration as it is."
        return f"Use the calibration but for {join_items(diagnosis.unobserved, 'and')}, which these motions do not show."
    if diagnosis.verdict == "unknown":
        place = next((one.interval for one in diagnosis.where if one.interval), None)
        first = f"Compare {place} with the other intervals" if place else "Compare the intervals"
        return f"{first} (mode, temperature, sensors in use). Until it is explained, the errors of G and b exceed their sigmas."
    if not diagnosis.causes:
        return "Do not decide by this recording; make another one."
    stages = [
        EFFECTS[one.effect].stage if one.effect in EFFECTS and not _is_undecided(one) else "rate" for one in diagnosis.causes
    ]
    remedies = list(dict.fromkeys(part for stage in stages for part in REMEDIES[stage].split(". ")))
    if diagnosis.remainder is not None and diagnosis.remainder.share > MOST and diagnosis.remainder.side != UNDECIDED:
        remedies.insert(0, f"Look at {SIDE_NAMES[diagnosis.remainder.side]} first, the source of most of the misfit")
    return " ".join(f"{one}." for one in remedies)


def describe_pointing_cost(regressors: pd.DataFrame, orbit_s: float) -> str:
    """State the largest angle by which the causes turn an attitude propagated with the gyro within an orbit or an hour.

    The calibration takes part of a cause into G and b. It is made without that part, so the rest is stated.
    """
    if regressors.empty:
        return "The cause is in the samples alone and turns no attitude that could be measured here."
    gyro = regressors[[not _is_on_references(str(label)) for label in regressors["cause"]]]
    if gyro.empty:
        angle, axis, interval, _ = _find_largest_turn(regressors, math.inf)
        size = tables.format_short(angle, 3)
        return f"None: the references err, by up to {size} arcsec about {axis}, in {interval}."
    window, name = (orbit_s, "an orbit") if math.isfinite(orbit_s) else (HOUR_S, "an hour")
    angle, axis, interval, length = _find_largest_turn(gyro, window)
    within = name if 0.9 * window < length <= window else format_duration(length)
    size = tables.format_short(angle, 3)
    return f"Propagated with the gyro, the attitude errs by up to {size} arcsec about {axis} in {within}, in {interval}."


def _is_on_references(label: str) -> bool:
    name = label.partition(":")[0]
    return label.startswith("references ") or (name in EFFECTS and EFFECTS[name].stage in ON_REFERENCES)


def _find_largest_turn(regressors: pd.DataFrame, window_s: float) -> tuple[float, str, str, float]:
    """Largest change of an angle within a window, arcsec; its axis, its interval, and the length of the window, s."""
    found = []
    for (interval, axis), part in regressors.groupby(["interval", "axis"], sort=False):
        angle = part.groupby("t_s")["regressor_deg"].sum()
        t = angle.index.to_numpy(dtype=float)
        if t.size > 1:
            length = min(max(window_s, float(np.diff(t).min())), float(np.ptp(t)))
            windows = angle.set_axis(pd.to_timedelta(t, unit="s")).rolling(pd.Timedelta(length, "s"), closed="both")
            found.append((float((windows.max() - windows.min()).max()) * ARCSEC_PER_DEG, str(axis), str(interval), length))
    return max(found, default=(0.0, "any axis", "any interval", window_s))


# ---- causes --------------------------------------------------------------------------------------------------------------


def _build_cause_items(diagnosis: Diagnosis) -> list[Item]:
    if not diagnosis.causes:
        return []
    rows = [
        {
            "cause": cause.label,
            "size": tables.format_size(cause.size, cause.sigma, cause.unit),
            "probability": format_percent(cause.probability),
            "indistinguishable from": ", ".join(map(_format_label, cause.group[1:] if cause.named else cause.group)) or "none",
            "one of these": format_percent(cause.group_probability),
            "details": "; ".join(_list_details(cause, diagnosis.details)),
        }
        for cause in diagnosis.causes
    ]
    names = dict.fromkeys(member.partition(":")[0] for cause in diagnosis.causes for member in (cause.label, *cause.group))
    meanings = {name: EFFECTS[name].meaning or EFFECTS[name].summary for name in names if name in EFFECTS}
    drawn = set(diagnosis.details.regressors["cause"])
    pictures = [_build_regressor_picture(diagnosis, cause) for cause in diagnosis.causes if cause.label in drawn]
    return [PageTable(pd.DataFrame(rows), label="Causes"), meanings, *pictures]


def _format_label(label: str) -> str:
    """Effect and axis of a listed effect; of another one its behaviour."""
    name, separator, axis = label.rpartition(":")
    effect = name if separator else label
    if effect in EFFECTS:
        return label
    return f"outside the library ({name}, axis {axis})" if separator else f"outside the library ({label})"


def _list_details(cause: Cause, details: Details) -> Iterator[str]:
    """The other numbers of a cause, and whether its side is undecided."""
    if _is_undecided(cause):
        yield "gyro or references: undecided"
    for name, value in cause.parameters.items():
        if name == "toward":
            what = "the scale factor of axis {}" if value == cause.axis else "axis {} picks up the rate about {}"
            yield f"{what.format(cause.axis, value)} (G_{cause.axis}{value})"
        elif isinstance(value, str):
            yield PARAMETER_WORDS.get(name, f"{name.replace('_', ' ')} {{}}").format(GAP_WORDS.get(value, value))
        else:
            yield _describe_number(name, value) + (_locate_interval(value, details) if name == "time_s" else "")


PARAMETER_WORDS = {
    "column": "follows housekeeping column {}",
    "gaps": "between intervals the bias {}",
    "time_s": "at {:.0f} s since the epoch",
    "phase_deg": "phase {:.0f}° at the epoch",
    "period_s": "period {:.5g} s",
    "apparent_hz": "seen at {:.5g} Hz",
    "time_constant_s": "time constant {:.3g} s",
}
GAP_WORDS = {"hold": "holds its value", "grow": "continues", "reset": "restarts from zero"}


def _describe_number(name: str, value: float) -> str:
    """State a number of a cause by the unit at the end of its name."""
    if not math.isfinite(value):
        return f"{name.replace('_', ' ')} not known"
    if name in PARAMETER_WORDS:
        return PARAMETER_WORDS[name].format(value)
    if name.endswith("_probability"):
        return f"this element with probability {format_percent(value)}, the sigma covers all"
    if name == "fraction":
        return f"{format_percent(value)} of the samples"
    quantity, _, unit = name.rpartition("_")
    return f"{quantity.replace('_', ' ')} {value:.5g} {unit}" if quantity else f"{name} {value:.5g}"


def _locate_interval(t_s: float, details: Details) -> str:
    """Name the interval that a time is in, or the two that it is between."""
    residuals = details.residuals
    if residuals.empty:
        return ""
    spans = residuals.groupby("interval", sort=False)["t_s"].agg(["min", "max"])
    before = spans[spans["max"] < t_s]
    inside = spans[(spans["min"] <= t_s) & (t_s <= spans["max"])]
    after = spans[spans["min"] > t_s]
    if len(inside):
        # The first residual may be of a mean of references, which is not where the interval starts.
        own = details.statistics.loc[details.statistics["interval"] == inside.index[0], "start_s"]
        first = float(own.min()) if len(own) else 0.0
        return f", in {inside.index[0]}, {format_duration(t_s - inside['min'].iloc[0] + first)} after its start"
    return f", between {before.index[-1]} and {after.index[0]}" if len(before) and len(after) else ""


def _build_regressor_picture(diagnosis: Diagnosis, cause: Cause) -> Picture:
    return Picture(
        f"cause-{cause.label.replace(':', '-').replace(' ', '-')}",
        partial(figures.draw_regressor_figure, diagnosis.details.regressors, cause.label),
        f"Residuals of the baseline against the effect of {cause.label} at the size found, and both over time.",
        f"{cause.label}. Left: each point is a reference attitude about one axis, other causes subtracted. If the cause is "
        "right, points follow the black line; neighbouring points deviate together, since gyro noise adds up in an interval. "
        "Right: both over time.",
    )


# ---- gap budget ----------------------------------------------------------------------------------------------------------


def describe_closure(diagnosis: Diagnosis) -> str:
    """State the share of the misfit that the causes remove on held-out data."""
    found = diagnosis.closure
    left = next((step.closed for step in diagnosis.budget if step.step == "remainder"), None)
    if diagnosis.verdict == "none":
        return "There is no misfit to explain."
    if not diagnosis.causes:
        return "No cause is identified, so nothing removes the misfit."
    if found is None and left is None:
        return "Not measured: the cause is seen in the samples alone, or too little of this recording can be held out."
    if found is not None and found.interval_90[1] - found.interval_90[0] > WIDEST_SHARE:
        return "The held-out data show too little of the misfit to measure the share that the causes remove."
    share = found.closed if left is None and found is not None else 1.0 - (left or 0.0)
    interval = (
        "" if found is None else f" (90 % interval {100 * found.interval_90[0]:.0f} to {100 * found.interval_90[1]:.0f} %)"
    )
    causes = "This cause removes" if len(diagnosis.causes) == 1 else f"These {len(diagnosis.causes)} causes remove"
    return f"{causes} {100 * min(max(share, 0.0), 1.0):.0f} % of the misfit on held-out data{interval}."


def _build_budget_items(diagnosis: Diagnosis) -> list[Item]:
    budget, found = diagnosis.budget, diagnosis.closure
    if budget:
        rows = [
            {
                "step": figures.name_step(step),
                "misfit": step.misfit,
                "share closed": tables.format_share(step.closed, step.interval_90),
                "by part": _describe_agreement(step),
            }
            for step in budget
        ]
    elif found is not None:
        rows = [{"step": name, "misfit": getattr(found, name)} for name in ("before", "after", "floor")]
    else:
        return []
    note = "Held-out whitened mean square; stated noise alone has the floor. Shares with 90 % intervals."
    left = [] if diagnosis.remainder is None else list(describe_remainder(diagnosis.remainder))
    return [PageTable(pd.DataFrame(rows), label="Gap budget on held-out data", note=note), left]


def _describe_agreement(step: Step) -> str:
    """State whether the sizes of a cause in parts of the recording agree."""
    if len(step.by_part) < 2 or step.heterogeneity_p is None:
        return ""
    if step.heterogeneity_p >= HETEROGENEOUS:
        return f"sizes in {len(step.by_part)} parts agree ({format_p_value(step.heterogeneity_p)})"
    ramp = "" if step.ramp is None else f"; a line over time goes from {step.ramp[0]:.3g} to {step.ramp[1]:.3g} {step.unit}"
    scatter = f"differs between {len(step.by_part)} parts by {step.spread:.2g} {step.unit} (1 sigma)"
    return f"{scatter}, {format_p_value(step.heterogeneity_p)}, mean {step.size:.3g} {step.unit}{ramp}"


def describe_remainder(left: RemainderSummary) -> Iterator[str]:
    """Describe the remainder: share, side, size, time scale, and the regressors that it follows."""
    yield f"No identified cause explains {tables.format_share(left.share, left.interval_90)} of the misfit."
    yield _describe_side(left)
    for one in left.regressors:
        behaviour, _, axis = one.name.partition(":")
        what = f"{behaviour}{f', axis {axis}' if axis else ''}"
        yield f"A part of it: {what} ({format_p_value(one.p_value)}; closes {100 * one.share:.0f} % of the held-out misfit)."


def _describe_side(left: RemainderSummary) -> str:
    side = "The side of the remainder is undecided"
    if left.side != UNDECIDED:
        lasting = f", with a correlation time of about {left.time_scale_s:.2g} s" if left.time_scale_s > 0 else ""
        side = f"Most of the remainder is in {SIDE_NAMES[left.side]}{lasting}"
    return f"{side}. Sizes (1 sigma, x, y, z): {list_remainder_sizes(left)}."


def list_remainder_sizes(left: RemainderSummary) -> str:
    """List the sizes of a remainder, 1 sigma about x, y and z."""
    sizes = []
    for values, unit in ((left.gyro_deg_h, "deg/h of gyro rate"), (left.reference_deg, "deg of reference attitude")):
        if any(values):
            numbers = (np.format_float_positional(one, precision=2, fractional=False, trim="-") for one in values)
            sizes.append(f"{', '.join(numbers)} {unit}")
    if left.time_tags_s > 0:
        sizes.append(f"{left.time_tags_s:.2g} s of time tags")
    return "; ".join(sizes) or "none"


def _build_budget_picture(diagnosis: Diagnosis) -> Picture:
    caption = "Misfit on held-out data and the share that each cause closes, with its 90 % interval."
    if any(len(step.by_part) > 1 for step in diagnosis.budget):
        caption += " Right: the size of each cause in separate parts of the recording, with 90 % bars; band: over all parts."
    alt = "Waterfall of the gap budget on held-out data; the table of the gap budget has its numbers."
    return Picture("budget", partial(figures.draw_waterfall, diagnosis.budget), alt, caption)


# ---- calibration ---------------------------------------------------------------------------------------------------------


def _build_calibration_items(diagnosis: Diagnosis) -> list[Item]:
    """Parameters of the baseline and with the causes: values of G without unit, all else in ppm and deg/h."""
    scale = np.append(np.ones(9), PPM_DEG_H[9:])
    pairs = (
        (diagnosis.baseline_G, diagnosis.baseline_bias),
        (diagnosis.G, diagnosis.bias),
        (diagnosis.sigma_G, diagnosis.sigma_bias),
    )
    before, after, sigma = (np.append(G.ravel(), bias) * scale for G, bias in pairs)
    change = after - before
    moved = np.divide(change, sigma, out=np.full(COUNT, math.nan), where=(sigma > 0) & (sigma < math.inf))
    is_changed = bool(diagnosis.causes) and bool((np.abs(change) > UNCHANGED_SIGMAS * sigma).any())
    own_scale = PPM_DEG_H / scale
    columns: dict[str, Any] = {"parameter": NAMES, "baseline": map(tables.format_to_sigma, before, sigma)}
    if is_changed:
        columns |= {
            "with causes": map(tables.format_to_sigma, after, sigma),
            "change": map(_remove_zero_sign, map(tables.format_to_sigma, change * own_scale, sigma * own_scale)),
        }
    columns |= {"sigma": map(tables.format_to_sigma, sigma * own_scale, sigma * own_scale), "unit": PPM_DEG_H_NAMES}
    if is_changed:
        columns["change in sigma"] = [
            _remove_zero_sign(f"{one:+.1f}") if math.isfinite(one) else tables.NO_VALUE for one in moved
        ]
    strong = list(is_changed & (np.abs(moved.round(1)) > 3))
    note = "ω = G ω_raw + b. Values of G have no unit, those of b are in deg/h; change and sigma are in the unit shown."
    count = int((np.abs(moved.round(1)) > 1).sum()) if is_changed else None
    return [_describe_calibration_change(diagnosis, count), PageTable(pd.DataFrame(columns), strong, "Calibration", note)]


def _remove_zero_sign(text: str) -> str:
    return text if float(text) else text.lstrip("+-")


def _describe_calibration_change(diagnosis: Diagnosis, moved: int | None) -> str:
    """State whether the calibration can be trusted, and how many parameters the causes move by more than a sigma."""
    if not diagnosis.causes:
        if not diagnosis.present:
            return "The calibration is that of the baseline."
        return "No cause is in the model, and the misfit may have moved G and b by many sigmas. Do not trust the sigmas."
    beside = " The unknown effect is not in the model. Do not trust the sigmas." if diagnosis.verdict == "unknown" else ""
    if moved is None:
        return f"The causes change nothing in the calibration.{beside}"
    return f"With the causes in the model {moved} of {COUNT} parameters move by more than a sigma.{beside}"


# ---- where, and what was compared ----------------------------------------------------------------------------------------


def _build_place_items(diagnosis: Diagnosis) -> list[Item]:
    found = [f"{one.signal}: {one.text} ({format_p_value(one.p_value)})" for one in diagnosis.where]
    items: list[Item] = [found[:MOST_FINDINGS]] if found else []
    if len(found) > MOST_FINDINGS:
        items.append(f"And {len(found) - MOST_FINDINGS} more, in the JSON result.")
    picture = _build_residual_picture(diagnosis) if diagnosis.budget else None
    return [*items, picture] if picture else items


def _build_residual_picture(diagnosis: Diagnosis) -> Picture | None:
    """Residuals before and after with the baseline's band; none if no reference was compared."""
    residuals = diagnosis.details.residuals
    if residuals.empty:
        return None
    count = residuals["interval"].nunique()
    shown = len(figures.select_largest_intervals(residuals))
    subset = "" if shown == count else f" The {shown} of {count} intervals with the largest residuals."
    after = ", and blue with the causes in the model" if figures.is_residual_changed(residuals) else ""
    return Picture(
        "residuals",
        partial(figures.draw_interval_residuals, residuals),
        f"Attitude residuals of {shown} intervals about x, y and z against time, with the baseline's band.",
        f"Red: residuals of the reference attitudes after the baseline's own fit{after}. The grey band is two sigma of the "
        f"baseline.{subset}",
    )


def _build_explanation_items(table: pd.DataFrame) -> list[Item]:
    if table.empty:
        return []
    likeliest = table.nlargest(MOST_EXPLANATIONS, "probability", keep="first")
    finite = np.isfinite(likeliest["log_evidence"])
    rows = pd.DataFrame(
        {
            "explanation": [
                " + ".join(map(_format_label, text.split(" + "))) if text else "no effect" for text in likeliest["effects"]
            ],
            "probability": [format_percent(share) for share in likeliest["probability"]],
            "log evidence": likeliest["log_evidence"].map("{:.1f}".format).where(finite, tables.NO_VALUE),
        }
    )
    note = (
        "Log evidence is against the baseline, in natural units: 3 more is about 20 times as likely. It is averaged over all "
        "plausible sizes. Bold: with an effect outside the library."
    )
    return [PageTable(rows, list(likeliest["unlisted"]), "Compared explanations", note, SHOWN_EXPLANATIONS)]


# ---- raw tables of sun and Earth sensors ------------------------------------------------------------------------------------


def _build_sensor_items(sensors: SensorDiagnosis | None) -> list[Item]:
    if sensors is None:
        return []
    items: list[Item] = [_describe_sensor_verdict(sensors), *map(_describe_rejected, sensors.rejected)]
    titles = {"before_deg": "nominal sensors"} | ({"after_deg": "with the causes"} if sensors.causes else {})
    for name in ("DSS-1", "DSS-2"):
        own = sensors.residuals[sensors.residuals["sensor"] == name]
        if own.empty:
            continue
        rms = [f"{np.sqrt(np.nanmean(own[key] ** 2)):.3g} deg RMS, {title}" for key, title in titles.items()]
        items.append(
            Picture(
                f"sensor-{name.lower()}",
                partial(figures.draw_sun_residuals, sensors.residuals, name, titles),
                f"Residuals of {name} over the Sun's two angles: {'; '.join(rms)}.",
                "Measured minus predicted by each arc's own attitude and gyro bias. Noise and the gyro's random walk leave a "
                "band about zero, the same everywhere in the field of view.",
            )
        )
    return items


def _describe_sensor_verdict(sensors: SensorDiagnosis) -> str:
    """State whether the sensors fit the nominal ones, and the causes where they do not."""
    if sensors.mean_square is None:
        return "The measurements do not fit the nominal sensors in any arc."
    fit = f"whitened mean square {sensors.mean_square:.3f}, {sensors.dof} degrees of freedom, {format_p_value(sensors.p_value)}"
    if sensors.verdict == "none":
        return f"The sun and Earth sensors fit the nominal ones ({fit})."
    cause = {"unknown": "no known effect explains it", "group": "the recording does not separate the causes"}.get(
        sensors.verdict, f"causes: {join_items([one.label for one in sensors.causes], 'and')}" if sensors.causes else "unknown"
    )
    return f"The sun or Earth sensors do not fit the nominal ones ({fit}); {cause}."


def _describe_rejected(other: RejectedExplanation) -> str:
    return (
        "An alignment calibration, which takes the two heads of a sun sensor for orthogonal, would find "
        f"{join_items(list(other.effects), 'and')} instead. That does not explain the data: they are less likely by a factor "
        f"of e^{other.log_bayes_factor:.0f}, and on held-out days the mean square falls only from {other.before:.3f} to "
        f"{other.after:.3f} ({format_p_value(other.p_value)})."
    )
