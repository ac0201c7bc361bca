"""The report of the wide check: rates, statements, rankings, sizes and sets, over plans, grades and families."""

from __future__ import annotations

import pandas as pd

from diagnosis.settings import DEFAULT
from studies.report.entry import Entry, Report
from studies.report.panels import GREY, RED, TEAL, Draw, Line, curves, sheet
from studies.report.tables import Table
from studies.validation.wide import score
from studies.validation.wide.cases import ORDER
from studies.validation.wide.study import OUTCOMES, STUDY, WideConfig

SHOWN = ["case", "kind", "plan", "grade", "samples", "references", "effects", "snr", "outcome", "said", "probability"]
GROUPS = {"plan": "kind of plan", "grade": "grade of the gyro and the references"}


def counts(rows: pd.DataFrame) -> pd.DataFrame:
    """Cases of each kind by outcome."""
    table = pd.crosstab(rows["kind"], rows["outcome"]).reindex(index=list(ORDER), columns=list(OUTCOMES), fill_value=0)
    table.insert(0, "cases", table.sum(axis=1))
    return table.rename_axis(columns=None).reset_index()


def report(config: WideConfig, rows: pd.DataFrame) -> Report:
    """Tables, figures and criteria."""
    seconds = [
        {"what": what, "median_s": rows[name].median(), "largest_s": rows[name].max(), "all_s": rows[name].sum()}
        for what, name in (("drawing a case and its recording", "make_s"), ("its diagnosis", "diagnose_s"))
    ]
    wrong = rows[~rows["outcome"].isin(["right", "group"]) & ~((rows["kind"] == "unlisted") & (rows["outcome"] == "unknown"))]
    tables = {
        "counts": Table("Outcomes by kind", counts(rows)),
        "rates": Table("Rates, with 95 % binomial intervals", score.rates(rows)),
        "scores": Table("Scores of statements and rankings", score.summary(rows)),
        "reliability": Table(
            "Probability stated of causes, and how often they were there", score.reliability(score.statements(rows))
        ),
        "missed": Table("Effects missed at 1 % false alarms, over the SNR", score.missed_by_snr(rows)),
        "sizes": Table("Sizes within their sigmas", score.size_table(rows)),
        "sets": Table("Conformal sets of explanations", score.set_coverage(rows, DEFAULT.conformal)),
        **{name: Table(f"Right answers by {title}", score.by_group(rows, name)) for name, title in GROUPS.items()},
        "run_time": Table("Processor time of a case", pd.DataFrame(seconds)),
        "misses": Table("What is not as it should be, case by case", wrong[[*SHOWN, "unknown_probability"]]),
    }
    return Report(tables, {"answers": answers_figure(rows)}, checks=score.checks(rows, DEFAULT.conformal))


def answers_figure(rows: pd.DataFrame) -> Draw:
    """Reliability of the stated probabilities, detection and unknown as rankings, and risk against coverage."""
    stated = score.reliability(score.statements(rows))
    found, none = score.detection_scores(rows), (rows["kind"] == "none").to_numpy()
    unlisted, listed, _ = score.unknown_scores(rows)
    detection, unknown = score.roc(found[~none], found[none]), score.roc(unlisted, listed)
    risk = score.risk_coverage(rows)
    diagonal = Line([0, 1], [0, 1], "", GREY, "-")
    return sheet(
        curves(
            [diagonal, Line(stated["stated"], stated["there"], "", TEAL, "o", stated["low"], stated["high"], bars=True)],
            title="causes", x="probability stated", y="share that was there, 95 %",
        ),
        curves(
            [
                diagonal,
                Line(detection["false_positive"], detection["true_positive"], "an effect", TEAL, "-"),
                Line(unknown["false_positive"], unknown["true_positive"], "an unlisted one", RED, "--"),
            ],
            title="told by their scores", x="false positive rate", y="true positive rate", legend="lower right",
        ),
        curves(
            [Line(risk["coverage"], risk["risk"], "", TEAL, "-")],
            title="the surest answers", x="share of the gaps that is answered", y="share of wrong answers among them",
        ),
        size=(9.0, 3.2),
    )  # fmt: skip


ENTRY = Entry(STUDY, "is the diagnosis right about craft, gyros and effects that it was not made for", report)
