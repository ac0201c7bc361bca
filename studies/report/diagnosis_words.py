"""A diagnosis in plain words: what summary and report both say."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from diagnosis.answer import Cause, Closure
from diagnosis.result import Details, Diagnosis
from diagnosis.sensor_result import RejectedExplanation, SensorDiagnosis
from diagnosis.settings import DEFAULT
from gyrocal import NAMES
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from studies.report import tables

UNLISTED_NOTE = "Not on the list of effects: the description says how it behaves, not what causes it."
UNCHANGED_SIGMAS = 1e-3  # sigmas: a change of a parameter below which there is none
TOO_LITTLE = "The held-out data show too little of the gap to measure how far it closes"
WHOLE_CLOSED_SHARE = 0.995  # closed share that is shown as all of it
WIDEST_SHARE = 2.0  # width of the 90 % interval of a closed share, above which the share says nothing
ALWAYS_HIDDEN = (
    "Constant errors of G and b are removed by the calibration and are not a gap. "
    "An effect below the noise is not seen: 'no gap' means none that this recording could show."
)


# ---- numbers -------------------------------------------------------------------------------------------------------------


def format_percent(share: float) -> str:
    """A probability, never rounded to certainty."""
    if not math.isfinite(share):
        return tables.NO_VALUE
    value = 100 * share
    if value > 99.9:
        return "more than 99.9 %"
    if value < 0.1:
        return "less than 0.1 %"
    return f"{value:.1f} %" if value < 1 or value > 99 else f"{value:.0f} %"


def format_p_value(p: float) -> str:
    """A p-value with its relation: p = 0.012, p < 1e-99."""
    if not math.isfinite(p):
        return "p unknown"
    return "p < 1e-99" if p < 1e-99 else f"p = {p:.2g}"


def format_size(value: float, sigma: float, unit: str) -> str:
    """A size ± sigma and unit, to two digits of its sigma."""
    if not 0 < sigma < math.inf:
        return f"{value:.5g} {unit} (its error is not known)"
    if not math.isfinite(value):
        return f"unknown {unit}"
    if sigma < 1e-4 * abs(value):
        return f"{value:.6g} ± {sigma:.1g} {unit}"
    if max(abs(value), sigma) < 1e-3:
        power = math.floor(math.log10(max(abs(value), sigma)))
        value, sigma = value / 10.0**power, sigma / 10.0**power
        return f"({tables.format_to_sigma(value, sigma)} ± {tables.format_to_sigma(sigma, sigma)})e{power} {unit}"
    return f"{tables.format_to_sigma(value, sigma)} ± {tables.format_to_sigma(sigma, sigma)} {unit}"


def join_items(items: Sequence[str], last: str) -> str:
    """A, b and c."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"


def label(text: str) -> str:
    """A label as it is shown: effect and axis of what is listed, in words what is not."""
    name, separator, axis = text.rpartition(":")
    effect = name if separator else text
    if effect in EFFECTS:
        return text
    return f"something unlisted ({name}, axis {axis})" if separator else f"something unlisted ({text})"


def join_effects(effects: Sequence[str]) -> str:
    """An explanation's effects; none is the baseline."""
    return " + ".join(label(effect) for effect in effects) or "no effect"


def explain_effect(text: str) -> str:
    """Explain an effect by its label."""
    name = text.split(":")[0]
    return (EFFECTS[name].meaning or EFFECTS[name].summary) if name in EFFECTS else UNLISTED_NOTE


# ---- sentences -----------------------------------------------------------------------------------------------------------


def describe_verdict(diagnosis: Diagnosis) -> str:
    """The answer in one sentence."""
    causes = [cause.label for cause in diagnosis.causes]
    if diagnosis.verdict == "none":
        return "No gap: this recording shows nothing that the baseline simulator would not do."
    if diagnosis.verdict == "unknown":
        beside = f" Beside it there is {join_items(causes, 'and')}." if causes else ""
        known = "that no known effect explains" if diagnosis.unknown_probability >= DEFAULT.named else "of unknown cause"
        return (
            f"There is a gap {known}: with a probability of "
            f"{format_percent(diagnosis.unknown_probability)} something is at work that is not on the list.{beside}"
        )
    if diagnosis.verdict == "partial":
        identified = join_items([" or ".join(label(one) for one in cause.group) for cause in diagnosis.causes], "and")
        return f"There is a gap. Identified: {identified}. A significant remainder is left that no identified cause explains."
    if diagnosis.verdict == "not identifiable":
        if diagnosis.present:
            return "There is a gap, but this recording cannot show what causes it."
        return "This recording cannot show whether there is a gap."
    if diagnosis.verdict == "group" and not any(len(cause.group) > 1 for cause in diagnosis.causes):
        return f"There is a gap, most likely by {join_items(causes, 'and')}, but not surely."
    if diagnosis.verdict == "group" or not causes:
        return (
            f"There is a gap, and this recording cannot tell apart what explains it: {'; and '.join(list_groups(diagnosis))}."
        )
    if len(causes) == 1:
        return f"There is a gap, and one cause explains it: {causes[0]}."
    return f"There is a gap, and {len(causes)} causes together explain it: {join_items(causes, 'and')}."


