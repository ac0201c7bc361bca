"""Criteria of a study: a number of cases that suffices (--until), and requirements that its cases show to be met (--require).

The criterion of --until is the half-width of a statistic's 95 % confidence interval: of the mean by Student's t; of the
standard deviation by the delta method, √((m₄ − s⁴)/n)/(2 s); of a quantile by order statistics; of a share Wilson's, which
stays wide when all values are equal. It is tested at fixed numbers of cases: the end of a study depends on its rows, never on
which case ended first. Since it is tested several times, the interval at the stop covers in a little less than 95 %.

A requirement on a percentile is one on a probability: for p99.73, at most q = 1 − 0.9973 may lie beyond the limit. Of N
independent cases k lie beyond it, and k is binomial for any distribution of the column. With the risk β = 1 − confidence the
requirement is met if P(K ≤ k | q) ≤ β (the consumer's risk), not met if P(K ≥ k | q) ≤ β (the producer's risk), and undecided
otherwise (J. M. Hanson and B. B. Beard, NASA/TP-2010-216447). Equivalently, an end of the interval of C. J. Clopper and
E. S. Pearson, Biometrika 26 (1934) 404, lies on the right side of q. The risk holds for a number of cases that does not depend
on their values.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
import pandas as pd
from scipy import special, stats

from gyrocal.arrays import Array
from gyrocal.errors import InputError, suggest_names
from studies.montecarlo.statistics import compute_binomial_interval
from studies.montecarlo.study import RESERVED, GridConfig, StudyConfig

Outcome = Literal["met", "not met", "undecided"]

LEVEL = 0.95
FIRST, GROWTH = 64, 1.25  # cases at the first look, and from one to the next
FAILED = "failed"
UNTIL_FORM = re.compile(r"\s*(?:(mean|median|std|p\d\d)\(\s*(\S+?)\s*\)|([^<()\s]+))\s*<\s*(?P<limit>\S+)\s*")
UNTIL_USAGE = "give it as COLUMN<LIMIT or STATISTIC(COLUMN)<LIMIT with mean, median, std or p01 to p99, e.g. 'p95(nees)<0.5'"
REQUIREMENT_FORM = re.compile(
    r"\s*p(\d+(?:\.\d+)?)\(\s*(\S+?)\s*\)\s*([<>])\s*(?P<limit>\S+?)\s*(?:@\s*(\d+(?:\.\d+)?)\s*%\s*)?"
)
REQUIREMENT_USAGE = (
    "give it as pNN(COLUMN)<LIMIT or pNN(COLUMN)>LIMIT, the percentile between 0 and 100, and after @ a confidence between "
    "50 and 100 %, e.g. 'p99.73(pointing_deg)<0.4 @ 90%'"
)
DEFAULT_CONFIDENCE = 90.0  # %, the consumer's risk of 10 % of the report named above


def _match_criterion(form: re.Pattern[str], text: str, option: str, usage: str) -> tuple[re.Match[str], float]:
    """Match a criterion with a form whose group `limit` is a finite number, and read this limit."""
    match = form.fullmatch(text)
    try:
        limit = float(match["limit"]) if match else math.nan
    except ValueError:
        limit = math.nan
    if match is None or not math.isfinite(limit):
        raise InputError(f"{option} {text}: {usage}")
    return match, limit


def _read_column(rows: pd.DataFrame, column: str, option: str) -> pd.Series:
    """Read the values of a study's own column, which are numbers or missing."""
    columns = [str(name) for name in rows if name not in RESERVED]
    if column not in columns:
        raise InputError(f"{option}: {column}: the rows have no such column; {suggest_names(column, columns)}")
    if not all(isinstance(value, bool | int | float | np.bool_ | np.number | None) for value in rows[column]):
        raise InputError(f"{option}: column {column} holds no numbers")
    return rows[column]


