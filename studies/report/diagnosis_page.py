"""A diagnosis as one HTML page that needs no network: the answer first, then what it rests on, and its limits last."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd

from diagnosis.answer import Cause
from diagnosis.model.lines import BIAS, PICKUP
from diagnosis.result import Diagnosis
from simulator.effects.sensor import SENSOR_EFFECTS
from studies.montecarlo.files import write_text
from studies.report import card_drawing, diagnosis_card, gap_budget, sensor_figures, sensor_words, tables
from studies.report import diagnosis_figures as figures
from studies.report import diagnosis_words as words
from studies.report.html import Picture, document, heading, paragraph, shown, table_of
from studies.report.made import Made

MOST_FINDINGS = 8
MOST_STREAM_TESTS = 40


def write(diagnosis: Diagnosis, path: Path, made: Made | None = None, orbit_s: float = math.nan, next_flight: str = "") -> None:
    """Write the page; what else it takes is as of `page`."""
    write_text(path, page(diagnosis, made, orbit_s, next_flight))


def page(diagnosis: Diagnosis, made: Made | None = None, orbit_s: float = math.nan, next_flight: str = "") -> str:
    """The whole page; the same diagnosis gives the same bytes but for how it was made.

    Parameters
    ----------
    diagnosis : the answer
    made : for the footer
    orbit_s, next_flight : as of `studies.report.diagnosis_card.card`
    """
    evidence = [_where(diagnosis), _explanations(diagnosis), _stream(diagnosis)]
    evidence.insert(1, _sensors(diagnosis))
    consequence = [_closure(diagnosis), _calibration(diagnosis)]
    body = consequence + evidence if diagnosis.causes else evidence + consequence
    card = diagnosis_card.card(diagnosis, orbit_s, next_flight)
    kind = {"none": "", "not identifiable": "open"}.get(diagnosis.verdict, "gap")
    parts = [paragraph(f"Diagnosis of {diagnosis.recording}", "quiet"), _budget(diagnosis), card_drawing.html(card, kind)]
    parts += [_answer(diagnosis), _causes(diagnosis), *body, _limits(diagnosis), _glossary(diagnosis)]
    return document(card.headline, parts, made, short=f"Diagnosis of {diagnosis.recording}")


# ---- sections ------------------------------------------------------------------------------------------------------------


def _answer(diagnosis: Diagnosis) -> str:
    lines = [heading("The answer in the words of the list of effects"), paragraph(words.verdict(diagnosis))]
    lines.append(paragraph(words.gap(diagnosis)))
    lines += [paragraph(f"{cause.label}: {words.cause_size(cause)}; {words.probability(cause)}.") for cause in diagnosis.causes]
    return "".join(lines)


def _causes(diagnosis: Diagnosis) -> str:
    if not diagnosis.causes:
        return ""
    out = [heading("Cause" if len(diagnosis.causes) == 1 else "Causes")]
    for cause in diagnosis.causes:
        out += [
            f"<h3><code>{escape(cause.label)}</code></h3>",
            paragraph(words.meaning(cause.effect)),
            _cause_table(cause, diagnosis),
        ]
        if cause.label in set(diagnosis.details.regressors["cause"]):
            out.append(shown(_regressor_picture(diagnosis, cause)))
        elif cause.effect in SENSOR_EFFECTS:
            out.append(paragraph("It is seen in the raw tables of the sensors; see there."))
        else:
            out.append(paragraph("It is seen in the samples themselves; see the gyro stream below."))
    return "".join(out)


def _cause_table(cause: Cause, diagnosis: Diagnosis) -> str:
    rows = {"size": words.cause_size(cause)}
    if cause.parameters:
        rows["details"] = "; ".join(words.parameters(cause, diagnosis))
    rows["probability"] = words.percent(cause.probability)
    others = [words.label(member) for member in cause.group if member != cause.label]
    if others:
        rows["indistinguishable from"] = words.listed(others, "or")
        rows["one of these at work"] = words.percent(cause.group_probability)
    else:
        rows["indistinguishable from"] = "no other effect on the list"
    cells = "".join(f"<tr><th scope=row>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
    return f"<table>{cells}</table>"


def _regressor_picture(diagnosis: Diagnosis, cause: Cause) -> Picture:
    table = diagnosis.details.regressors
    part = table[table["cause"] == cause.label]
    fit = float(np.corrcoef(part["regressor_deg"], part["residual_deg"])[0, 1]) if part["regressor_deg"].std() > 0 else 0.0
    return Picture(
        f"cause-{cause.label.replace(':', '-')}",
        lambda: figures.regressor_figure(table, cause.label),
        f"Residuals that the baseline leaves against what {cause.label} does at the size found, {len(part)} points with a "
        f"correlation of {fit:.2f}; and both over time in the interval where the cause does most.",
        "Left: each point is a reference attitude about one axis, other causes taken out. If the cause is right, points "
        "follow the black line; neighbouring points deviate from it together, since gyro noise adds up in an interval. "
        "Right: both over time.",
    )


def _budget(diagnosis: Diagnosis) -> str:
    """The waterfall of the gap budget, which carries the answer, and one sentence for each step."""
    if not diagnosis.budget:
        return ""
    steps = "; ".join(f"{gap_budget.name_step(step)} {step.misfit:.3g}" for step in diagnosis.budget)
    caption = "Misfit on held-out data and the share that each cause closes, with its 90 % interval."
    if any(len(step.by_part) > 1 for step in diagnosis.budget):
        caption = f"Left: {caption[0].lower()}{caption[1:]} Right: the size of each cause in separate parts of the recording, "
        caption += "with 90 % bars; the band is the size over all parts."
    picture = Picture(
        "budget",
        lambda: gap_budget.draw_waterfall(diagnosis.budget),
        f"Gap budget on held-out data, whitened mean square: {steps}.",
        caption,
    )
    said = "".join(paragraph(sentence) for sentence in gap_budget.describe(diagnosis))
    return heading("Gap budget") + shown(picture) + said


def _closure(diagnosis: Diagnosis) -> str:
    found = diagnosis.closure
    if found is None:
        return heading("How far the gap closes") + paragraph(words.no_closure(diagnosis))
    picture = Picture(
        "closure",
        lambda: figures.closure_figure(found.by_interval, (found.before, found.after, found.floor), found.measure),
        f"{found.measure} by interval, on held-out data: all together {found.before:.3g} before, {found.after:.3g} after, "
        f"floor {found.floor:.3g}.",
        f"Measured on held-out data ({found.split}), which took no part in choosing or fitting the causes. A blue dot on the "
        "grey tick: only noise is left.",
    )
    return heading("How far the gap closes") + paragraph(words.closure(found)) + shown(picture)


def _calibration(diagnosis: Diagnosis) -> str:
    table = words.calibration(diagnosis)
    out = [heading("Effect on the calibration"), paragraph(words.calibration_change(diagnosis))]
    if words.changed(diagnosis):
        moved = pd.to_numeric(table["change in sigma"], errors="coerce").abs() > 3
        note = "Changes and sigmas in ppm for G and deg/h for b; bold: more than three sigma."
    else:
        table = table[["parameter", "baseline", "sigma", "unit"]]
        moved = pd.Series(False, index=table.index)
        note = "Sigmas in ppm for G and deg/h for b."
    note = f"ω = G ω_raw + b; G has no unit, b is in deg/h. {note}"
    text = {"parameter", "unit"}
    return "".join([*out, table_of(table, moved, [c for c in table.columns if c not in text]), paragraph(note, "quiet")])


def _where(diagnosis: Diagnosis) -> str:
    out = [heading("Where: what the answer rests on")]
    found = diagnosis.where[:MOST_FINDINGS]
    items = [
        f"<li>{escape(f'{one.signal}: {one.text}')} <span class=quiet>({escape(words.p_value(one.p_value))})</span></li>"
        for one in found
    ]
    out.append(f"<ul>{''.join(items)}</ul>" if items else paragraph("No place departs from the baseline."))
    if len(diagnosis.where) > MOST_FINDINGS:
        out.append(paragraph(f"And {len(diagnosis.where) - MOST_FINDINGS} more, in the JSON result.", "quiet"))
    out += [shown(picture) for picture in _where_pictures(diagnosis)]
    return "".join(out)


def _where_pictures(diagnosis: Diagnosis) -> Iterator[Picture]:
    statistics, residuals = diagnosis.details.statistics, diagnosis.details.residuals
    if not statistics.empty:
        marked = int(figures.significant(statistics).sum())
        worst = statistics.iloc[int(statistics["p_value"].to_numpy().argmin())]
        yield Picture(
            "map",
            lambda: figures.statistics_figure(statistics),
            f"Map of {len(statistics)} tests by interval, axis and phase; {marked} are significant. The strongest: "
            f"{worst['interval']}, axis {worst['axis']}, {worst['phase']}, {words.p_value(float(worst['p_value']))}.",
            "How far each part of the recording departs from the baseline: the stronger its colour, the further. A star marks "
            "what is significant among all these tests (about 5 % of the stars may be chance). Grey: no data to test.",
        )
    if not residuals.empty:
        count, shown = (
            residuals["interval"].nunique(),
            len(figures.most_telling(residuals, figures.in_sigma(residuals), figures.MOST_PANELS)),
        )
        subset = "" if shown == count else f" The {shown} of {count} intervals with the largest residuals."
        after = ", and blue with the causes in the model" if figures.differs(residuals) else ""
        before, left = (figures.in_sigma(residuals, when).max() for when in ("before", "after"))
        yield Picture(
            "residuals",
            lambda: figures.residual_figure(residuals),
            f"Attitude residuals of {count} intervals about x, y and z against time, with the baseline's band; the largest is "
            f"{before:.1f} sigma before and {left:.1f} after.{subset}",
            f"Orange: what is left of each reference attitude after the baseline's own fit{after}. In the grey band is what "
            f"the baseline allows.{subset}",
        )


def _sensors(diagnosis: Diagnosis) -> str:
    sensors = diagnosis.sensors
    if sensors is None:
        return ""
    out = [heading("Sun and Earth sensors"), *(paragraph(sentence) for sentence in sensor_words.sentences(diagnosis))]
    titles = {"before_deg": "nominal sensors", "after_deg": "with the causes"}
    if not sensors.causes:
        titles.pop("after_deg")
    for name in ("DSS-1", "DSS-2"):
        own = sensors.residuals[sensors.residuals["sensor"] == name]
        if own.empty:
            continue
        rms = [f"{np.sqrt(np.nanmean(own[key] ** 2)):.3g} deg RMS, {title}" for key, title in titles.items()]
        picture = Picture(
            f"sensor-{name.lower()}",
            partial(sensor_figures.sun_residual_figure, sensors.residuals, name, titles),
            f"Residuals of {name} over the Sun's two angles: {'; '.join(rms)}.",
            "Measured minus predicted by each arc's own attitude and gyro bias; noise and the gyro's random walk leave a "
            "band about zero, the same everywhere in the field of view.",
        )
        out.append(shown(picture))
    return "".join(out)


def _explanations(diagnosis: Diagnosis) -> str:
    table = diagnosis.details.explanations
    if table.empty:
        return ""
    best = table.iloc[int(table["probability"].to_numpy().argmax())]
    likeliest = words.together(str(best["effects"]).split(" + ") if best["effects"] else [])
    picture = Picture(
        "evidence",
        lambda: figures.evidence_figure(table),
        f"Bars of probability and log evidence of {min(len(table), figures.MOST_ROWS)} explanations; the likeliest: "
        f"{likeliest}, {words.percent(float(best['probability']))}.",
        "Log evidence counts in natural units: 3 more is about 20 times as likely. It is averaged over all plausible sizes, so "
        "that an explanation does not win by having more parameters. Hatched bars contain something that is on no list.",
    )
    unknown = words.percent(diagnosis.unknown_probability)
    text = paragraph(f"Something that is not on the list is at work with a probability of {unknown}.")
    return heading("The explanations that were compared") + text + shown(picture)


BODY = "; taken for a motion of the body, not for a fault"  # said of lines that are no vibration


def _stream(diagnosis: Diagnosis) -> str:
    table = diagnosis.details.stream
    if table.empty:
        return ""
    ordered = table.sort_values("p_value", kind="stable")
    shown = ordered.head(MOST_STREAM_TESTS)
    vibrating = {one.axis for one in diagnosis.where if one.statistic in (PICKUP, BIAS)}
    moving = (shown["statistic"] == "strongest_line") & ~shown["axis"].isin(vibrating)
    rows = pd.DataFrame(
        {
            "test": [str(name).replace("_", " ") for name in shown["statistic"]],
            "axis": ["all" if pd.isna(axis) else str(axis) for axis in shown["axis"]],
            "found": [tables.number(value) for value in shown["value"]],
            "baseline": [tables.number(value) for value in shown["expected"]],
            "chance": [words.p_value(p) for p in shown["p_value"]],
            "what": [f"{text}{BODY if own else ''}" for text, own in zip(shown["text"], moving, strict=True)],
        }
    )
    strong = ((shown["p_value"] * len(table) < 0.01) & ~moving).reset_index(drop=True)
    note = "The samples of the gyro, without the references. Bold: less than 1 % chance, all these tests counted."
    if len(ordered) > len(shown):
        note += f" The {len(shown)} least likely of {len(ordered)}."
    return heading("The gyro stream") + paragraph(note) + table_of(rows, strong, ["found", "baseline"])


def _limits(diagnosis: Diagnosis) -> str:
    notes = [*diagnosis.notes, words.ALWAYS_HIDDEN]
    for cause in diagnosis.causes:
        others = [words.label(member) for member in cause.group if member != cause.label]
        if others:
            notes.append(f"Whether it is {words.listed([cause.label, *others], 'or')}: here they leave nearly the same trace.")
    return heading("Limits of this recording") + "<ul>" + "".join(f"<li>{escape(note)}</li>" for note in notes) + "</ul>"


def _glossary(diagnosis: Diagnosis) -> str:
    terms = [(name, words.meaning(name)) for name in words.mentioned(diagnosis)]
    entries = "".join(f"<dt><code>{escape(name)}</code></dt><dd>{escape(text)}</dd>" for name, text in terms)
    fixed = {
        "baseline": "The simulator M0: constant G and b, white gyro noise and white reference noise as stated.",
        "gap": "Anything in the recording that the baseline cannot produce.",
        "sign": "A positive size makes the gyro read high; b has the opposite sign, since it is added to the reading.",
        "probability": "Given that the truth is one of the explanations compared, the unlisted ones included.",
        "sigma": "One standard deviation.",
    }
    entries += "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in fixed.items())
    return heading("Words") + f"<dl>{entries}</dl>"
