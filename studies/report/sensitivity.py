"""Which dispersions drive what: first-order Sobol indices from the rows of a study as they are, and what drives the failures.

The first-order index of an input x on an output y is S = Var E[y | x]/Var y, the share of the variance that x explains alone.
With u the rank of x as a number of (0, 1), E[y | x] is fitted by least squares as

    y = c₀ + Σ c_m √2 cos(π m u) + a z + b z²,   m = 1 … M,   z = Φ⁻¹(u),

harmonics for what is smooth in u (E. Plischke, Reliab. Eng. Syst. Saf. 95 (2010) 354, has them by Fourier transform), z and z²
for the tails of what is linear or quadratic in a normal x, which harmonics miss by some per cent. Any sampler will do, and no
further case is run. Of noise alone R² would be k/(n − 1) with k = M + 2; S is therefore the adjusted

    S = 1 − (1 − R²) (n − 1)/(n − k − 1).

Its 95 % interval is the basic bootstrap's over the cases: in the resampled world the truth is R² and S* estimates it, so the
interval is S less the quantiles of S* − R². Intervals and order are of single dispersions; what they do only together
(interactions), and the noise of each case, is what their sum leaves of 1.

Which dispersions drive the failures is the same index of y = 1 for a failed case and 0 for a good one, with the share of
failures in the lowest and in the highest fifth of each.
"""

import numpy as np
import pandas as pd
from scipy.special import ndtri

from gyrocal.arrays import Array
from studies.montecarlo.study import DISPERSED, RESERVED
from studies.report.tables import Table

HARMONICS = 6  # M
REGRESSION_TERMS = HARMONICS + 2  # k
FEWEST_CASES = 50  # cases, below which no index is stated
MOST_CASES = 20_000  # cases that are looked at; more would change no digit that counts
REPLICATES = 200
SMALLEST_SPREAD = 1e-12  # by the largest value: to rounding a constant has a spread too
CORRELATED_NOTE = " Some dispersions are correlated: their shares overlap, and may add up to more than all."
SHOWN_LINES = 30  # lines for people; the CSV file has all
FIFTH = 0.2


def build_rank_basis(x: Array) -> Array:
    """(n, k + 1) functions of the ranks of x (n,) that fit E[y | x], the constant first."""
    u = (pd.Series(x).rank(method="average").to_numpy() - 0.5) / len(x)
    z = ndtri(u)
    waves = [np.sqrt(2) * np.cos(np.pi * m * u) for m in range(1, HARMONICS + 1)]
    return np.column_stack([np.ones(len(x)), *waves, z, z**2])


def _compute_r_squared(functions: Array, outputs: Array, weights: Array) -> Array:
    """(b, q) R² of standardised outputs (n, q) on one dispersion's functions (n, k + 1), by weights (b, n) of the cases."""
    n, k = functions.shape
    gram = (weights @ (functions[:, :, None] * functions[:, None, :]).reshape(n, k * k)).reshape(-1, k, k)
    total, square = weights @ outputs, weights @ outputs**2
    product = np.stack([weights @ (functions * output[:, None]) for output in outputs.T], axis=2)
    try:
        fitted = np.linalg.solve(gram, product)
    except np.linalg.LinAlgError:  # of an input with few different values, some resampled ones have too few
        fitted = np.linalg.pinv(gram, hermitian=True) @ product
    explained = np.einsum("bkq,bkq->bq", product, fitted)
    count = weights.sum(axis=1, keepdims=True)
    scatter = square - total**2 / count
    return np.asarray(1 - (square - explained) / np.where(scatter > 0, scatter, np.nan))


def estimate_first_order(inputs: Array, outputs: Array, seed: int = 0) -> tuple[Array, Array, Array]:
    """First-order Sobol indices with their 95 % bootstrap intervals.

    Parameters
    ----------
    inputs : (n, d), independent of each other
    outputs : (n, q)
    seed : of the bootstrap

    Returns
    -------
    index, low, high, each (d, q); the interval is cut at 0 and 1, the index is not
    """
    n = len(outputs)
    outputs = (outputs - outputs.mean(axis=0)) / outputs.std(axis=0)
    drawn = np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=REPLICATES).astype(float)
    weights = np.vstack([np.ones(n), drawn])
    found = []
    for x in inputs.T:
        r2 = _compute_r_squared(build_rank_basis(x), outputs, weights)
        adjusted = 1 - (1 - r2) * (n - 1) / (n - REGRESSION_TERMS - 1)
        low, high = np.nanquantile(adjusted[1:] - r2[0], [0.975, 0.025], axis=0)
        found.append((adjusted[0], np.clip(adjusted[0] - low, 0, 1), np.clip(adjusted[0] - high, 0, 1)))
    index, lower, upper = (np.array(part) for part in zip(*found, strict=True))
    return index, lower, upper


