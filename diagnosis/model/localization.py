"""Localization: where a recording departs from M0, by χ² of the innovations in each interval, axis and phase.

The whitened observations y are innovations in the order of time, with the covariance S = I − Q Qᵀ, Q the basis of what was
fitted. For those of one block, y_Bᵀ S_BB⁺ y_B is χ² with rank(S_BB) degrees of freedom under M0. Bonferroni's correction
decides which blocks are reported.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import scipy.special
from numpy.typing import NDArray

from diagnosis.answer import Finding, format_span
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices

PHASES = ("start", "slew", "hold", "end")

EDGE = 0.1  # share of an interval's references that count as its start or end
HOLE = 2.5  # times the usual spacing; a slew lies between two such references
MOST = 6  # findings
SIGNIFICANT = 0.01  # p-value of a finding, with an allowance for the number of blocks


def label_phases(t_s: Array, interval: Indices) -> NDArray[np.str_]:
    """Label the phase of references (m,) at some times, s, of intervals that follow one another."""
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


def compute_body_residuals(model: RecordingModel, y: Array) -> tuple[Array, Array]:
    """Compute residuals in body axes with the sign of N (16), and their sigma under M0, from whitened ones (N,): (m, 3) rad."""
    residual, variance = np.empty((2, len(model.observation_attitude), 3))
    for number, block in enumerate(model.blocks):
        mine = model.observation_block == number
        L = block.whitener.reshape(-1, 3, len(block.whitener))
        turned = np.matmul(model.observation_attitude[mine].transpose(0, 2, 1), L)
        residual[mine] = -turned @ y[block.rows]
        variance[mine] = np.sum(turned**2, axis=2) - np.sum((turned @ model.nuisance[block.rows]) ** 2, axis=2)
    return residual, np.sqrt(np.maximum(variance, 0.0))


def compute_statistics(model: RecordingModel) -> pd.DataFrame:
    """Compute χ² of each interval, axis and phase, a row each; `start_s` and `stop_s` are since the start of the interval."""
    kinds, A = label_phases(model.observation_t_s, model.observation_block), model.observation_attitude.transpose(0, 2, 1)
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
                nuisance_basis = basis[chosen, axis]
                value, dof = compute_chi2(e[chosen, axis], np.eye(chosen.size) - nuisance_basis @ nuisance_basis.T)
                if dof:
                    p = max(float(scipy.special.chdtrc(dof, value)), 1e-300)
                    records.append((interval.name, "xyz"[axis], phase, "chi2", value, dof, p, float(start_s), float(stop_s)))
    columns = ["interval", "axis", "phase", "statistic", "value", "dof", "p_value", "start_s", "stop_s"]
    return pd.DataFrame.from_records(records, columns=columns)


def compute_chi2(r: Array, S: Array) -> tuple[float, int]:
    """Compute χ² of residuals (k,) of covariance S (k, k), which may be singular, and its degrees of freedom."""
    values, vectors = np.linalg.eigh(S)
    kept = values > 1e-8 * max(values[-1], 1e-300)
    along = vectors[:, kept].T @ r
    return float(np.sum(along**2 / values[kept])), int(kept.sum())


def list_findings(table: pd.DataFrame) -> Sequence[Finding]:
    """List the strongest blocks whose p-value times the number of blocks (Bonferroni) is significant."""
    findings = []
    for row in table.nsmallest(MOST, "p_value").to_dict("records"):
        p = row["p_value"] * len(table)
        if p > SIGNIFICANT:
            break
        text = (
            f"{row['interval']}, {row['phase']}, axis {row['axis']}: χ² {row['value']:.0f} ({row['dof']} expected), "
            f"{format_span(row['start_s'], row['stop_s'])} after its start"
        )
        times = (row["start_s"], row["stop_s"])
        findings.append(Finding("attitude", row["interval"], row["axis"], times, "chi2", row["value"], p, text))
    return findings
