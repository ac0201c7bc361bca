"""Whether a study shows that a requirement is met, with a stated risk: order statistics of independent cases.

    Requirement.parse("p99.73(pointing_deg) < 0.4 @ 90%")   # at least 99.73 % of cases below 0.4, with 90 % confidence
    Requirement.parse("p1(margin_deg) > 0.1")                # at least 99 % above 0.1; 90 % confidence unless stated

A requirement on a percentile is one on a probability: q = 1 − 0.9973 is the most that may lie beyond the limit. Of N
independent cases k lie beyond it, and k is binomial whatever the distribution of the column. With the risk β = 1 − confidence
the requirement is

- met if P(K ≤ k | q) ≤ β: had it just been missed, so few failures would be that improbable (the consumer's risk);
- not met if P(K ≥ k | q) ≤ β: had it just been met, so many failures would be that improbable (the producer's risk);
- undecided else. The two sum to more than 1, so for β < 1/2 they exclude each other.

J. M. Hanson and B. B. Beard, NASA/TP-2010-216447: 852 runs without a failure for 99.73 % at 10 % risk. Equivalently, an end of
the interval of C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404, lies on the right side of q.

A failed case counts as one beyond the limit, and so does one without a value. Of a case with several rows the worst counts.
The risk holds for cases drawn independently, and for a number of cases that was not chosen by their values.
"""

import math
import re
from dataclasses import dataclass
from typing import Any, Literal, Self

import pandas as pd
from scipy import special
from scipy.stats import nbinom

from gyrocal.errors import InputError
from studies.montecarlo.criterion_text import check_criterion_column, match_criterion
from studies.montecarlo.study import GridConfig, StudyConfig

REQUIREMENT_FORM = re.compile(
    r"\s*p(\d+(?:\.\d+)?)\(\s*(\S+?)\s*\)\s*([<>])\s*(?P<limit>\S+?)\s*(?:@\s*(\d+(?:\.\d+)?)\s*%\s*)?"
)
REQUIREMENT_USAGE = (
    "give it as pNN(COLUMN)<LIMIT or pNN(COLUMN)>LIMIT, the percentile between 0 and 100, and after @ a confidence between "
    "50 and 100 %, e.g. 'p99.73(pointing_deg)<0.4 @ 90%'"
)
DEFAULT_CONFIDENCE = 90.0  # %, the consumer's risk of 10 % of the report named above
MOST_RUNS = 1e12  # beyond which a number of further cases is stated as none

Outcome = Literal["met", "not met", "undecided"]


@dataclass(frozen=True)
class Answer:
    """Whether a requirement is met.

    Attributes
    ----------
    requirement : as text
    outcome : met, not met or undecided
    cases : number of cases
    beyond : of them, those that do not keep the limit, failed ones and ones without a value among them
    failed : cases that ended with an error
    empty : cases with a row without a value
    fewest : further cases that show it met if all of them keep the limit; 0 if it is decided
    expected : further cases that decide it if the share beyond the limit stays; infinite if that share is the one allowed
    """

    requirement: str
    outcome: Outcome
    cases: int
    beyond: int
    failed: int
    empty: int
    fewest: int
    expected: float

    def __str__(self) -> str:
        parts = [f"{self.failed} failed"] * (self.failed > 0) + [f"{self.empty} without a value"] * (self.empty > 0)
        among = f", among them {' and '.join(parts)}" if parts else ""
        found = f"{self.requirement}: {self.outcome}; {self.beyond} of {self.cases} cases are beyond the limit{among}"
        if self.outcome != "undecided":
            return f"{found}."
        more = f"about {self.expected:.0f}" if self.expected < MOST_RUNS else "no number"
        return f"{found}. Further cases that decide it: {self.fewest} if all keep the limit, {more} at the share so far."


