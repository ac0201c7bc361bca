"""When a study has enough cases: the half-width of a statistic's 95 % confidence interval is below a limit.

    Until.parse("nees<0.1")              # of the mean of column nees
    Until.parse("p95(error_G_xx_ppm)<5")  # mean, median, std, or a percentile p01 to p99
    Until.parse("failed<0.01")           # of the share of failed cases; so of any column of truth values

With n values: the mean has s/√n and Student's t; the standard deviation, by the delta method, √((m₄ − s⁴)/n)/(2 s); a quantile
half the distance of the order statistics between which it lies by the binomial law; a share Wilson's interval, which stays wide
when all n are alike. Of a case with several rows the mean of its rows counts, since they are not independent.

The criterion is asked at fixed numbers of cases, each a quarter larger than the one before: where a study stops depends on its
rows and its chunk, never on which case ended first. Looking several times stops a little early by chance: of normal values the
interval at the stop covers in a little less than 95 %.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from gyrocal.errors import InputError
from studies.montecarlo.criterion_text import match_criterion
from studies.montecarlo.statistics import compute_binomial_interval

Array = NDArray[np.float64]

LEVEL = 0.95
FIRST, GROWTH = 64, 1.25  # cases at the first look, and from one to the next
FAILED = "failed"
FORM = re.compile(r"\s*(?:(mean|median|std|p\d\d)\(\s*(\S+?)\s*\)|([^<()\s]+))\s*<\s*(?P<limit>\S+)\s*")
USAGE = "give it as COLUMN<LIMIT or STATISTIC(COLUMN)<LIMIT with mean, median, std or p01 to p99, e.g. 'p95(nees)<0.5'"


@dataclass(frozen=True)
class StoppingRule:
    """Half-width below which a study has enough cases.

    Attributes
    ----------
    statistic : mean, median, std or a percentile such as p95
    column : of the rows, or "failed"
    limit : in the column's unit
    """

    statistic: str
    column: str
    limit: float

    @classmethod
    def parse(cls, text: str) -> Self:
        """The criterion of a text.

        Raises
        ------
        InputError
            It is not of that form.
        """
        match, limit = match_criterion(FORM, text, "--until", USAGE)
        if not limit > 0 or match[1] == "p00":
            raise InputError(f"--until {text}: {USAGE}")
        return cls(match[1] or "mean", match[2] or match[3], limit)

    def half_width(self, rows: pd.DataFrame) -> float:
        """Half-width over the rows of the first cases, infinite if they are too few to have one.

        Parameters
        ----------
        rows : columns case, error and the criterion's own; failed cases count for "failed" only

        Raises
        ------
        InputError
            The column holds no numbers.
        """
        if self.column == FAILED:
            failed = rows.groupby("case")["error"].first() != ""
            return _compute_share_half_width(int(failed.sum()), len(failed))
        good = rows[rows["error"] == ""].dropna(subset=[self.column])
        values = good[self.column]
        if len(values) and not isinstance(values.iloc[0], bool | int | float | np.bool_ | np.number):
            raise InputError(f"--until: column {self.column} holds no numbers")
        truth = values.map(type).isin([bool, np.bool_]).all() and len(values)
        each = np.asarray(values.astype(float).groupby(good["case"]).mean(), dtype=np.float64)
        if truth and self.statistic == "mean" and len(each) == len(values):
            return _compute_share_half_width(int(each.sum()), len(each))
        return _compute_half_width(self.statistic, each) if len(each) > 1 and np.isfinite(each).all() else math.inf

    def __str__(self) -> str:
        return f"half-width of {self.statistic}({self.column}) < {self.limit:g}"


def list_checkpoints(cases: int, chunk: int) -> Iterator[int]:
    """Numbers of cases at which the criterion is asked, whole chunks, the last one all."""
    size = float(FIRST)
    while (count := -(-math.ceil(size) // chunk) * chunk) < cases:
        yield count
        size = count * GROWTH
    yield cases


def _compute_share_half_width(successes: int, trials: int) -> float:
    low, high = compute_binomial_interval(successes, trials, LEVEL)
    return (high - low) / 2


def _compute_half_width(statistic: str, values: Array) -> float:
    n, sigma = len(values), float(values.std(ddof=1))
    t = float(stats.t.ppf((1 + LEVEL) / 2, n - 1))
    if statistic == "mean":
        return t * sigma / math.sqrt(n)
    if statistic == "std":
        fourth = float(np.mean((values - values.mean()) ** 4))
        return t * math.sqrt(max(fourth - sigma**4, 0.0) / n) / (2 * sigma) if sigma else 0.0
    share = 0.5 if statistic == "median" else int(statistic[1:]) / 100
    interval = stats.quantile_test(values, p=share).confidence_interval(LEVEL)
    half = float(interval.high - interval.low) / 2
    return half if math.isfinite(half) else math.inf  # the interval reaches beyond the sample
