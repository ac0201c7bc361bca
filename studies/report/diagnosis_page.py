"""A diagnosis as one HTML page: the gap budget and the answer first, then the evidence, and the limits last."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pandas as pd

from diagnosis.answer import Cause
from diagnosis.result import Diagnosis
from simulator.effects.sensor import SENSOR_EFFECTS
from studies.report import diagnosis_answers, gap_budget, tables
from studies.report import diagnosis_figures as figures
from studies.report import diagnosis_words as words
from studies.report.pages import Answer, Item, Page, PageTable, Picture, ProvenanceFooter, Section, SmallParagraph

MOST_PAGE_FINDINGS = 8
MOST_EXPLANATIONS = 12
MOST_STREAM_TESTS = 40
VERDICT_STYLES = {"none": "", "not identifiable": "open"}  # of the answer; a gap for all other verdicts
GLOSSARY = {
    "baseline": "The simulator M0: constant G and b, white gyro noise and white reference noise as stated.",
    "gap": "Anything in the recording that the baseline cannot produce.",
    "sign": "A positive size makes the gyro read high; b has the opposite sign, since it is added to the reading.",
    "probability": "Given that the truth is one of the explanations compared, the unlisted ones included.",
    "sigma": "One standard deviation.",
}


def build_diagnosis_page(
    diagnosis: Diagnosis, made: ProvenanceFooter | None = None, orbit_s: float = math.nan, next_flight: str = ""
) -> str:
    """The whole page; the same diagnosis gives the same bytes but for how it was made.

    Parameters
    ----------
    diagnosis : the answer
    made : for the footer
    orbit_s, next_flight : as of `studies.report.diagnosis_answers.list_answers`
    """
    answers = diagnosis_answers.list_answers(diagnosis, orbit_s, next_flight)
    picture = _build_budget_picture(diagnosis) if diagnosis.budget else _build_residual_picture(diagnosis)
    answer = Answer(VERDICT_STYLES.get(diagnosis.verdict, "gap"), picture, gap_budget.summarise(diagnosis), answers)
    evidence = [
        *_build_place_sections(diagnosis),
        *_build_sensor_sections(diagnosis),
        *_build_explanation_sections(diagnosis),
        *_build_stream_sections(diagnosis),
    ]
    consequence = [_build_closure_section(diagnosis), _build_calibration_section(diagnosis)]
    sections = [
        Section("The answer in the words of the list of effects", _build_answer(diagnosis)),
        *_build_cause_sections(diagnosis),
        *(consequence + evidence if diagnosis.causes else evidence + consequence),
        Section("Limits of this recording", [_list_limits(diagnosis)]),
        Section("Words", [{name: words.explain_effect(name) for name in words.list_mentioned_effects(diagnosis)} | GLOSSARY]),
    ]
    headline = diagnosis_answers.format_headline(diagnosis)
    return Page(headline, sections, answer, made, f"Diagnosis of {diagnosis.recording}").render_html()


# ---- sections ------------------------------------------------------------------------------------------------------------


def _build_answer(diagnosis: Diagnosis) -> list[Item]:
    sizes = [
        f"{cause.label}: {words.format_cause_size(cause)}; {words.describe_probability(cause)}." for cause in diagnosis.causes
    ]
    return [words.describe_verdict(diagnosis), words.describe_gap_test(diagnosis), sizes, list(gap_budget.describe(diagnosis))]


def _build_cause_sections(diagnosis: Diagnosis) -> list[Section]:
    if not diagnosis.causes:
        return []
    sections = [Section("Cause" if len(diagnosis.causes) == 1 else "Causes", [])]
    for cause in diagnosis.causes:
        if cause.label in set(diagnosis.details.regressors["cause"]):
            seen: Item = _build_regressor_picture(diagnosis, cause)
        elif cause.effect in SENSOR_EFFECTS:
            seen = "It is seen in the raw tables of the sensors; see there."
        else:
            seen = "It is seen in the samples themselves; see the gyro stream below."
        sections.append(
            Section(cause.label, [words.explain_effect(cause.effect), _build_cause_rows(cause, diagnosis), seen], 3)
        )
    return sections


def _build_cause_rows(cause: Cause, diagnosis: Diagnosis) -> dict[str, str]:
    rows = {"size": words.format_cause_size(cause)}
    if cause.parameters:
        rows["details"] = "; ".join(words.describe_parameters(cause, diagnosis))
    rows["probability"] = words.format_percent(cause.probability)
    others = [words.label(member) for member in cause.group if member != cause.label]
    rows["indistinguishable from"] = words.join_items(others, "or") if others else "no other effect on the list"
    if others:
        rows["one of these at work"] = words.format_percent(cause.group_probability)
    return rows


def _build_closure_section(diagnosis: Diagnosis) -> Section:
    found, title = diagnosis.closure, "How far the gap closes"
    if found is None:
        return Section(title, [words.explain_missing_closure(diagnosis)])
    by_interval = PageTable(found.by_interval[["interval", "before", "after", "floor"]], label=f"{found.measure} by interval")
    return Section(title, [words.describe_closure(found), by_interval])


def _build_calibration_section(diagnosis: Diagnosis) -> Section:
    table = words.tabulate_calibration_change(diagnosis)
    note = "Sigmas in ppm for G and deg/h for b."
    strong = pd.Series(False, index=table.index)
    if words.is_calibration_changed(diagnosis):
        strong = pd.to_numeric(table["change in sigma"], errors="coerce").abs() > 3
        note = "Changes and sigmas in ppm for G and deg/h for b; bold: more than three sigma."
    else:
        table = table[["parameter", "baseline", "sigma", "unit"]]
    note = f"ω = G ω_raw + b; G has no unit, b is in deg/h. {note}"
    items: list[Item] = [
        words.describe_calibration_change(diagnosis),
        PageTable(table, strong, "Calibration"),
        SmallParagraph(note),
    ]
    return Section("Effect on the calibration", items)


def _build_place_sections(diagnosis: Diagnosis) -> list[Section]:
    found = [f"{one.signal}: {one.text} ({words.format_p_value(one.p_value)})" for one in diagnosis.where]
    items: list[Item] = [found[:MOST_PAGE_FINDINGS] or "No place departs from the baseline."]
    if len(found) > MOST_PAGE_FINDINGS:
        items.append(SmallParagraph(f"And {len(found) - MOST_PAGE_FINDINGS} more, in the JSON result."))
    statistics = diagnosis.details.statistics
    if not statistics.empty:
        items.append(_build_map_picture(statistics))
    if diagnosis.budget and (picture := _build_residual_picture(diagnosis)):
        items.append(picture)
    return [Section("Where: what the answer rests on", items)]


def _build_sensor_sections(diagnosis: Diagnosis) -> list[Section]:
    sensors = diagnosis.sensors
    if sensors is None:
        return []
    items: list[Item] = [*words.describe_sensors(diagnosis)]
    titles = {"before_deg": "nominal sensors", "after_deg": "with the causes"}
    if not sensors.causes:
        titles.pop("after_deg")
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
                "Measured minus predicted by each arc's own attitude and gyro bias; noise and the gyro's random walk leave a "
                "band about zero, the same everywhere in the field of view.",
            )
        )
    return [Section("Sun and Earth sensors", items)]


def _build_explanation_sections(diagnosis: Diagnosis) -> list[Section]:
    table = diagnosis.details.explanations
    if table.empty:
        return []
    likeliest = table.nlargest(MOST_EXPLANATIONS, "probability", keep="first")
    rows = pd.DataFrame(
        {
            "explanation": [words.join_effects(str(text).split(" + ") if text else []) for text in likeliest["effects"]],
            "probability": [words.format_percent(share) for share in likeliest["probability"]],
            "log evidence": [
                f"{value:.1f}" if math.isfinite(value) else tables.NO_VALUE for value in likeliest["log_evidence"]
            ],
        }
    )
    text = (
        "An effect outside the library is at work with a probability of "
        f"{words.format_percent(diagnosis.unknown_probability)}. "
        "Log evidence is against the baseline, in natural units: 3 more is about 20 times as likely. It is averaged over all "
        "plausible sizes, so that an explanation does not win by having more parameters. Bold: with something unlisted."
    )
    shown = PageTable(rows, list(likeliest["unlisted"]), "Explanations")
    return [Section("The explanations that were compared", [text, shown])]


def _build_stream_sections(diagnosis: Diagnosis) -> list[Section]:
    table = diagnosis.details.stream
    if table.empty:
        return []
    ordered = table.sort_values("p_value", kind="stable")
    shown = ordered.head(MOST_STREAM_TESTS)
    rows = pd.DataFrame(
        {
            "test": shown["statistic"],
            "axis": shown["axis"].fillna("all"),
            "found": shown["value"],
            "baseline": shown["expected"],
            "chance": [words.format_p_value(p) for p in shown["p_value"]],
            "what": shown["text"],
        }
    )
    rows["test"] = rows["test"].str.replace("_", " ")
    strong = (shown["p_value"] * len(table) < 0.01) & (shown["statistic"] != "strongest_line")
    note = "The samples of the gyro, without the references. Bold: less than 1 % chance, all these tests counted."
    if len(ordered) > len(shown):
        note += f" The {len(shown)} least likely of {len(ordered)}."
    return [Section("The gyro stream", [note, PageTable(rows, strong, "Tests of the samples")])]


def _list_limits(diagnosis: Diagnosis) -> list[str]:
    notes = [*diagnosis.notes, words.ALWAYS_HIDDEN]
    for cause in diagnosis.causes:
        others = [words.label(member) for member in cause.group if member != cause.label]
        if others:
            notes.append(
                f"Whether it is {words.join_items([cause.label, *others], 'or')}: here they leave nearly the same trace."
            )
    return notes


# ---- figures -------------------------------------------------------------------------------------------------------------


def _build_budget_picture(diagnosis: Diagnosis) -> Picture:
    steps = "; ".join(f"{gap_budget.name_step(step)} {step.misfit:.3g}" for step in diagnosis.budget)
    caption = "Misfit on held-out data and the share that each cause closes, with its 90 % interval."
    if any(len(step.by_part) > 1 for step in diagnosis.budget):
        caption = f"Left: {caption[0].lower()}{caption[1:]} Right: the size of each cause in separate parts of the recording, "
        caption += "with 90 % bars; the band is the size over all parts."
    alt = f"Gap budget on held-out data, whitened mean square: {steps}."
    return Picture("budget", partial(gap_budget.draw_waterfall, diagnosis.budget), alt, caption)


def _build_regressor_picture(diagnosis: Diagnosis, cause: Cause) -> Picture:
    table = diagnosis.details.regressors
    part = table[table["cause"] == cause.label]
    fit = float(np.corrcoef(part["regressor_deg"], part["residual_deg"])[0, 1]) if part["regressor_deg"].std() > 0 else 0.0
    return Picture(
        f"cause-{cause.label.replace(':', '-')}",
        partial(figures.draw_regressor_figure, table, cause.label),
        f"Residuals that the baseline leaves against what {cause.label} does at the size found, {len(part)} points with a "
        f"correlation of {fit:.2f}; and both over time in the interval where the cause does most.",
        "Left: each point is a reference attitude about one axis, other causes taken out. If the cause is right, points "
        "follow the black line; neighbouring points deviate from it together, since gyro noise adds up in an interval. "
        "Right: both over time.",
    )


def _build_map_picture(statistics: pd.DataFrame) -> Picture:
    marked = int(figures.find_significant_tests(statistics).sum())
    worst = statistics.iloc[int(statistics["p_value"].to_numpy().argmin())]
    return Picture(
        "map",
        partial(figures.draw_statistics_figure, statistics),
        f"Map of {len(statistics)} tests by interval, axis and phase; {marked} are significant. The strongest: "
        f"{worst['interval']}, axis {worst['axis']}, {worst['phase']}, {words.format_p_value(float(worst['p_value']))}.",
        "−log10 p of each part of the recording: the larger, the further it departs from the baseline. A cross marks "
        "what is significant among all these tests (about 5 % of the crosses may be chance). Empty: no data to test.",
    )


def _build_residual_picture(diagnosis: Diagnosis) -> Picture | None:
    """Residuals before and after with the baseline's band; none if no reference was compared."""
    residuals = diagnosis.details.residuals
    if residuals.empty:
        return None
    count = residuals["interval"].nunique()
    shown = len(figures.select_telling_intervals(residuals, figures.normalise_by_band(residuals), figures.MOST_PANELS))
    subset = "" if shown == count else f" The {shown} of {count} intervals with the largest residuals."
    after = ", and blue with the causes in the model" if figures.is_residual_changed(residuals) else ""
    before, left = (figures.normalise_by_band(residuals, when).max() for when in ("before", "after"))
    return Picture(
        "residuals",
        partial(figures.draw_interval_residuals, residuals),
        f"Attitude residuals of {count} intervals about x, y and z against time, with the baseline's band; the largest is "
        f"{before:.1f} sigma before and {left:.1f} after.{subset}",
        f"Red: what is left of each reference attitude after the baseline's own fit{after}. In the grey band is what "
        f"the baseline allows.{subset}",
    )
