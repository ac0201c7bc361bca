"""A comparison as one page for the terminal and the browser."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.compare.compare import Comparison, ScenarioComparison
from studies.report.pages import Answer, Page, PageTable, Picture, ProvenanceFooter, Section
from studies.report.panels import GREY, RED, TEAL, Panel, draw_panels
from studies.report.tables import format_interval

SHOWN_STATISTICS = 12  # of a scenario on the terminal
EXTREME_Z = 3.0
HOW = (
    "The gap is the mean square of the whitened residuals minus its mean over the scenario's simulations. Noise as stated has "
    "the mean square 1. The gap is zero if the scenario is right, and holds for a new recording. Intervals are of 90 %."
)
WHERE = (
    "percentile: share of the simulations below the recording, ties counted half; z: distance from their mean, in their "
    "standard deviations."
)


def build_comparison_page(comparison: Comparison, provenance: ProvenanceFooter | None = None) -> Page:
    """Build the page: the gaps, then the statistics of each scenario, the furthest from the simulations' mean first."""
    picture = Picture(
        "standing",
        lambda: draw_standings(comparison),
        "Distance of every statistic of the recording from the mean of the simulations, by scenario.",
        "A dot is a statistic; if the scenario is right, 95 % are within two.",
    )
    first, *further = describe_comparison(comparison)
    gaps = f"The gap, {comparison.runs} simulations of each scenario, seed {comparison.seed}"
    sections = [Section("", further), Section("The gap", [PageTable(build_scenario_table(comparison), (), gaps, HOW)])]
    sections.append(Section("The recording among the simulations", []))
    for standing in comparison.standings:
        table = build_statistics_table(standing)
        strong = [abs(float(z)) > EXTREME_Z for z in table["z"]]
        title = f"Under {standing.name}: {standing.title}"
        sections.append(Section(title, [PageTable(table, strong, title, WHERE, SHOWN_STATISTICS)], 3))
    answer = Answer(determine_answer_kind(comparison), picture, first)
    return Page(f"{comparison.recording} beside its scenarios", sections, answer, provenance)


def build_scenario_table(comparison: Comparison) -> pd.DataFrame:
    """Build a row for each scenario, as texts."""
    rows = []
    for standing in comparison.standings:
        gap, samples, (count, judged) = standing.gap, standing.samples, standing.extreme
        shrinkage = "" if standing is comparison.standings[0] else "no gap before"
        if shrinkage and np.isfinite(gap.shrinkage_90).all():
            shrinkage = format_interval(gap.shrinkage, gap.shrinkage_90, 100, ".0f", " %")
        rows.append(
            {
                "scenario": standing.name,
                "effects": ", ".join(standing.effects) or "none",
                "gap": format_interval(gap.after, gap.after_90),
                "shrinkage": shrinkage,
                "gap of the samples": "" if samples is None else format_interval(samples.after, samples.after_90),
                "beyond 1 % at either end": f"{count} of {judged}",
            }
        )
    return pd.DataFrame(rows)


def build_statistics_table(standing: ScenarioComparison) -> pd.DataFrame:
    """Build the judged statistics as texts, the furthest from the simulations' mean first."""
    judged = standing.statistics.assign(name=standing.names)
    judged = judged[judged["judged"]]
    judged = judged.iloc[np.argsort(-judged["z"].abs().to_numpy(), kind="stable")]
    ranges = zip(judged["p05"], judged["p95"], strict=True)
    return pd.DataFrame(
        {
            "statistic": judged["name"].to_numpy(),
            "unit": judged["unit"].to_numpy(),
            "recording": [f"{value:.4g}" for value in judged["recording"]],
            "simulations, 5 to 95 %": [f"{low:.4g} to {high:.4g}" for low, high in ranges],
            "percentile": [f"{100 * value:.1f}" for value in judged["percentile"]],
            "z": [f"{value:+.1f}" for value in judged["z"]],
        }
    )


def describe_comparison(comparison: Comparison) -> list[str]:
    """Summarise the comparison in sentences."""
    out = []
    baseline = comparison.standings[0].gap
    if baseline.before_90[0] <= 0 <= baseline.before_90[1]:
        deviations = "; single statistics deviate, which a diagnosis tests as well" if determine_answer_kind(comparison) else ""
        out.append(f"Under M0 the interval of the gap includes zero: the attitude's mean square shows no gap{deviations}.")
    out += [_describe_furthest(standing) for standing in comparison.standings]
    for standing in comparison.standings[1:]:
        gap, change = standing.gap, "the reduction of the gap is not known, since the attitude has no significant gap under M0"
        if np.isfinite(gap.shrinkage_90).all():
            change = f"the gap shrinks by {format_interval(gap.shrinkage, gap.shrinkage_90, 100, '.0f', ' %')}, 90 % interval"
        fitted = "; its sizes were fitted to this recording, and are fitted anew to each simulation"
        out.append(f"With {standing.name}: {change}{fitted if standing.fitted and standing.effects else ''}.")
    return out


def _describe_furthest(standing: ScenarioComparison) -> str:
    """State the number of extreme statistics, the number expected by chance, and the largest deviation."""
    (count, total), judged = standing.extreme, build_statistics_table(standing)
    expected = f"{standing.expected_extreme:.1f} are expected by chance"
    text = f"Under {standing.name} {count} of {total} statistics are beyond 1 % at either end; {expected}."
    return f"{text} The largest deviation is {judged['statistic'].iloc[0]}, z = {judged['z'].iloc[0]}." if len(judged) else text


def determine_answer_kind(comparison: Comparison) -> str:
    """Determine the kind of the answer: a gap, none, or single deviating statistics although there is no gap."""
    first = comparison.standings[0]
    if first.gap.before_90[0] > 0:
        return "gap"
    judged = first.statistics[first.statistics["judged"]]
    return "open" if (judged["z"].abs() > EXTREME_Z).any() else ""


def draw_standings(comparison: Comparison) -> Figure:
    """Draw the distance of each statistic from the mean of the simulations, a panel a scenario."""
    panels = [_build_panel(standing) for standing in comparison.standings]
    return draw_panels(*panels, size=(8, 2.6 * len(panels)), columns=1)


def _build_panel(standing: ScenarioComparison) -> Panel:
    """Build the panel of z of the judged statistics of a scenario, a row a kind of statistic."""
    judged = standing.statistics[standing.statistics["judged"]]
    kinds = list(dict.fromkeys(judged["statistic"]))

    def draw(axes: Axes) -> None:
        rows = [kinds.index(kind) for kind in judged["statistic"]]
        z = judged["z"].to_numpy()
        axes.axvspan(-2, 2, color=GREY, alpha=0.2, linewidth=0)
        axes.scatter(z, rows, s=12, c=np.where(np.abs(z) > EXTREME_Z, RED, TEAL))

    return Panel(draw, standing.name, "z of the recording among the simulations", rows=kinds)
