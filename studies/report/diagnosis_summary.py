"""What ``gyrocal diagnose`` prints: the verdict first, then where, which, how far it closes, and what it changes."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from rich.console import Console

from diagnosis.answer import Cause
from diagnosis.result import Diagnosis
from studies.report import diagnosis_words as words
from studies.report import gap_budget, tables

MOST_SUMMARY_FINDINGS = 4
MOST_ALTERNATIVES = 4


def show(console: Console, diagnosis: Diagnosis) -> None:
    """Print the whole summary."""
    _print(console, format_answer_lines(diagnosis))
    if words.is_calibration_changed(diagnosis):
        console.print()
        note = "ω = G ω_raw + b: values of G have no unit, those of b are in deg/h; change and sigma are in the unit shown"
        tables.print_table(console, "Calibration", words.tabulate_calibration_change(diagnosis), note)
    _print(console, format_closing_lines(diagnosis))


def _print(console: Console, shown: list[str]) -> None:
    """Lines as they are: a colon before and after a letter is no emoji. Folded where there is a width to fold to."""
    for line in shown:
        hang = " " * (len(line) - len(line.lstrip(" -")))
        folded = line if console.soft_wrap else textwrap.fill(line, console.width, subsequent_indent=hang)
        console.print(folded, highlight=False, markup=False, emoji=False)


def format_answer_lines(diagnosis: Diagnosis) -> list[str]:
    """Everything above the table of the calibration."""
    closed = diagnosis.closure
    closure = words.explain_missing_closure(diagnosis) if closed is None else words.describe_closure(closed)
    out = [f"{diagnosis.recording}: {words.describe_verdict(diagnosis)}", words.describe_gap_test(diagnosis)]
    for title, part in (
        ("Where it departs from the baseline, strongest test first", _format_places(diagnosis)),
        (
            "Cause" if len(diagnosis.causes) == 1 else "Causes",
            (line for one in diagnosis.causes for line in _format_cause(one, diagnosis)),
        ),
        ("Other explanations", _format_alternatives(diagnosis)),
        ("How far the gap closes", iter([closure])),
        ("Gap budget on held-out data", _format_budget(diagnosis)),
        ("Raw tables of sun and Earth sensors", (f"- {sentence}" for sentence in words.describe_sensors(diagnosis))),
        ("Effect on the calibration", iter([words.describe_calibration_change(diagnosis)])),
    ):
        body = [f"  {line}" for line in part]
        if body:
            out += ["", title, *body]
    return out


def format_closing_lines(diagnosis: Diagnosis) -> list[str]:
    """The limits of the recording, and the time it took."""
    out = ["", "Limits of this recording"]
    out += [f"  - {note}" for note in (*diagnosis.notes, words.ALWAYS_HIDDEN)]
    return [*out, "", f"Took {diagnosis.runtime_s:.1f} s."]


def _format_places(diagnosis: Diagnosis) -> Iterator[str]:
    for finding in diagnosis.where[:MOST_SUMMARY_FINDINGS]:
        yield f"- {finding.signal}: {finding.text} ({words.format_p_value(finding.p_value)})"
    more = len(diagnosis.where) - MOST_SUMMARY_FINDINGS
    if more > 0:
        yield f"and {more} more, in what --json writes under 'where'"


def _format_cause(cause: Cause, diagnosis: Diagnosis) -> Iterator[str]:
    yield "; ".join([f"- {cause.label}: {words.format_cause_size(cause)}", *words.describe_parameters(cause, diagnosis)])
    yield f"  {words.describe_probability(cause)}"
    yield f"  {words.explain_effect(cause.effect)}"


def _format_alternatives(diagnosis: Diagnosis) -> Iterator[str]:
    for effects, probability in diagnosis.alternatives[:MOST_ALTERNATIVES]:
        yield f"- {words.join_effects(effects)}: {words.format_percent(probability)}"
    if diagnosis.verdict != "none":
        yield f"- in all, with some effect that is not on the list: {words.format_percent(diagnosis.unknown_probability)}"


def _format_budget(diagnosis: Diagnosis) -> Iterator[str]:
    for step in diagnosis.budget:
        share = "" if step.closed is None else f"  {100 * step.closed:5.0f} %"
        yield f"{gap_budget.name_step(step):32s}{step.misfit:9.3g}{share}"
    yield from (f"- {sentence}" for sentence in gap_budget.describe(diagnosis))
