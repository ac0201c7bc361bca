"""Is a mean NEES that of an honest covariance? In words, with its bounds, for tables of estimators that must pass or fail."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from studies.montecarlo.statistics import nees_check

CONFIDENCE = 0.999  # of each line of a table: a dozen honest lines pass together with 99 %

ENOUGH = 50  # cases of a line, below which its bounds let most things pass

HONEST, TOO_SURE, TOO_CAUTIOUS = "consistent", "over-confident", "under-confident"


def judged(values: ArrayLike, dof: int, confidence: float = CONFIDENCE) -> dict[str, object]:
    """Mean NEES per degree of freedom with its bounds, and what they say of the covariance.

    Parameters
    ----------
    values : (n,) NEES of n independent cases; those of a case that has none, NaN, are left out
    dof : degrees of freedom of each
    """
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    found = nees_check(finite, dof, confidence)
    verdict = HONEST if found.inside else TOO_SURE if found.value > found.upper else TOO_CAUTIOUS
    return {
        "cases": found.cases,
        "dof": dof,
        "nees_per_dof": found.value / dof,
        "low": found.lower / dof,
        "high": found.upper / dof,
        "verdict": verdict,
    }


def word(expected: bool | None) -> str:
    """The column "expected" of a line that must be honest, must not be, or may be either."""
    return {None: "", True: HONEST, False: f"not {HONEST}"}[expected]


def surprises(table: pd.DataFrame) -> pd.DataFrame:
    """Lines of a table whose verdict is not the expected one."""
    honest = table["verdict"] == HONEST
    return table[(table["expected"] != "") & (honest != (table["expected"] == HONEST))]


def score(*tables: pd.DataFrame) -> str:
    """How many lines of tables were judged as they must be, in a sentence that names the others."""
    wrong = []
    for table in tables:
        names = [name for name in table if not pd.api.types.is_numeric_dtype(table[name]) and not str(name).endswith("verdict")]
        for _, row in surprises(table)[[name for name in names if name != "expected"]].iterrows():
            wrong.append(", ".join(str(value) for value in row))
    total = sum(int((table["expected"] != "").sum()) for table in tables)
    text = f"{total - len(wrong)} of {total} lines were judged as they must be"
    cases = min((int(table["cases"].min()) for table in tables if "cases" in table and len(table)), default=ENOUGH)
    few = f" {cases} cases are too few to notice much." if cases < ENOUGH else ""
    return (f"{text}; not: {'; '.join(wrong)}." if wrong else f"{text}.") + few


def nees_distribution(axes: Axes, values: ArrayLike, dof: int, colour: str, label: str, style: str = "-") -> None:
    """The share of cases below each NEES, over the one that χ² has."""
    from scipy.stats import chi2  # scipy.stats costs every worker 45 MiB, and no case needs it

    x = np.linspace(0, chi2.isf(1e-3, dof), 200)
    if not axes.lines:
        axes.plot(x, chi2.cdf(x, dof), color="0.75", linewidth=4, label=f"χ², {dof} degrees of freedom")
        axes.set_ylabel("share of cases below")
        axes.set_xlim(0, x[-1])
        axes.set_ylim(0, 1.02)
    found = np.sort(np.asarray(values, dtype=float))
    axes.step(found, (1 + np.arange(found.size)) / found.size, style, where="post", color=colour, label=label, linewidth=1.3)
