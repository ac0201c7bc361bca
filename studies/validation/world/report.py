"""The report of the test world: rates, statements, rankings, sizes and sets, over plans and grades."""

from __future__ import annotations

import pandas as pd

from diagnosis.settings import DEFAULT
from studies.report.entry import Entry, Report
from studies.report.panels import GREY, TEAL, Draw, Line, build_sheet, make_curves
from studies.report.tables import Table
from studies.validation.world import score
from studies.validation.world.answers import OUTCOMES
from studies.validation.world.cases import KIND_ORDER
from studies.validation.world.study import STUDY, WorldConfig

SHOWN_COLUMNS = ["case", "kind", "plan", "grade", "samples", "references", "effects", "snr", "outcome", "said", "probability"]
CASE_GROUPINGS = {"plan": "kind of plan", "grade": "grade of the gyro and the references"}


def count_outcomes(rows: pd.DataFrame) -> pd.DataFrame:
    """Cases of each kind by outcome."""
    table = pd.crosstab(rows["kind"], rows["outcome"]).reindex(index=list(KIND_ORDER), columns=list(OUTCOMES), fill_value=0)
    table.insert(0, "cases", table.sum(axis=1))
    return table.rename_axis(columns=None).reset_index()


def report(config: WorldConfig, rows: pd.DataFrame) -> Report:
    """Tables, figures and criteria."""
    seconds = [
        {"what": what, "median_s": rows[name].median(), "largest_s": rows[name].max(), "all_s": rows[name].sum()}
        for what, name in (("drawing a case and its recording", "make_s"), ("its diagnosis", "diagnose_s"))
    ]
    wrong = rows[~score.is_answered_well(rows)]
    tables = {
        "counts": Table("Outcomes by kind", count_outcomes(rows)),
        "rates": Table("Rates, with 95 % binomial intervals", score.compute_outcome_rates(rows)),
        "mixed_rates": Table("Mixed recordings: what is stated beside a remainder", score.compute_mixed_rates(rows)),
        "scores": Table("Scores of statements and rankings", score.summarise_scores(rows)),
        "reliability": Table(
            "Probability stated of causes, and how often they were there",
            score.compute_reliability(score.collect_cause_statements(rows)),
        ),
        "sizes": Table("Sizes within their sigmas", score.build_size_coverage(rows)),
        "sets": Table("Conformal sets of explanations", score.compute_set_coverage(rows, DEFAULT.conformal)),
        **{
            name: Table(f"Right answers by {title}", score.count_good_by_group(rows, name).drop(columns="count"))
            for name, title in CASE_GROUPINGS.items()
        },
        "run_time": Table("Processor time of a case", pd.DataFrame(seconds)),
        "misses": Table("What is not as it should be, case by case", wrong[[*SHOWN_COLUMNS, "unknown_probability"]]),
    }
    return Report(tables, {"answers": draw_answers_figure(rows)}, checks=score.build_world_checks(rows, DEFAULT.conformal))


def draw_answers_figure(rows: pd.DataFrame) -> Draw:
    """Draw the stated probabilities against how often the cause was there."""
    stated = score.compute_reliability(score.collect_cause_statements(rows))
    found = Line(stated["stated"], stated["there"], "", TEAL, "o", stated["low"], stated["high"], bars=True)
    panel = make_curves([Line([0, 1], [0, 1], "", GREY, "-"), found], x="probability stated", y="share that was there, 95 %")
    return build_sheet(panel, size=(4.2, 3.8))


ENTRY = Entry(STUDY, "is the diagnosis right about craft, gyros, references and effects of all kinds", report)
