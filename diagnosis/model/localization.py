"""Localization: where a recording departs from M0, by χ² of the residuals in each interval, axis and phase.

Residuals of the M0 fit have the covariance S = L (I − Q Qᵀ) Lᵀ, with L the Cholesky factor of the observations' covariance
and Q the basis of what was fitted. For the residuals r_B of one block, r_Bᵀ S_BB⁺ r_B is χ² with rank(S_BB) degrees of
freedom under M0, whatever else correlates with it. Holm's correction decides whether any block departs, Benjamini–Hochberg
which ones are marked.
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


def statistics(model: RecordingModel, y: Array) -> pd.DataFrame:
    """χ² of each interval, axis and phase: columns interval, axis, phase, statistic, value, dof, p_value, start_s, stop_s."""
    kinds = phases(model)
    records = []
    own_y, nuisance = model.unmixed(y), model.unmixed(model.nuisance)
    for number, block in enumerate(model.blocks):
        rows = _rows(model, number)
        m = len(rows)
        L, Q, C = block.whitener, nuisance[block.rows], model.known_mountings[block.rows]
        turn = np.zeros((3 * m, 3 * m))
        for k, row in enumerate(rows):
            turn[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = -model.observation_attitude[row].T
        M = turn @ L
        r = M @ own_y[block.rows]
        S = M @ M.T + (M @ C) @ (M @ C).T - (M @ Q) @ (M @ Q).T
        t = model.observation_t_s[rows]
        begin = model.recording.intervals[block.interval].start_s
        for phase in PHASES:
            chosen = np.flatnonzero(kinds[rows] == phase)
            if not chosen.size:
                continue
            for axis in range(3):
                places = 3 * chosen + axis
                value, dof = chi2(r[places], S[np.ix_(places, places)])
                if not dof:
                    continue
                p = max(float(scipy.stats.chi2.sf(value, dof)), 1e-300)
                name = model.recording.intervals[block.interval].name
                records.append(
                    (name, "xyz"[axis], phase, "chi2", value, dof, p, float(t[chosen[0]] - begin), float(t[chosen[-1]] - begin))
                )
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