@dataclass(frozen=True)
class StoppingRule:
    """Half-width of a statistic (mean, median, std, p01 to p99) of a column, below which a study has enough cases."""

    statistic: str
    column: str
    limit: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text such as "nees<0.1", "p95(error_G_xx_ppm)<5" or "failed<0.01"; `InputError` if it is not of that form."""
        match, limit = _match_criterion(UNTIL_FORM, text, "--until", UNTIL_USAGE)
        if not limit > 0 or match[1] == "p00":
            raise InputError(f"--until {text}: {UNTIL_USAGE}")
        return cls(match[1] or "mean", match[2] or match[3], limit)

    def half_width(self, rows: pd.DataFrame) -> float:
        """Compute the half-width over the rows of the first cases; infinite for too few cases or infinite values.

        Several rows of a case count by their mean, since they are not independent. Failed cases count for "failed" only.
        `InputError` if there is no such column, or it holds no numbers.
        """
        if self.column == FAILED:
            failed = rows.groupby("case")["error"].first() != ""
            return _compute_share_half_width(int(failed.sum()), len(failed))
        values = self._select_values(rows)
        is_truth = values.map(type).isin([bool, np.bool_]).all() and len(values)
        case_means = np.asarray(values.astype(float).groupby(rows["case"]).mean(), dtype=np.float64)
        if is_truth and self.statistic == "mean" and len(case_means) == len(values):
            return _compute_share_half_width(int(case_means.sum()), len(case_means))
        case_means = case_means[~np.isnan(case_means)]
        is_refused = self.statistic in ("mean", "std") and not np.isfinite(case_means).all()
        return _compute_half_width(self.statistic, case_means) if len(case_means) > 1 and not is_refused else math.inf

    def describe_values(self, rows: pd.DataFrame) -> str:
        """Describe of how many cases the statistic is, those without a value or with an infinite one, and a refusal."""
        if self.column == FAILED:
            return f"of {rows['case'].nunique()} cases"
        values = self._select_values(rows).astype(float)
        cases, present = rows.loc[rows["error"] == "", "case"].nunique(), rows.loc[values.index, "case"]
        missing, infinite = cases - present.nunique(), present[np.isinf(values)].nunique()
        parts = [f"{missing} more have no value"] * (missing > 0) + [f"{infinite} are infinite"] * (infinite > 0)
        refused = [f"so there is no {self.statistic}"] if infinite and self.statistic in ("mean", "std") else []
        return ", ".join([f"of {present.nunique()} cases", *parts, *refused])

    def _select_values(self, rows: pd.DataFrame) -> pd.Series:
        return _read_column(rows, self.column, "--until")[rows["error"] == ""].dropna()

    def __str__(self) -> str:
        return f"half-width of {self.statistic}({self.column}) < {self.limit:g}"


def list_checkpoints(cases: int, part: int) -> Iterator[int]:
    """List the numbers of cases at which the criterion is tested, whole parts of `part` cases, the last one all."""
    size = float(FIRST)
    while (count := -(-math.ceil(size) // part) * part) < cases:
        yield count
        size = count * GROWTH
    yield cases


def _compute_share_half_width(successes: int, trials: int) -> float:
    low, high = compute_binomial_interval(successes, trials, LEVEL)
    return (high - low) / 2


def _compute_half_width(statistic: str, values: Array) -> float:
    if statistic not in ("mean", "std"):
        probability = 0.5 if statistic == "median" else int(statistic[1:]) / 100
        interval = stats.quantile_test(values, p=probability).confidence_interval(LEVEL)
        # An end may be infinite: the interval reaches beyond the sample, or to infinite values.
        ends = interval.low, interval.high
        return float(interval.high - interval.low) / 2 if np.isfinite(ends).all() else math.inf
    n, sigma = len(values), float(values.std(ddof=1))
    t = float(stats.t.ppf((1 + LEVEL) / 2, n - 1))
    if statistic == "mean":
        return t * sigma / math.sqrt(n)
    fourth = float(np.mean((values - values.mean()) ** 4))
    return t * math.sqrt(max(fourth - sigma**4, 0.0) / n) / (2 * sigma) if sigma else 0.0


@dataclass(frozen=True)
class Answer:
    """The outcome of a requirement."""

    requirement: str  # requirement, outcome: as text; met, not met or undecided
    outcome: Outcome
    cases: int  # cases, beyond: number of all cases, and of those beyond the limit, which include failed and empty ones
    beyond: int
    failed: int  # failed, empty, infinite: cases that ended with an error, without a value, and with an infinite one beyond it
    empty: int
    infinite: int
    fewest: int  # further cases that show it met if all of them keep the limit; 0 if it is decided

    def __str__(self) -> str:
        kinds = {"failed": self.failed, "without a value": self.empty, "infinite": self.infinite}
        parts = [f"{count} {kind}" for kind, count in kinds.items() if count]
        among = f", among them {' and '.join(parts)}" if parts else ""
        answer = f"{self.requirement}: {self.outcome}; {self.beyond} of {self.cases} cases are beyond the limit{among}"
        further = f" {self.fewest} further cases show it met if all keep the limit." if self.outcome == "undecided" else ""
        return f"{answer}.{further}"


@dataclass(frozen=True)
class Requirement:
    """A limit that a percentile of a column must lie below ("<") or above (">"), with a confidence in %."""

    percentile: float
    column: str
    sign: str
    limit: float
    confidence: float = DEFAULT_CONFIDENCE

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse a text such as "p99.73(pointing_deg) < 0.4 @ 90%" or "p1(x) > 0.1"; `InputError` if it is not of that form."""
        match, limit = _match_criterion(REQUIREMENT_FORM, text, "--require", REQUIREMENT_USAGE)
        requirement = cls(float(match[1]), match[2], match[3], limit, float(match[5] or DEFAULT_CONFIDENCE))
        if not (0 < requirement.percentile < 100 and 50 < requirement.confidence < 100):
            raise InputError(f"--require {text}: {REQUIREMENT_USAGE}")
        return requirement

    def __str__(self) -> str:
        return f"p{self.percentile:.12g}({self.column}) {self.sign} {self.limit:.12g} @ {self.confidence:.12g} %"

    @property
    def failure_probability(self) -> float:
        """Probability of a case beyond the limit that is just allowed."""
        probability = self.percentile / 100
        return 1 - probability if self.sign == "<" else probability

    def judge(self, rows: pd.DataFrame) -> Answer:
        """Judge the requirement from all rows of a study.

        A failed case counts as beyond the limit, and so does one without a value. A case with several rows counts by the worst.
        `InputError` if there is no such column, or it holds no numbers.
        """
        numbers = _read_column(rows, self.column, "--require").astype(float)
        is_within = numbers < self.limit if self.sign == "<" else numbers > self.limit
        failed = rows["error"] != ""
        infinite = np.isinf(numbers) & ~is_within
        by_case = pd.DataFrame(
            {"beyond": ~is_within | failed, "failed": failed, "empty": numbers.isna() & ~failed, "infinite": infinite}
        )
        counts = by_case.groupby(rows["case"]).any()
        return self.judge_counts(len(counts), *(int(counts[name].sum()) for name in counts))

    def judge_counts(self, cases: int, beyond: int, failed: int = 0, empty: int = 0, infinite: int = 0) -> Answer:
        """Judge the requirement from the number of cases and of those beyond the limit."""
        q, risk = self.failure_probability, 1 - self.confidence / 100
        is_met, is_missed = (tail(beyond, cases, q) <= risk for tail in (compute_tail_below, compute_tail_above))
        outcome: Outcome = "met" if is_met else "not met" if is_missed else "undecided"
        fewest = count_runs(beyond, q, risk) - cases if outcome == "undecided" else 0
        return Answer(str(self), outcome, cases, beyond, failed, empty, infinite, fewest)


