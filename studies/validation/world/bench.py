"""``gyrocal bench``: a fixed set of recordings, diagnosed by two versions of the code and compared case by case.

    gyrocal bench run build/bench/before        # with the code as it is
    gyrocal bench run build/bench/after         # after a change
    gyrocal bench compare build/bench/before build/bench/after

The set changes only when the families of an exam join it: `BENCH_PARTS` are numbers of cases of each source at a fixed entropy.
A hundred of them are of the source ``fresh``, written without sight of the diagnosis; of these every table shows counts only.

McNemar's exact test compares two runs: of the recordings that only one of them answers well, both would have half.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import scipy.stats
from pydantic import model_validator

from gyrocal.errors import InputError
from studies.montecarlo.study import Study
from studies.report.checks import Check
from studies.report.entry import Entry, Report
from studies.report.tables import Table
from studies.validation.world import score
from studies.validation.world.cases import KIND_ORDER
from studies.validation.world.report import count_outcomes, draw_answers_figure
from studies.validation.world.study import INSTRUMENTS, WorldConfig, make_case_recording, run_case

FRESH = "fresh"
BENCH_PARTS = (
    ("known", 2051, 75),
    (FRESH, 2052, 100),
    ("exam/001", 2054, 25),
    (INSTRUMENTS, 2053, 42),
)  # source, entropy, cases
SUMMARY = "is the diagnosis as right as before a change, case by case"


class BenchConfig(WorldConfig):
    """The fixed set."""

    cases: int = sum(count for _, _, count in BENCH_PARTS)

    @model_validator(mode="after")
    def _refuse_changes(self) -> BenchConfig:
        default = type(self).model_fields
        fixed = all(getattr(self, name) == default[name].default for name in ("source", "entropy"))
        if not fixed or self.overrides or self.dispersions:
            raise ValueError("the bench is a fixed set: source, entropy, overrides and dispersions cannot be changed")
        return self

    def part(self, number: int) -> tuple[str, int, int]:
        """Source, entropy and number of a case within them."""
        for source, entropy, count in BENCH_PARTS:
            if number < count:
                return source, entropy, number
            number -= count
        raise InputError(f"the bench has {type(self).model_fields['cases'].default} cases")


STUDY = Study("studies.validation.world.bench:STUDY", BenchConfig, run_case, make_case_recording)


def report(config: BenchConfig, rows: pd.DataFrame) -> Report:
    """Count outcomes and rates of the whole set and of its parts; cases are shown of the known sources only."""
    good = score.is_answered_well(rows)
    known = rows[(rows["source"] != FRESH) & ~good]
    shown = ["case", "source", "kind", "plan", "grade", "effects", "snr", "outcome", "said", "probability"]
    tables = {
        "counts": Table("Outcomes by kind", count_outcomes(rows)),
        "parts": Table(
            "Answered well, by source and kind, with 95 % binomial intervals",
            score.count_good_by_group(rows, "source", sort=False),
        ),
        "rates": Table("Rates, with 95 % binomial intervals", score.compute_outcome_rates(rows)),
        "mixed_rates": Table("Mixed recordings: what is stated beside a remainder", score.compute_mixed_rates(rows)),
        "fresh_rates": Table(
            "The same of the fresh recordings alone", score.compute_outcome_rates(rows[rows["source"] == FRESH])
        ),
        "reliability": Table("Probability stated of causes", score.compute_reliability(score.collect_cause_statements(rows))),
        "sizes": Table("Sizes within their sigmas", score.build_size_coverage(rows)),
        "cost": Table("Processor time and memory of a diagnosis", summarise_cost(rows)),
        "misses": Table("Answered otherwise, known sources only", known[shown]),
    }
    checks = (
        Check("recordings answered well", float(good.mean()), None),
        Check("processor time of all diagnoses", float(rows["diagnose_s"].sum()), None, "s"),
        Check("largest peak memory of a diagnosis", float(rows["peak_mb"].max()), None, "MB"),
    )
    return Report(tables, {"answers": draw_answers_figure(rows)}, checks)


def summarise_cost(rows: pd.DataFrame) -> pd.DataFrame:
    """Summarise processor seconds and peak memory by kind."""
    groups = rows.groupby("kind", sort=False)
    out = groups.agg(
        cases=("case", "size"),
        median_s=("diagnose_s", "median"),
        largest_s=("diagnose_s", "max"),
        all_s=("diagnose_s", "sum"),
        median_mb=("peak_mb", "median"),
        largest_mb=("peak_mb", "max"),
    )
    return out.reindex([kind for kind in KIND_ORDER if kind in out.index]).reset_index()


def compare(before: pd.DataFrame, after: pd.DataFrame) -> Report:
    """Compare two runs of the bench case by case.

    Parameters
    ----------
    before, after : rows of the two runs

    Raises
    ------
    InputError
        They are not of the same recordings.
    """
    keys = ["case", "source", "kind", "effects"]
    both = before.merge(after, on=keys, suffixes=("_before", "_after"), validate="one_to_one")
    if not len(both) or len(both) != max(len(before), len(after)):
        raise InputError(f"the two runs share {len(both)} of {len(before)} and {len(after)} recordings; run both to their end")
    for part in ("before", "after"):
        both[f"good_{part}"] = score.is_answered_well(both.rename(columns={f"outcome_{part}": "outcome"}))
    kinds = [*[(kind, both[both["kind"] == kind]) for kind in KIND_ORDER], ("all", both)]
    kinds += [(f"{source}, all", both[both["source"] == source]) for source, *_ in BENCH_PARTS]
    table = pd.DataFrame([_compare_pairs(name, own) for name, own in kinds if len(own)])
    moved = both[(both["outcome_before"] != both["outcome_after"]) & (both["source"] != FRESH)]
    shown = ["case", "source", "kind", "effects", "outcome_before", "outcome_after", "said_before", "said_after"]
    total = table[table["kind"] == "all"].iloc[0]
    checks = (
        Check("recordings gained", float(total["gained"]), None),
        Check("recordings lost", float(total["lost"]), None),
        Check("McNemar's p", float(total["p"]), None),
        Check("processor time, after over before", float(total["cpu_ratio"]), None),
        Check("median peak memory, after over before", float(total["mb_ratio"]), None),
    )
    tables = {
        "paired": Table("Answered well before and after", table, PAIRED),
        "moved": Table("Outcomes that changed, known sources only", moved[shown]),
    }
    return Report(tables, checks=checks)


PAIRED = (
    "Gained and lost are recordings that only the later and only the earlier run answers well, wrong names those with a "
    "confident wrong name."
)


def _compare_pairs(name: str, both: pd.DataFrame) -> dict[str, object]:
    """Count gained and lost recordings with McNemar's exact p, and compare the cost."""
    gained = int((~both["good_before"] & both["good_after"]).sum())
    lost = int((both["good_before"] & ~both["good_after"]).sum())
    p = float(scipy.stats.binomtest(gained, gained + lost).pvalue) if gained + lost else 1.0
    seconds = [float(both[f"diagnose_s_{part}"].sum()) for part in ("before", "after")]
    memory = [float(both[f"peak_mb_{part}"].median()) for part in ("before", "after")]
    return {
        "kind": name,
        "recordings": len(both),
        "good_before": int(both["good_before"].sum()),
        "good_after": int(both["good_after"].sum()),
        "gained": gained,
        "lost": lost,
        "p": p,
        "wrong_before": int((both["outcome_before"] == "wrong name").sum()),
        "wrong_after": int((both["outcome_after"] == "wrong name").sum()),
        "cpu_s_before": seconds[0],
        "cpu_s_after": seconds[1],
        "cpu_ratio": seconds[1] / seconds[0] if seconds[0] else float("nan"),
        "mb_before": memory[0],
        "mb_after": memory[1],
        "mb_ratio": memory[1] / memory[0],
    }


def load_bench_run(folder: Path) -> pd.DataFrame:
    """Load the rows of a run.

    Raises
    ------
    InputError
        The folder holds no finished run.
    """
    table = folder / "table.parquet"
    if not table.exists():
        raise InputError(f"{folder}: holds no finished run of the bench; make one with 'gyrocal bench run {folder}'")
    rows = pd.read_parquet(table)
    if "outcome" not in rows:
        raise InputError(f"{folder}: is not a run of the bench")
    return rows[rows["error"] == ""].reset_index(drop=True)


ENTRY = Entry(STUDY, SUMMARY, report)