def rank_dispersions(rows: pd.DataFrame) -> pd.DataFrame:
    """Each column's dispersions by their first-order index, of all rows of a study with dispersions.

    Returns
    -------
    column, dispersion, first_order, low, high; largest first within a column; empty with too few good cases
    """
    inputs, outputs = _group_by_case(rows[rows["error"] == ""])
    return _rank_columns(inputs, outputs)


def rank_failure_causes(rows: pd.DataFrame) -> pd.DataFrame:
    """Which dispersions drive the failures: their index on "failed", and the share failed at both ends of each.

    Returns
    -------
    dispersion, first_order, low, high, failed_lowest_fifth, failed_highest_fifth; empty without a failure or with too few cases
    """
    # A case that failed before its values were drawn has none.
    drawn = rows.dropna(subset=[name for name in rows if str(name).startswith(DISPERSED)])
    inputs, _ = _group_by_case(drawn)
    failed = (drawn.groupby("case")["error"].first() != "").astype(float).rename("failed").to_frame()
    table = _rank_columns(inputs, failed).drop(columns="column", errors="ignore")
    share = inputs.rank(pct=True)
    for end, part in (("failed_lowest_fifth", share <= FIFTH), ("failed_highest_fifth", share > 1 - FIFTH)):
        table[end] = [float(failed.loc[part[name], "failed"].mean()) for name in table["dispersion"]]
    return table


def build_sensitivity_tables(rows: pd.DataFrame, correlated: bool = False) -> dict[str, Table]:
    """The tables of a study with dispersions: ``dispersions``, and ``failures`` if a case failed."""
    found = rank_dispersions(rows)
    if found.empty:
        return {}
    sure = found[found["low"] > 0]
    order = sure.groupby("column")["first_order"].transform("max").sort_values(ascending=False, kind="stable").index
    shown = "" if len(sure) <= SHOWN_LINES else f", {SHOWN_LINES} are shown"
    note = (
        "Share of a column's variance that a dispersion explains alone (first-order Sobol index), 95 % bootstrap intervals; "
        f"of a case with several rows, their mean. {len(sure)} of {len(found)} are surely above zero{shown}; "
        f"dispersions.csv has all.{CORRELATED_NOTE if correlated else ''}"
    )
    out = {"dispersions": Table("What the dispersions drive", found, note, shown=sure.loc[order].head(SHOWN_LINES))}
    failed = rank_failure_causes(rows)
    if len(failed):
        what = (
            "The same index of whether a case failed, and the shares that failed in the lowest and highest fifth of its values."
        )
        out["failures"] = Table("Which dispersions drive the failures", failed, what)
    return out


def _group_by_case(rows: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Dispersed values, and those numbers that every row has, a row a case."""
    drawn = [str(name) for name in rows if str(name).startswith(DISPERSED)]
    kept = [name for name in rows.select_dtypes(["number", "bool"]) if name not in {*drawn, *RESERVED}]
    numbers = rows[kept].astype(float).groupby(rows["case"]).mean()
    finite = numbers[[name for name in kept if np.isfinite(numbers[name]).all()]]
    inputs = pd.DataFrame(rows[drawn].groupby(rows["case"]).first())
    return inputs.rename(columns=lambda name: str(name).removeprefix(DISPERSED)), finite


def _rank_columns(inputs: pd.DataFrame, outputs: pd.DataFrame) -> pd.DataFrame:
    """A row for each column and dispersion."""
    names = ["column", "dispersion", "first_order", "low", "high"]
    inputs, outputs = inputs.head(MOST_CASES), outputs.head(MOST_CASES)
    outputs = outputs.loc[:, outputs.std() > SMALLEST_SPREAD * outputs.abs().max()] if len(outputs) else outputs
    inputs = inputs.loc[:, inputs.nunique() > 2 * REGRESSION_TERMS]
    if len(inputs) < FEWEST_CASES or not len(outputs.columns) or not len(inputs.columns):
        return pd.DataFrame(columns=names)
    found = np.array(estimate_first_order(inputs.to_numpy(), outputs.to_numpy()))
    parts = []
    for q, column in enumerate(outputs.columns):
        part = pd.DataFrame(found[:, :, q].T, columns=names[2:]).assign(column=column, dispersion=inputs.columns)
        parts.append(part.sort_values("first_order", ascending=False, kind="stable"))
    return pd.concat(parts, ignore_index=True)[names]