def compute_tail_below(count: float, cases: float, q: float) -> float:
    """Compute P(K ≤ count) of a binomial K, also between whole numbers, by the incomplete beta function."""
    return float(special.betaincc(count + 1, cases - count, q)) if count < cases else 1.0


def compute_tail_above(count: float, cases: float, q: float) -> float:
    """Compute P(K ≥ count) of a binomial K, also between whole numbers, by the incomplete beta function."""
    return float(special.betainc(count, cases - count + 1, q)) if count > 0 else 1.0


def count_runs(beyond: int, q: float, risk: float) -> int:
    """Count the cases needed to show a requirement met with so many beyond: the smallest N with P(K ≤ beyond) ≤ risk.

    That is P(the failure after these comes later than case N), a negative binomial's tail.
    """
    return beyond + 1 + int(stats.nbinom.isf(risk, beyond + 1, q))


def check_independent(config: StudyConfig, option: str) -> None:
    """Raise `InputError` if the cases of a study are no independent draws, to which order statistics do not apply."""
    if isinstance(config, GridConfig):
        raise InputError(f"{option}: the cases of this study are points of a grid, not draws; choose another study")
    if not draws_independently(config):
        raise InputError(
            f"{option}: cases of the sampler {config.sampler} depend on each other, and order statistics need independent "
            "ones; use --set sampler=random and another folder"
        )


def draws_independently(config: Any) -> bool:
    """Check that the cases of a study are independent draws."""
    return not isinstance(config, GridConfig) and (config.sampler == "random" or not config.dispersions)