@dataclass(frozen=True)
class Requirement:
    """A limit that a share of all cases must keep.

    Attributes
    ----------
    percentile : of the column's distribution, %
    column : of the rows
    sign : "<" if the percentile must lie below the limit, ">" if above
    limit : in the column's unit
    confidence : of the answer, %
    """

    percentile: float
    column: str
    sign: str
    limit: float
    confidence: float = DEFAULT_CONFIDENCE

    @classmethod
    def parse(cls, text: str) -> Self:
        """The requirement of a text.

        Raises
        ------
        InputError
            It is not of that form.
        """
        match, limit = match_criterion(REQUIREMENT_FORM, text, "--require", REQUIREMENT_USAGE)
        found = cls(float(match[1]), match[2], match[3], limit, float(match[5] or DEFAULT_CONFIDENCE))
        if not (0 < found.percentile < 100 and 50 < found.confidence < 100):
            raise InputError(f"--require {text}: {REQUIREMENT_USAGE}")
        return found

    def __str__(self) -> str:
        return f"p{self.percentile:.12g}({self.column}) {self.sign} {self.limit:.12g} @ {self.confidence:.12g} %"

    @property
    def failure_probability(self) -> float:
        """Probability of a case beyond the limit that is just allowed."""
        share = self.percentile / 100
        return 1 - share if self.sign == "<" else share

    def judge(self, rows: pd.DataFrame) -> Answer:
        """Answer from all rows of a study.

        Parameters
        ----------
        rows : columns case, error and the requirement's own; a failed case is a row with its error

        Raises
        ------
        InputError
            There is no such column, or it holds no numbers.
        """
        check_criterion_column(self.column, map(str, rows), rows.get(self.column, ()), "--require")
        numbers = rows[self.column].astype(float)
        kept = numbers < self.limit if self.sign == "<" else numbers > self.limit
        failed = rows["error"] != ""
        by_case = pd.DataFrame({"beyond": ~kept | failed, "failed": failed, "empty": numbers.isna() & ~failed})
        counts = by_case.groupby(rows["case"]).any()
        return self.judge_counts(len(counts), *(int(counts[name].sum()) for name in counts))

    def judge_counts(self, cases: int, beyond: int, failed: int = 0, empty: int = 0) -> Answer:
        """Answer from the number of cases and of those beyond the limit."""
        q, risk = self.failure_probability, 1 - self.confidence / 100
        outcome: Outcome = "undecided"
        fewest, expected = 0, 0.0
        if compute_tail_below(beyond, cases, q) <= risk:
            outcome = "met"
        elif compute_tail_above(beyond, cases, q) <= risk:
            outcome = "not met"
        else:
            fewest = count_runs(beyond, q, risk) - cases
            expected = _estimate_runs(beyond / cases, cases, q, risk) - cases if beyond else fewest
        return Answer(str(self), outcome, cases, beyond, failed, empty, fewest, expected)


def compute_tail_below(count: float, cases: float, q: float) -> float:
    """P(K ≤ count) of a binomial K, also between whole numbers, by the incomplete beta function."""
    return float(special.betaincc(count + 1, cases - count, q)) if count < cases else 1.0


def compute_tail_above(count: float, cases: float, q: float) -> float:
    """P(K ≥ count) of a binomial K, also between whole numbers, by the incomplete beta function."""
    return float(special.betainc(count, cases - count + 1, q)) if count > 0 else 1.0


def count_runs(beyond: int, q: float, risk: float) -> int:
    """Fewest cases that show a requirement met with so many beyond the limit: the smallest N with P(K ≤ beyond) ≤ risk.

    That is P(the failure after these comes later than case N), a negative binomial's tail.
    """
    return beyond + 1 + int(nbinom.isf(risk, beyond + 1, q))


def _estimate_runs(share: float, cases: int, q: float, risk: float) -> float:
    """Cases that decide a requirement if this share of them lies beyond the limit; infinite if that is the allowed share."""
    tail = compute_tail_below if share < q else compute_tail_above
    low, high = cases, 2 * cases
    while tail(share * high, high, q) > risk:
        low, high = high, 2 * high
        if high > MOST_RUNS:
            return math.inf
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if tail(share * middle, middle, q) > risk else (low, middle)
    return float(high)


def check_independent(config: StudyConfig, option: str) -> None:
    """Refuse a study whose cases are no independent draws, to which order statistics do not apply.

    Raises
    ------
    InputError
        Its cases are the points of a grid, or its sampler spreads them evenly.
    """
    if isinstance(config, GridConfig):
        raise InputError(f"{option}: the cases of this study are points of a grid, not draws; choose another study")
    if not draws_independently(config):
        raise InputError(
            f"{option}: cases of the sampler {config.sampler} depend on each other, and order statistics need independent "
            "ones; use --set sampler=random and another folder"
        )


def draws_independently(config: Any) -> bool:
    """Whether the cases of a study are independent draws."""
    return not isinstance(config, GridConfig) and (config.sampler == "random" or not config.dispersions)
