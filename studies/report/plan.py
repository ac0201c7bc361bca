"""A plan as one page: smallest visible sizes, inseparable pairs, extra maneuvers."""

import numpy as np
import pandas as pd

from diagnosis.plan.result import SETTINGS, Extra, Pair, Plan, Visible
from studies.report import tables
from studies.report.pages import Item, Page, PageTable, ProvenanceFooter, Section

SHOWN_PAIRS = 25  # on the terminal
MOST_HIDDEN = 3  # labels named in the headline
PAIRS = f"Pairs that cannot be separated below a signal-to-noise ratio of {SETTINGS.limit_snr:g}"
SHARE_NOTE = "Share: part of the first one's signature that the second can reproduce."
EXTRAS = "Extra maneuvers"
RATIO_NOTE = "Ratio: smallest visible size with the maneuver over that without it, median over effects; 0.5 is twice as good."
VERDICT_WORDS = {
    "not identifiable": "never",
    "implausible": "never",
    "not available": "not testable",
    "visible": tables.NO_VALUE,
}


def build_plan_page(found: Plan, made: ProvenanceFooter | None = None) -> Page:
    """Build the page."""
    size_note = (
        f"An effect of this size is detected with probability {SETTINGS.power:.0%}, at a false-alarm rate of "
        f"{found.false_alarm_rate:.1%}. size: at a typical time and phase; best, worst: at the most and the least favourable "
        "ones. A range is over the axes."
    )
    pairs: Item = f"None at a signal-to-noise ratio of {SETTINGS.limit_snr:g}."
    if found.pairs:
        pairs = PageTable(build_pairs_table(found), (), PAIRS, SHARE_NOTE, SHOWN_PAIRS)
    sizes = PageTable(build_effects_table(found.effects), (), "Smallest visible size", size_note)
    sections = [Section("Smallest visible size", [sizes]), Section("Inseparable pairs", [pairs])]
    if found.extras:
        sections.append(Section(EXTRAS, [PageTable(build_extras_table(found.extras), (), EXTRAS, RATIO_NOTE)]))
    sections.append(Section("Limits of this scenario", [[f"{note}." for note in found.notes]]))
    return Page(format_headline(found), sections, None, made, f"Plan of {found.scenario}")


def format_headline(found: Plan) -> str:
    """Count the visible effects and the inseparable pairs, and name the best extra maneuvers."""
    by_effect = {one.effect: False for one in found.effects}
    by_effect |= {one.effect: True for one in found.effects if one.verdict == "visible"}
    count = len(found.list_unordered_pairs())
    pairs = f"{count} pair{'' if count == 1 else 's'}"
    hidden = [one.label for one in found.effects if by_effect[one.effect] and one.verdict != "visible"]
    more = f" and {len(hidden) - MOST_HIDDEN} more" if len(hidden) > MOST_HIDDEN else ""
    but = f" (but not {', '.join(hidden[:MOST_HIDDEN])}{more})" if hidden else ""
    text = f"{sum(by_effect.values())} of {len(by_effect)} effects can be seen{but}, {pairs} cannot be separated"
    if found.extras and found.extras[0].ratio < 1:
        text += f"; the most helpful extra maneuver is: {found.extras[0].name}"
    resolving = max(found.extras, key=lambda one: len(one.resolved), default=None)
    if resolving is not None and resolving.resolved and resolving is not found.extras[0]:
        text += f"; most pairs are separated by: {resolving.name}"
    return text


def build_effects_table(effects: tuple[Visible, ...]) -> pd.DataFrame:
    """A row for each effect and axis; axes that are alike in words and within a tenth share one."""
    rows = []
    for group in _group_alike(effects):
        first = group[0]
        finite = any(np.isfinite(one.size) for one in group)
        varies = any(one.best < one.worst for one in group)
        rows.append(
            {
                "effect": first.label if len(group) == 1 else f"{first.effect}:{''.join(one.axis or '' for one in group)}",
                "size": _format_size(group, "size") if finite else VERDICT_WORDS[first.verdict],
                "best": _format_size(group, "best") if varies else "",
                "worst": _format_size(group, "worst") if varies else "",
                "unit": first.unit,
                "remark": first.text,
            }
        )
    return pd.DataFrame(rows)


def _group_alike(effects: tuple[Visible, ...]) -> list[list[Visible]]:
    """Runs of axes of an effect that make one row."""
    groups: list[list[Visible]] = []
    for one in effects:
        last = groups[-1] if groups else []
        if (
            last
            and (last[0].effect, last[0].verdict, last[0].text) == (one.effect, one.verdict, one.text)
            and "<" not in one.label
            and (one.size == last[0].size or abs(one.size - last[0].size) <= 0.1 * last[0].size)
        ):
            last.append(one)
        else:
            groups.append([one])
    return groups


def _format_size(group: list[Visible], name: str) -> str:
    values = [getattr(one, name) for one in group]
    if not np.isfinite(values).all():
        return tables.NO_VALUE
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def build_pairs_table(found: Plan) -> pd.DataFrame:
    """A row for each effect that is mistaken for another."""
    known = {one.label: one for one in found.effects}
    return pd.DataFrame(
        [
            {
                "effect": one.effect,
                "mistaken for": one.other,
                "share": tables.NO_VALUE if pd.isna(one.share) else _format_share(one.share),
                "SNR to separate": "never" if one.snr == float("inf") else tables.format_number(float(f"{one.snr:.3g}")),
                "size to separate": _format_separating_size(one, known.get(one.effect)),
            }
            for one in found.pairs
        ]
    )


def _format_separating_size(pair: Pair, effect: Visible | None) -> str:
    """Size that separates a pair, in its unit, and whether it is a plausible one."""
    if pair.size == float("inf"):
        return "never"
    if effect is None:
        return f"{pair.size:.3g}"
    return f"{pair.size:.3g} {effect.unit}{' (not plausible)' if pair.size > effect.plausible[1] else ''}"


def _format_share(value: float) -> str:
    return "100 %" if value > 1 - 1e-7 else f"{min(100 * value, 99.999):.3f} %"


def build_extras_table(extras: tuple[Extra, ...]) -> pd.DataFrame:
    """A row for each maneuver, the most helpful first."""
    rows = []
    for one in extras:
        best = sorted(one.by_effect.items(), key=lambda item: item[1])[:2]
        rows.append(
            {
                "maneuver": one.name,
                "hours": f"{one.hours:.2f}",
                "ratio": f"{one.ratio:.2f}",
                "pairs separated": f"{len(one.resolved)} of {one.pairs}",
                "helps most": ", ".join(f"{label} {value:.2g}" for label, value in best if value < 0.99),
                "makes visible": ", ".join(one.gained),
            }
        )
    return pd.DataFrame(rows)
