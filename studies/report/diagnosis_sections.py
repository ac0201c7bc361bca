"""The sections of a diagnosis's page: causes, gap budget, calibration, places of the misfit, and sensors."""

import math
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from diagnosis.answer import UNDECIDED, Cause, RemainderSummary
from diagnosis.budget import Step
from diagnosis.result import Details, Diagnosis
from diagnosis.sensor_result import RejectedExplanation, SensorDiagnosis
from gyrocal import NAMES
from simulator.effects.sensor import ALL_EFFECTS as EFFECTS
from studies.report import diagnosis_figures as figures
from studies.report import tables
from studies.report.pages import Item, PageTable, Picture
from studies.report.tables import format_p_value, format_percent, join_items
from studies.report.units import PPM_DEG_H, PPM_DEG_H_NAMES

MOST_FINDINGS = 6
UNCHANGED_SIGMAS = 1e-3  # change of a parameter that counts as none
HETEROGENEOUS = 0.01  # p-value below which the sizes by part do not agree
SIDE_NAMES = {
    "gyro": "the gyro",
    "reference": "the reference attitudes",
    "time tags": "the time tags",
    "white noise": "white noise larger than stated",
}


def is_undecided(cause: Cause) -> bool:
    """Check whether the side of a cause, gyro or references, is undecided."""
    return cause.levels is not None and cause.levels.side.name == UNDECIDED


# ---- causes --------------------------------------------------------------------------------------------------------------