def list_groups(diagnosis: Diagnosis) -> list[str]:
    """List the group of each cause."""
    return [join_items([label(member) for member in cause.group or (cause.label,)], "or") for cause in diagnosis.causes]


def describe_gap_test(diagnosis: Diagnosis) -> str:
    """Describe the significance of the gap."""
    answer = "a gap is reported" if diagnosis.present else "no gap is reported"
    return (
        f"Test of the baseline simulator: {format_p_value(diagnosis.p_value)}, so {answer}. At this threshold "
        f"{100 * diagnosis.false_alarm_rate:g} % of recordings without a gap would be reported as having one."
    )


def format_cause_size(cause: Cause) -> str:
    """Format the size and the parameters of a cause."""
    return format_size(cause.size, cause.sigma, cause.unit)


def describe_probability(cause: Cause) -> str:
    """Describe the probability of a cause, and the alternatives that this recording cannot separate from it."""
    others = [label(member) for member in cause.group if member != cause.label]
    own = f"probability {format_percent(cause.probability)}"
    if not others:
        return f"{own}; no other effect on the list explains the data as well"
    one = format_percent(cause.group_probability)
    return f"{own}; indistinguishable here from {join_items(others, 'or')} (probability that it is one of these: {one})"


def describe_parameters(cause: Cause, diagnosis: Diagnosis) -> list[str]:
    """A cause's other numbers, each in plain words."""
    return [_describe_parameter(name, value, cause, diagnosis) for name, value in cause.parameters.items()]


def describe_onset(cause: Cause, diagnosis: Diagnosis) -> list[str]:
    """When a cause set in, of one that did at one time."""
    return [_describe_parameter(name, value, cause, diagnosis) for name, value in cause.parameters.items() if name == "time_s"]


def _describe_parameter(name: str, value: float | str, cause: Cause, diagnosis: Diagnosis) -> str:
    if name == "toward":
        if value == cause.axis:
            return f"the scale factor of axis {cause.axis} (G_{cause.axis}{value})"
        return f"axis {cause.axis} picks up the rate about {value} (G_{cause.axis}{value})"
    if name == "column":
        return f"follows housekeeping column {value}"
    if name == "gaps":
        kinds = {"hold": "holds its value", "grow": "continues", "reset": "restarts from zero"}
        return f"between intervals the bias {kinds.get(str(value), str(value))}"
    if isinstance(value, str):
        return f"{name.replace('_', ' ')} {value}"
    if not math.isfinite(value):
        return f"{name.replace('_', ' ')} not known"
    if name.endswith("_probability"):
        return f"which of them is not certain: this one with {format_percent(value)}, and the sigma is over all"
    if name == "time_s":
        return f"at {value:.0f} s since the epoch{_locate_interval(value, diagnosis.details)}"
    if name == "phase_deg":
        return f"phase {value:.0f}° at the epoch"
    if name == "period_s":
        return f"with a period of {value:.5g} s"
    if name == "apparent_hz":
        return f"seen at {value:.5g} Hz"
    if name == "fraction":
        return f"{format_percent(value)} of the samples"
    if name == "time_constant_s":
        return f"lasting about {value:.3g} s"
    quantity, _, unit = name.rpartition("_")
    return f"{quantity.replace('_', ' ')} {value:.5g} {unit}" if quantity else f"{name} {value:.5g}"


