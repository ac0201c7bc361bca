"""The report of the test world: rates, statements, rankings, sizes and sets, over plans and grades."""

from __future__ import annotations

import pandas as pd

from diagnosis.settings import DEFAULT
from studies.report.entry import Entry, Report
from studies.report.panels import GREY, TEAL, Draw, Line, curves, sheet
from studies.report.tables import Table
from studies.validation.world import score
from studies.validation.world.answers import OUTCOMES
from studies.validation.world.cases import ORDER
from studies.validation.world.study import STUDY, WorldConfig

SHOWN = ["case", "kind", "plan", "grade", "samples", "references", "effects", "snr", "outcome", "said", "probability"]
GROUPS = {"plan": "kind of plan", "grade": "grade of the gyro and the references"}


def counts(rows: pd.DataFrame) -> pd.DataFrame:
    """Cases of each kind by outcome."""
    table = pd.crosstab(rows["kind"], rows["outcome"]).reindex(index=list(ORDER), columns=list(OUTCOMES), fill_value=0)
    table.insert(0, "cases", table.sum(axis=1))
    return table.rename_axis(columns=None).reset_index()


def report(config: WorldConfig, rows: pd.DataFrame) -> Report:
    """Tables, figures and criteria."""
    seconds = [
        {"what": what, "median_s": rows[name].median(), "largest_s": rows[name].max(), "all_s": rows[name].sum()}
        for what, name in (("drawing a case and its recording", "make_s"), ("its diagnosis", "diagnose_s"))
    ]
    wrong = rows[~score.is_good(rows)]
    tables = {
        "counts": Table("Outcomes by kind", counts(rows)),
        "rates": Table("Rates, with 95 % binomial intervals", score.rates(rows)),
        "mixed_rates": Table("Mixed recordings: what is stated beside a remainder", score.mixed_rates(rows)),
        "scores": Table("Scores of statements and rankings", score.summary(rows)),
        "reliability": Table(
            "Probability stated of causes, and how often they were there", score.reliability(score.statements(rows))
        ),
        "sizes": Table("Sizes within their sigmas", score.size_table(rows)),
        "sets": Table("Conformal sets of explanations", score.set_coverage(rows, DEFAULT.conformal)),
        **{
            name: Table(f"Right answers by {title}", score.by_group(rows, name).drop(columns="count"))
            for name, title in GROUPS.items()
        },
        "run_time": Table("Processor time of a case", pd.DataFrame(seconds)),
        "misses": Table("What is not as it should be, case by case", wrong[[*SHOWN, "unknown_probability"]]),
    }
    return Report(tables, {"answers": answers_figure(rows)}, checks=score.checks(rows, DEFAULT.conformal))


def answers_figure(rows: pd.DataFrame) -> Draw:
    """Draw the stated probabilities against how often the cause was there."""
    stated = score.reliability(score.statements(rows))
    found = Line(stated["stated"], stated["there"], "", TEAL, "o", stated["low"], stated["high"], bars=True)
    panel = curves([Line([0, 1], [0, 1], "", GREY, "-"), found], x="probability stated", y="share that was there, 95 %")
    return sheet(panel, size=(4.2, 3.8))


ENTRY = Entry(STUDY, "is the diagnosis right about craft, gyros, references and effects of all kinds", report)
