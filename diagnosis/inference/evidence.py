"""Closed-form evidence of groups of columns with an unknown amplitude.

A group is k columns X of the whitened linear model, with amplitudes a ~ N(0, s² I). Integrated over a, and relative to the
baseline,

    log B(s) = −½ log |I + s² XᵀX| + ½ (Xᵀy)ᵀ (XᵀX + I/s²)⁻¹ (Xᵀy)

(Rasmussen & Williams, Gaussian Processes for Machine Learning, section 2.7), a sum over the eigenvectors of XᵀX. The scale s
is not known either: B is averaged over scales spaced evenly in log s, and over the options of an effect (a step's time, a
process' time constant). An average of likelihood ratios has expectation one under the baseline, so that P(B ≥ c) ≤ 1/c there
whatever the recording (Ville's inequality); a search cannot exaggerate it.

Conditioned on groups that are already in, their scaled columns C = [s X …] change every inner product to
<p, q> − (Cᵀp)ᵀ (I + CᵀC)⁻¹ (Cᵀq).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

Array = NDArray[np.float64]

VISIBLE = (1.0, 300.0)  # scales of interest: signal-to-noise ratios of the amplitude's standard deviation
PER_DECADE = 4  # scales in a decade; the evidence changes little between neighbours


@dataclass(frozen=True)
class Option:
    """One way an effect can be: its columns in the bank, and what it takes for granted.

    Attributes
    ----------
    start, count : its columns
    log_weight : log prior among the options of its effect
    parameters : what is fixed, such as the time of a step
    """

    start: int
    count: int
    log_weight: float
    parameters: dict[str, float | str]

    @property
    def columns(self) -> slice:
        """Its columns in the bank."""
        return slice(self.start, self.start + self.count)


def scales_of(largest: float, limits: tuple[float, float]) -> Array:
    """Scales to average over: those that this recording can show and that are physically plausible, spaced evenly in log.

    Parameters
    ----------
    largest : largest ‖X‖ of any option per unit amplitude
    limits : plausible range of the size

    Returns
    -------
    (s,) empty where nothing plausible could be seen
    """
    if not largest > 0:
        return np.empty(0)
    low, high = max(limits[0], VISIBLE[0] / largest), min(limits[1], VISIBLE[1] / largest)
    if low >= high:
        return np.empty(0)
    count = max(3, round(PER_DECADE * np.log10(high / low)) + 1)
    return np.geomspace(low, high, count)


def log_bayes(gram: Array, correlation: Array, scales: Array) -> Array:
    """log B of every option at every scale.

    Parameters
    ----------
    gram : (o, k, k) XᵀX
    correlation : (o, k) Xᵀy, or (o, k, d) for d observations
    scales : (s,)

    Returns
    -------
    (o, s), or (o, s, d)
    """
    # Most groups are of one column, which needs no decomposition.
    values, vectors = np.linalg.eigh(gram) if gram.shape[1] > 1 else (gram[:, :, 0], np.ones_like(gram))
    values = np.maximum(values, 0.0)
    single = correlation.ndim == 2
    along = np.matmul(vectors.transpose(0, 2, 1), correlation[..., None] if single else correlation) ** 2  # (o, k, d)
    variance = scales**2
    gain = 1.0 + variance[None, None, :] * values[:, :, None]  # (o, k, s)
    quadratic = 0.5 * np.einsum("oks,okd->osd", variance / gain, along)
    out = quadratic - 0.5 * np.log(gain).sum(axis=1)[:, :, None]
    return np.asarray(out[:, :, 0] if single else out)


def averaged(table: Array, log_weights: Array) -> float:
    """log of B averaged over options and scales; (o, s) and (o,) log weights that sum to one."""
    values = table + log_weights[:, None]
    top = values.max()
    return float(top + np.log(np.exp(values - top).sum()) - np.log(table.shape[1]))


class Conditioning:
    """Inner products given some scaled columns.

    Parameters
    ----------
    columns : (N, r) scaled columns C of the groups that are in
    y : (N,) whitened observations
    """

    def __init__(self, columns: Array, y: Array):
        self.columns = columns
        self.factor = np.linalg.cholesky(np.eye(columns.shape[1]) + columns.T @ columns)
        self.y = self._solved(columns.T @ y)
        self.log_bayes = float(0.5 * self.y @ self.y - np.log(np.diag(self.factor)).sum())

    def _solved(self, values: Array) -> Array:
        return np.asarray(scipy.linalg.solve_triangular(self.factor, values, lower=True, check_finite=False))

    def reduced(self, X: Array) -> Array:
        """(r, p) what to take out of inner products: <p, q> − reduced(p)ᵀ reduced(q)."""
        return self._solved(self.columns.T @ X)