def _locate_interval(t_s: float, details: Details) -> str:
    """Which interval a time is in, or between which two.

    The first residual is that of the first observation, which may be a mean of references and not where the interval starts.
    """
    residuals = details.residuals
    if residuals.empty:
        return ""
    spans = residuals.groupby("interval", sort=False)["t_s"].agg(["min", "max"])
    before = spans[spans["max"] < t_s]
    inside = spans[(spans["min"] <= t_s) & (t_s <= spans["max"])]
    after = spans[spans["min"] > t_s]
    if len(inside):
        own = details.statistics.loc[details.statistics["interval"] == inside.index[0], "start_s"]
        first = float(own.min()) if len(own) else 0.0
        return f", in {inside.index[0]}, {t_s - inside['min'].iloc[0] + first:.0f} s after its start"
    if len(before) and len(after):
        return f", between {before.index[-1]} and {after.index[0]}"
    return ""


def describe_closure(found: Closure) -> str:
    """Describe the reduction of the gap."""
    low, high = (100 * share for share in found.interval_90)
    share = _format_closed_share(found)
    shown = f"{share} of the gap is closed on held-out data" if share else TOO_LITTLE
    return (
        f"{shown} (90 % interval {low:.0f} to {high:.0f} %; held out: {found.split}). The {found.measure} is "
        f"{found.before:.3g} under the baseline and {found.after:.3g} with the cause in the model; noise alone would leave "
        f"{found.floor:.3g}."
    )


def describe_closure_briefly(diagnosis: Diagnosis) -> str:
    """Describe the reduction of the gap in short, without the numbers behind it."""
    found = diagnosis.closure
    if found is None:
        return explain_missing_closure(diagnosis)
    share, (low, high) = _format_closed_share(found), (100 * one for one in found.interval_90)
    if not share:
        return f"{TOO_LITTLE}."
    part = f"{share} of it ({low:.0f} to {high:.0f} %)"
    return f"{part}, once the cause is in the model; measured on data that took no part in finding it."


def _format_closed_share(found: Closure) -> str:
    """The share: all or none of it where it is beyond that; "" if the held-out gap is as small as its measure's scatter."""
    if not is_measured(found):
        return ""
    return "All" if found.closed >= WHOLE_CLOSED_SHARE else "None" if found.closed <= 0 else f"{100 * found.closed:.0f} %"


def is_measured(found: Closure) -> bool:
    """Whether the held-out data show enough of the gap to measure its share."""
    low, high = found.interval_90
    return high - low <= WIDEST_SHARE


def explain_missing_closure(diagnosis: Diagnosis) -> str:
    """Explain why the reduction of the gap is not measured."""
    if diagnosis.verdict == "none":
        return "There is no gap to close."
    if diagnosis.causes:
        return "Not measured: the cause is seen in the samples themselves, or too little of this recording can be held out."
    return "No cause is named, so nothing closes the gap."


def is_calibration_changed(diagnosis: Diagnosis) -> bool:
    """Whether there are causes, and the calibration is another one with them in, beyond rounding."""
    if not diagnosis.causes:
        return False
    G = np.abs(diagnosis.G - diagnosis.baseline_G) > UNCHANGED_SIGMAS * diagnosis.sigma_G
    bias = np.abs(diagnosis.bias - diagnosis.baseline_bias) > UNCHANGED_SIGMAS * diagnosis.sigma_bias
    return bool(G.any() or bias.any())


def tabulate_calibration_change(diagnosis: Diagnosis) -> pd.DataFrame:
    """The parameters G and b as texts: under M0, with the causes in, and what they change.

    Values of G have no unit, of b deg/h; changes and sigmas are in ppm and deg/h.
    """
    per_hour = np.rad2deg(1.0) * 3600
    rows = []
    before = np.append(diagnosis.baseline_G.ravel(), diagnosis.baseline_bias * per_hour)
    after = np.append(diagnosis.G.ravel(), diagnosis.bias * per_hour)
    sigma = np.append(diagnosis.sigma_G.ravel(), diagnosis.sigma_bias * per_hour)
    for name, old, new, error in zip(NAMES, before, after, sigma, strict=True):
        scale, unit = (1e6, "ppm") if name.startswith("G") else (1.0, "deg/h")
        change = (new - old) * scale
        relative = change / error / scale if 0 < error < math.inf else math.nan
        rows.append(
            {
                "parameter": name,
                "baseline": tables.format_to_sigma(old, error),
                "with causes": tables.format_to_sigma(new, error),
                "change": _remove_zero_sign(tables.format_to_sigma(change, error * scale)),
                "sigma": tables.format_to_sigma(error * scale, error * scale),
                "unit": unit,
                "change in sigma": _remove_zero_sign(f"{relative:+.1f}") if math.isfinite(relative) else tables.NO_VALUE,
            }
        )
    return pd.DataFrame(rows)