def build_cause_items(diagnosis: Diagnosis) -> list[Item]:
    """Build the table of causes, what their effects are, and a picture of each."""
    if not diagnosis.causes:
        return []
    rows = [
        {
            "cause": cause.label,
            "size": tables.format_size(cause.size, cause.sigma, cause.unit),
            "probability": format_percent(cause.probability),
            "indistinguishable from": ", ".join(cause.group[1:] if cause.named else cause.group) or "none",
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


def _list_details(cause: Cause, details: Details) -> Iterator[str]:
    """List the parameters of a cause as phrases, and whether its side is undecided."""
    if is_undecided(cause):
        yield "gyro or references: undecided"
    for name, value in cause.parameters.items():
        if name == "toward":
            template = "the scale factor of axis {}" if value == cause.axis else "axis {} picks up the rate about {}"
            yield f"{template.format(cause.axis, value)} (G_{cause.axis}{value})"
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
        starts_s = details.statistics.loc[details.statistics["interval"] == inside.index[0], "start_s"]
        first = float(starts_s.min()) if len(starts_s) else 0.0
        return f", in {inside.index[0]}, {tables.format_duration(t_s - inside['min'].iloc[0] + first)} after its start"
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


def build_budget_items(diagnosis: Diagnosis) -> list[Item]:
    """Build the table of the gap budget, and the sentences on the remainder."""
    budget, closure = diagnosis.budget, diagnosis.closure
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
    elif closure is not None:
        rows = [{"step": name, "misfit": getattr(closure, name)} for name in ("before", "after", "floor")]
    else:
        return []
    note = "Held-out whitened mean square; stated noise alone has the floor. Shares with 90 % intervals."
    sentences = [] if diagnosis.remainder is None else list(describe_remainder(diagnosis.remainder))
    return [PageTable(pd.DataFrame(rows), label="Gap budget on held-out data", note=note), sentences]


def _describe_agreement(step: Step) -> str:
    """State whether the sizes of a cause in parts of the recording agree."""
    if len(step.by_part) < 2 or step.heterogeneity_p is None:
        return ""
    if step.heterogeneity_p >= HETEROGENEOUS:
        return f"sizes in {len(step.by_part)} parts agree ({format_p_value(step.heterogeneity_p)})"
    ramp = "" if step.ramp is None else f"; a line over time goes from {step.ramp[0]:.3g} to {step.ramp[1]:.3g} {step.unit}"
    scatter = f"differs between {len(step.by_part)} parts by {step.spread:.2g} {step.unit} (1 sigma)"
    return f"{scatter}, {format_p_value(step.heterogeneity_p)}, mean {step.size:.3g} {step.unit}{ramp}"


def describe_remainder(remainder: RemainderSummary) -> Iterator[str]:
    """Describe the remainder: share, side, size, time scale, and the regressors that it follows."""
    yield f"No identified cause explains {tables.format_share(remainder.share, remainder.interval_90)} of the misfit."
    yield _describe_side(remainder)
    for regressor in remainder.regressors:
        behaviour, _, axis = regressor.name.partition(":")
        name = f"{behaviour}, axis {axis}" if axis else behaviour
        test = f"{format_p_value(regressor.p_value)}; closes {100 * regressor.share:.0f} % of the held-out misfit"
        yield f"A part of it: {name} ({test})."


def _describe_side(remainder: RemainderSummary) -> str:
    side = "The side of the remainder is undecided"
    if remainder.side != UNDECIDED:
        lasting = f", with a correlation time of about {remainder.time_scale_s:.2g} s" if remainder.time_scale_s > 0 else ""
        side = f"Most of the remainder is in {SIDE_NAMES[remainder.side]}{lasting}"
    return f"{side}. Sizes (1 sigma, x, y, z): {list_remainder_sizes(remainder)}."


def list_remainder_sizes(remainder: RemainderSummary) -> str:
    """List the sizes of a remainder, 1 sigma about x, y and z."""
    sizes = []
    for values, unit in ((remainder.gyro_deg_h, "deg/h of gyro rate"), (remainder.reference_deg, "deg of reference attitude")):
        if any(values):
            numbers = (np.format_float_positional(value, precision=2, fractional=False, trim="-") for value in values)
            sizes.append(f"{', '.join(numbers)} {unit}")
    if remainder.time_tags_s > 0:
        sizes.append(f"{remainder.time_tags_s:.2g} s of time tags")
    return "; ".join(sizes) or "none"


def build_budget_picture(diagnosis: Diagnosis) -> Picture:
    """Build the waterfall of the gap budget."""
    caption = "Misfit on held-out data and the share that each cause closes, with its 90 % interval."
    if any(len(step.by_part) > 1 for step in diagnosis.budget):
        caption += " Right: the size of each cause in separate parts of the recording, with 90 % bars; band: over all parts."
    alt = "Waterfall of the gap budget on held-out data; the table of the gap budget has its numbers."
    return Picture("budget", partial(figures.draw_waterfall, diagnosis.budget), alt, caption)


# ---- calibration ---------------------------------------------------------------------------------------------------------


def build_calibration_items(diagnosis: Diagnosis) -> list[Item]:
    """Build the table of parameters of the baseline and with the causes: G without unit, all else in ppm and deg/h."""
    scale = np.append(np.ones(9), PPM_DEG_H[9:])
    pairs = (
        (diagnosis.baseline_G, diagnosis.baseline_bias),
        (diagnosis.G, diagnosis.bias),
        (diagnosis.sigma_G, diagnosis.sigma_bias),
    )
    before, after, sigma = (np.append(G.ravel(), bias) * scale for G, bias in pairs)
    change = after - before
    change_sigmas = np.divide(change, sigma, out=np.full(len(NAMES), math.nan), where=(sigma > 0) & (sigma < math.inf))
    is_changed = bool(diagnosis.causes) and bool((np.abs(change) > UNCHANGED_SIGMAS * sigma).any())
    unit_scale = PPM_DEG_H / scale
    columns: dict[str, Any] = {"parameter": NAMES, "baseline": map(tables.format_to_sigma, before, sigma)}
    if is_changed:
        columns |= {
            "with causes": map(tables.format_to_sigma, after, sigma),
            "change": map(_remove_zero_sign, map(tables.format_to_sigma, change * unit_scale, sigma * unit_scale)),
        }
    columns |= {"sigma": map(tables.format_to_sigma, sigma * unit_scale, sigma * unit_scale), "unit": PPM_DEG_H_NAMES}
    if is_changed:
        columns["change in sigma"] = [
            _remove_zero_sign(f"{sigmas:+.1f}") if math.isfinite(sigmas) else tables.NO_VALUE for sigmas in change_sigmas
        ]
    strong = list(is_changed & (np.abs(change_sigmas.round(1)) > 3))
    note = "ω = G ω_raw + b. Values of G have no unit, those of b are in deg/h; change and sigma are in the unit shown."
    count = int((np.abs(change_sigmas.round(1)) > 1).sum()) if is_changed else None
    return [_describe_calibration_change(diagnosis, count), PageTable(pd.DataFrame(columns), strong, "Calibration", note)]


def _remove_zero_sign(text: str) -> str:
    return text if float(text) else text.lstrip("+-")


def _describe_calibration_change(diagnosis: Diagnosis, moved: int | None) -> str:
    """State whether the calibration can be trusted, and how many parameters the causes move by more than a sigma."""
    if not diagnosis.causes:
        if not diagnosis.present:
            return "The calibration is that of the baseline."
        return "No cause is in the model, and the misfit may have moved G and b by many sigmas. Do not trust the sigmas."
    warning = " The unknown effect is not in the model. Do not trust the sigmas." if diagnosis.verdict == "unknown" else ""
    if moved is None:
        return f"The causes change nothing in the calibration.{warning}"
    return f"With the causes in the model {moved} of {len(NAMES)} parameters move by more than a sigma.{warning}"


# ---- where the residuals do not fit --------------------------------------------------------------------------------------


def build_place_items(diagnosis: Diagnosis) -> list[Item]:
    """Build the list of findings, and the picture of the residuals if the answer shows the gap budget instead."""
    findings = [f"{finding.signal}: {finding.text} ({format_p_value(finding.p_value)})" for finding in diagnosis.where]
    items: list[Item] = [findings[:MOST_FINDINGS]] if findings else []
    if len(findings) > MOST_FINDINGS:
        items.append(f"And {len(findings) - MOST_FINDINGS} more, in the JSON result.")
    picture = build_residual_picture(diagnosis) if diagnosis.budget else None
    return [*items, picture] if picture else items


def build_residual_picture(diagnosis: Diagnosis) -> Picture | None:
    """Build the picture of residuals before and after with the baseline's band; None if no reference was compared."""
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


# ---- raw tables of sun and Earth sensors ------------------------------------------------------------------------------------


def build_sensor_items(sensors: SensorDiagnosis | None) -> list[Item]:
    """Build the fit of the raw sensor tables, and a picture of each sun sensor's residuals."""
    if sensors is None:
        return []
    items: list[Item] = [_describe_sensor_verdict(sensors), *map(_describe_rejected, sensors.rejected)]
    titles = {"before_deg": "nominal sensors"} | ({"after_deg": "with the causes"} if sensors.causes else {})
    for name in ("DSS-1", "DSS-2"):
        residuals = sensors.residuals[sensors.residuals["sensor"] == name]
        if residuals.empty:
            continue
        rms = [f"{np.sqrt(np.nanmean(residuals[key] ** 2)):.3g} deg RMS, {title}" for key, title in titles.items()]
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
    """State whether the sensors fit the nominal ones."""
    if sensors.mean_square is None:
        return "The measurements do not fit the nominal sensors in any arc."
    fit = f"whitened mean square {sensors.mean_square:.3f}, {sensors.dof} degrees of freedom, {format_p_value(sensors.p_value)}"
    if sensors.verdict == "none":
        return f"The sun and Earth sensors fit the nominal ones ({fit})."
    return f"The sun or Earth sensors do not fit the nominal ones ({fit})."


def _describe_rejected(rejected: RejectedExplanation) -> str:
    return (
        "An alignment calibration, which takes the two heads of a sun sensor for orthogonal, would find "
        f"{join_items(list(rejected.effects), 'and')} instead. That does not explain the data: they are less likely by a "
        f"factor of e^{rejected.log_bayes_factor:.0f}, and on held-out days the mean square falls only from "
        f"{rejected.before:.3f} to {rejected.after:.3f} ({format_p_value(rejected.p_value)})."
    )
