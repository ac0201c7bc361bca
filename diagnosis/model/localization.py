"""Localization: where a recording departs from M0, by χ² of the innovations in each interval, axis and phase.

The whitened observations y are innovations in the order of time, with the covariance S = I − Q Qᵀ, Q the basis of what was
fitted. For those of one block, y_Bᵀ S_BB⁺ y_B is χ² with rank(S_BB) degrees of freedom under M0. Holm's correction decides
whether any block departs, Benjamini–Hochberg which ones are marked.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy.stats
from numpy.typing import NDArray

from diagnosis.answer import Finding
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]

PHASES = ("start", "slew", "hold", "end")
EDGE = 0.1  # share of an interval's references that count as its start or end
HOLE = 2.5  # times the usual spacing: a slew lies between two such references
MOST_FINDINGS = 6


def phases(model: RecordingModel) -> NDArray[np.str_]:
    """Phase of each reference."""
    return phases_of(model.observation_t_s, model.observation_block)


def phases_of(t_s: Array, interval: NDArray[np.intp]) -> NDArray[np.str_]:
    """Phase of references (m,) at some times, s, of intervals that follow one another."""
    parts = [t_s[interval == number] for number in np.unique(interval)]
    spacing = np.median(np.concatenate([np.diff(np.unique(t)) for t in parts]))
    out = []
    for t in parts:
        edge = max(1, round(EDGE * t.size))
        phase = np.full(t.size, "hold", dtype="<U5")
        for hole in np.flatnonzero(np.diff(t) > HOLE * spacing):
            phase[max(0, hole - 1) : hole + 3] = "slew"
        phase[:edge] = "start"
        phase[-edge:] = "end"
        out.append(phase)
    return np.concatenate(out)


def _rows(model: RecordingModel, number: int) -> NDArray[np.intp]:
    return np.flatnonzero(model.observation_block == number)


def body_residuals(model: RecordingModel, y: Array) -> tuple[Array, Array]:
    """Residuals in body axes with the sign of N (16), and their sigma under M0, both (m, 3) rad.

    Parameters
    ----------
    model : the linear model
    y : (N,) whitened, projected residuals
    """
    residual = np.empty((len(model.observation_attitude), 3))
    sigma = np.empty_like(residual)
    own_y, nuisance = model.unmixed(y), model.unmixed(model.nuisance)
    for number, block in enumerate(model.blocks):
        rows = _rows(model, number)
        L, Q, C = block.whitener, nuisance[block.rows], model.known_mountings[block.rows]
        A = model.observation_attitude[rows].transpose(0, 2, 1)
        level = (L @ own_y[block.rows]).reshape(-1, 3)
        residual[rows] = -np.einsum("mij,mj->mi", A, level)
        S = L @ L.T + (L @ C) @ (L @ C).T - (L @ Q) @ (L @ Q).T
        own = S.reshape(len(rows), 3, len(rows), 3)[np.arange(len(rows)), :, np.arange(len(rows)), :]
        sigma[rows] = np.sqrt(np.maximum(np.einsum("mij,mjk,mik->mi", A, own, A), 0.0))
    return residual, sigma


def compute_statistics(model: RecordingModel) -> pd.DataFrame:
    """Compute χ² of each interval, axis and phase, a row each; `start_s` and `stop_s` are since the start of the interval."""
    kinds, A = phases(model), model.observation_attitude.transpose(0, 2, 1)
    e = np.matmul(A, model.y.reshape(-1, 3, 1))[:, :, 0]
    basis = np.matmul(A, model.nuisance.reshape(*e.shape, -1))
    records = []
    for number, block in enumerate(model.blocks):
        interval = model.recording.intervals[block.interval]
        for phase in PHASES:
            chosen = np.flatnonzero((model.observation_block == number) & (kinds == phase))
            if not chosen.size:
                continue
            start_s, stop_s = model.observation_t_s[chosen[[0, -1]]] - interval.start_s
            for axis in range(3):
                own = basis[chosen, axis]
                value, dof = chi2(e[chosen, axis], np.eye(chosen.size) - own @ own.T)
                if dof:
                    p = max(float(scipy.stats.chi2.sf(value, dof)), 1e-300)
                    records.append((interval.name, "xyz"[axis], phase, "chi2", value, dof, p, float(start_s), float(stop_s)))
    columns = ["interval", "axis", "phase", "statistic", "value", "dof", "p_value", "start_s", "stop_s"]
    return pd.DataFrame.from_records(records, columns=columns)


def chi2(r: Array, S: Array) -> tuple[float, int]:
    """χ² of residuals (k,) of covariance S (k, k), which may be singular, and its degrees of freedom."""
    values, vectors = np.linalg.eigh(S)
    kept = values > 1e-8 * max(values[-1], 1e-300)
    along = vectors[:, kept].T @ r
    return float(np.sum(along**2 / values[kept])), int(kept.sum())


def holm(p: Array) -> Array:
    """Holm's adjusted p-values."""
    order = np.argsort(p)
    adjusted = np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1))
    out = np.empty_like(p)
    out[order] = np.minimum(adjusted, 1.0)
    return out


def benjamini_hochberg(p: Array, rate: float = 0.05) -> NDArray[np.bool_]:
    """Which are marked at a false discovery rate."""
    order = np.argsort(p)
    below = p[order] <= rate * np.arange(1, p.size + 1) / p.size
    count = int(np.flatnonzero(below)[-1]) + 1 if below.any() else 0
    out = np.zeros(p.size, dtype=bool)
    out[order[:count]] = True
    return out


def findings(table: pd.DataFrame, level: float = 0.01) -> Sequence[Finding]:
    """The strongest blocks after Holm's correction."""
    adjusted = holm(table["p_value"].to_numpy())
    found = []
    for k in np.argsort(table["p_value"].to_numpy())[:MOST_FINDINGS]:
        if adjusted[k] > level:
            break
        row = table.iloc[int(k)]
        times = (float(row["start_s"]), float(row["stop_s"]))
        text = (
            f"{row['interval']}, {row['phase']}, axis {row['axis']}: χ² {row['value']:.0f} ({row['dof']} expected), "
            f"{times[0]:.0f} to {times[1]:.0f} s after its start"
        )
        found.append(
            Finding(
                "attitude", str(row["interval"]), str(row["axis"]), times, "chi2", float(row["value"]), float(adjusted[k]), text
            )
        )
    return found