def _remove_zero_sign(text: str) -> str:
    return text if float(text) else text.lstrip("+-")


def describe_calibration_change(diagnosis: Diagnosis) -> str:
    """Describe the changes of the calibration by the causes, and whether it can be trusted."""
    if not diagnosis.causes:
        if not diagnosis.present:
            return "The calibration is the baseline's: no cause is in the model."
        return "No cause is in the model: what is at work may have moved G and b by many sigmas. Do not trust the sigmas."
    beside = " What has no name is not in the model: do not trust the sigmas." if diagnosis.verdict == "unknown" else ""
    return _describe_moved_parameters(diagnosis) + beside


def _describe_moved_parameters(diagnosis: Diagnosis) -> str:
    if not is_calibration_changed(diagnosis):
        return "The causes change nothing in the calibration."
    table = tabulate_calibration_change(diagnosis)
    count = len(table)
    table = table.assign(moved=pd.to_numeric(table["change in sigma"], errors="coerce").abs()).query("moved > 1")
    if table.empty:
        return "With the causes in the model no parameter moves by more than its sigma."
    most = table.nlargest(3, "moved")
    texts = [f"{name} by {float(by):+g} {unit}" for name, by, unit in most[["parameter", "change", "unit"]].to_numpy()]
    if len(table) == 1:
        return f"1 of {count} parameters moves by more than its sigma: {texts[0]}."
    return f"{len(table)} of {count} parameters move by more than their sigma, most of all {join_items(texts, 'and')}."


def list_mentioned_effects(diagnosis: Diagnosis) -> list[str]:
    """Effects that the answer speaks of, each once, in the order they come; what is unlisted is left out."""
    labels = [member for cause in diagnosis.causes for member in (cause.label, *cause.group)]
    labels += [effect for effects, _ in diagnosis.alternatives for effect in effects]
    labels += [effect for text in diagnosis.details.explanations["effects"].head(8) for effect in str(text).split(" + ")]
    names = dict.fromkeys(text.split(":")[0] for text in labels)
    return [name for name in names if name in EFFECTS]


# ---- raw tables of sun and Earth sensors ------------------------------------------------------------------------------------


def describe_sensors(diagnosis: Diagnosis) -> list[str]:
    """The answer of the sensors, how sure it is, and how far the gap closes where the whole answer does not say so."""
    sensors = diagnosis.sensors
    if sensors is None:
        return []
    apart = sensors.closure is not None and sensors.closure is not diagnosis.closure
    closed = [describe_closure(sensors.closure)] if apart and sensors.closure else []
    return [
        _describe_sensor_verdict(sensors),
        _describe_sensor_gap(sensors),
        *closed,
        *(_describe_rejected(one) for one in sensors.rejected),
    ]


def _describe_sensor_verdict(sensors: SensorDiagnosis) -> str:
    causes = [cause.label for cause in sensors.causes]
    if sensors.verdict == "none":
        return "Sun and Earth sensors show nothing that the nominal ones would not."
    if sensors.verdict == "unknown" or not causes:
        return "Sun or Earth sensors depart from the nominal ones in a way that no known effect explains."
    if sensors.verdict == "group":
        return "Sun or Earth sensors depart from the nominal ones, and what explains it cannot be told apart."
    return f"Sun or Earth sensors depart from the nominal ones: {join_items(causes, 'and')}."


def _describe_sensor_gap(sensors: SensorDiagnosis) -> str:
    if sensors.mean_square is None:
        return "Their measurements do not fit the nominal sensors in any arc."
    chance = format_p_value(sensors.p_value)
    return (
        "Mean square of their whitened residuals, with an attitude and a gyro bias fitted to each measurement arc (a time "
        f"of constant rate): {sensors.mean_square:.3f} with {sensors.dof} degrees of freedom; {chance} if they were nominal."
    )


def _describe_rejected(other: RejectedExplanation) -> str:
    labels = join_items(list(other.effects), "and")
    return (
        "An alignment calibration, which takes the two heads of a sun sensor for orthogonal, would find "
        f"{labels} instead. That does not explain the data: they are less likely by a factor of "
        f"e^{other.log_bayes_factor:.0f}, and on held-out days the mean square falls only from {other.before:.3f} to "
        f"{other.after:.3f} ({format_p_value(other.p_value)})."
    )
