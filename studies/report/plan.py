"""A plan as effect page: smallest visible sizes, inseparable pairs, extra maneuvers."""

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


def build_plan_page(plan: Plan, provenance: ProvenanceFooter | None = None) -> Page:
    """Build the page."""
    size_note = (
        f"An effect of this size is detected with probability {SETTINGS.power:.0%}, at a false-alarm rate of "
        f"{plan.false_alarm_rate:.1%}. size: at a typical time and phase; best, worst: at the most and the least favourable "
        "ones. A range is over the axes."
    )
    pairs: Item = f"None at a signal-to-noise ratio of {SETTINGS.limit_snr:g}."
    if plan.pairs:
        pairs = PageTable(build_pairs_table(plan), (), PAIRS, SHARE_NOTE, SHOWN_PAIRS)
    sizes = PageTable(build_effects_table(plan.effects), (), "Smallest visible size", size_note)
    sections = [Section("Smallest visible size", [sizes]), Section("Inseparable pairs", [pairs])]
    if plan.extras:
        sections.append(Section(EXTRAS, [PageTable(build_extras_table(plan.extras), (), EXTRAS, RATIO_NOTE)]))
    sections.append(Section("Limits of this scenario", [[f"{note}." for note in plan.notes]]))
    return Page(format_headline(plan), sections, None, provenance, f"Plan of {plan.scenario}")


def format_headline(plan: Plan) -> str:
    """Count the visible effects and the inseparable pairs, and name the best extra maneuvers."""
    is_visible = {effect.effect: False for effect in plan.effects}
    is_visible |= {effect.effect: True for effect in plan.effects if effect.verdict == "visible"}
    count = len(plan.list_unordered_pairs())
    pairs = f"{count} pair{'' if count == 1 else 's'}"
    hidden = [effect.label for effect in plan.effects if is_visible[effect.effect] and effect.verdict != "visible"]
    further = f" and {len(hidden) - MOST_HIDDEN} more" if len(hidden) > MOST_HIDDEN else ""
    exceptions = f" (but not {', '.join(hidden[:MOST_HIDDEN])}{further})" if hidden else ""
    text = f"{sum(is_visible.values())} of {len(is_visible)} effects can be seen{exceptions}, {pairs} cannot be separated"
    if plan.extras and plan.extras[0].ratio < 1:
        text += f"; the most helpful extra maneuver is: {plan.extras[0].name}"
    resolving = max(plan.extras, key=lambda extra: len(extra.resolved), default=None)
    if resolving is not None and resolving.resolved and resolving is not plan.extras[0]:
        text += f"; most pairs are separated by: {resolving.name}"
    return text


def build_effects_table(effects: tuple[Visible, ...]) -> pd.DataFrame:
    """Build a row for each effect and axis; axes with the same words and sizes within a tenth share a row."""
    rows = []
    for group in _group_alike(effects):
        first = group[0]
        finite = any(np.isfinite(effect.size) for effect in group)
        varies = any(effect.best < effect.worst for effect in group)
        rows.append(
            {
                "effect": first.label
                if len(group) == 1
                else f"{first.effect}:{''.join(effect.axis or '' for effect in group)}",
                "size": _format_size(group, "size") if finite else VERDICT_WORDS[first.verdict],
                "best": _format_size(group, "best") if varies else "",
                "worst": _format_size(group, "worst") if varies else "",
                "unit": first.unit,
                "remark": first.text,
            }
        )
    return pd.DataFrame(rows)


def _group_alike(effects: tuple[Visible, ...]) -> list[list[Visible]]:
    """Group consecutive axes of an effect that share a row."""
    groups: list[list[Visible]] = []
    for effect in effects:
        last = groups[-1] if groups else []
        if (
            last
            and (last[0].effect, last[0].verdict, last[0].text) == (effect.effect, effect.verdict, effect.text)
            and "<" not in effect.label
            and (effect.size == last[0].size or abs(effect.size - last[0].size) <= 0.1 * last[0].size)
        ):
            last.append(effect)
        else:
            groups.append([effect])
    return groups


def _format_size(group: list[Visible], name: str) -> str:
    """Format a size of the effects of a group, "size", "best" or "worst", as a number or a range."""
    values = [getattr(effect, name) for effect in group]
    if not np.isfinite(values).all():
        return tables.NO_VALUE
    low, high = (f"{value:.3g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def build_pairs_table(plan: Plan) -> pd.DataFrame:
    """Build a row for each effect that is mistaken for another."""
    effects = {effect.label: effect for effect in plan.effects}
    return pd.DataFrame(
        [
            {
                "effect": pair.effect,
                "mistaken for": pair.other,
                "share": tables.NO_VALUE if pd.isna(pair.share) else _format_share(pair.share),
                "SNR to separate": "never" if pair.snr == float("inf") else tables.format_number(float(f"{pair.snr:.3g}")),
                "size to separate": _format_separating_size(pair, effects.get(pair.effect)),
            }
            for pair in plan.pairs
        ]
    )


def _format_separating_size(pair: Pair, effect: Visible | None) -> str:
    """Format the size that separates a pair, in its unit, and whether it is plausible."""
    if pair.size == float("inf"):
        return "never"
    if effect is None:
        return f"{pair.size:.3g}"
    return f"{pair.size:.3g} {effect.unit}{' (not plausible)' if pair.size > effect.plausible[1] else ''}"


def _format_share(value: float) -> str:
    return "100 %" if value > 1 - 1e-7 else f"{min(100 * value, 99.999):.3f} %"


def build_extras_table(extras: tuple[Extra, ...]) -> pd.DataFrame:
    """Build a row for each maneuver, the most helpful first."""
    rows = []
    for extra in extras:
        best = sorted(extra.by_effect.items(), key=lambda item: item[1])[:2]
        rows.append(
            {
                "maneuver": extra.name,
                "hours": f"{extra.hours:.2f}",
                "ratio": f"{extra.ratio:.2f}",
                "pairs separated": f"{len(extra.resolved)} of {extra.pairs}",
                "helps most": ", ".join(f"{label} {value:.2g}" for label, value in best if value < 0.99),
                "makes visible": ", ".join(extra.gained),
            }
        )
    return pd.DataFrame(rows)
