"""Whether there is a gap and where: tests of the motion's and the noise's numbers, corrected for their count."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import chdtrc

from studies.natanson import flight
from studies.natanson.flight_diagnosis.numbers import motion_covariance, noise_numbers, prepare
from studies.natanson.flight_diagnosis.table import MILLIDEGREE, Baseline, Table, outcome, present

Array = NDArray[np.float64]


def holm(p_values: Array) -> Array:
    """Holm's corrected p-values."""
    order = np.argsort(p_values)
    stepped = np.maximum.accumulate((len(p_values) - np.arange(len(p_values))) * p_values[order])
    out = np.empty(len(p_values))
    out[order] = np.minimum(stepped, 1.0)
    return out


def gap_test(table: Table, baseline: Baseline) -> dict[str, float]:
    """χ² of the motion's 18 and of the noise's 42 numbers under the baseline, the latter two-sided, and Holm's p of both."""
    case = prepare(table, baseline)
    motion_chi2 = float(case.d @ np.linalg.solve(case.covariance, case.d))
    Theta = np.array([outcome(section)[1] for section in case.sections])
    z, z_print = noise_numbers(table, Theta, baseline)
    noise_chi2 = float(np.sum(z**2 / (1 + z_print)))
    upper = float(chdtrc(42, noise_chi2))
    p = holm(np.array([chdtrc(18, motion_chi2), 2 * min(upper, 1 - upper)]))
    return {
        "motion_chi2": motion_chi2,
        "motion_p": float(p[0]),
        "noise_chi2": noise_chi2,
        "noise_p": float(p[1]),
        "p_value": float(p.min()),
    }


def where(table: Table, baseline: Baseline) -> pd.DataFrame:
    """A row per number and per interval: d over its sigma, χ², and Holm's p over the 18 numbers and over the six intervals."""
    case = prepare(table, baseline)
    z = case.d / np.sqrt(np.diag(case.covariance))
    blocks = [slice(3 * k, 3 * k + 3) for k in range(6)]
    chi2 = np.array([case.d[b] @ np.linalg.solve(case.covariance[b, b], case.d[b]) for b in blocks])
    numbers = holm(chdtrc(1, z**2))
    intervals = holm(chdtrc(3, chi2))
    rows = [
        {
            "interval": k + 1,
            "axis": axis,
            "gap_deg": (table.before.ravel() - case.prediction)[3 * k + j],
            "beyond_calibration_deg": case.d[3 * k + j],
            "sigma_deg": float(np.sqrt(case.covariance[3 * k + j, 3 * k + j])),
            "chi2": float(z[3 * k + j] ** 2),
            "p_holm": numbers[3 * k + j],
            "interval_chi2": chi2[k],
            "interval_p_holm": intervals[k],
        }
        for k in range(6)
        for j, axis in enumerate(flight.ROTATIONS)
    ]
    return pd.DataFrame(rows)


def by_step() -> pd.DataFrame:
    """y − c − prediction under the present baseline at every step, each with its own calibration of N Table 3, deg.

    A check that shares no print but that of the pre-launch parameters: what is motion is the same in all three columns.
    """
    sections = present().scenario.interval
    theta, Theta = (np.array(part) for part in zip(*(outcome(section) for section in sections), strict=True))
    digits = np.where(np.eye(3, dtype=bool).ravel(), 1e-5, MILLIDEGREE)
    table3 = np.append(digits, np.deg2rad([1e-6] * 3))
    H = Theta.reshape(18, 12)
    rows = []
    for step in flight.STEPS:
        exact = step == flight.STEPS[0]  # R (9)
        used = flight.calibration() if exact else flight.parameters("calibrated", step)
        after = flight.residuals("calibrated", step)
        gap = flight.residuals("prelaunch", step) - after - theta + Theta @ (used.vector - flight.calibration().vector)
        covariance = motion_covariance(Theta, sections) + (0 if exact else H * table3**2 / 12 @ H.T)
        sigma = np.sqrt(np.diag(covariance)).reshape(6, 3)
        rows += [
            {
                "step_s": step,
                "interval": k + 1,
                "axis": axis,
                "gap_deg": gap[k, j],
                "sigma_deg": sigma[k, j],
                "after_deg": after[k, j],
            }
            for k in range(6)
            for j, axis in enumerate(flight.ROTATIONS)
        ]
    return pd.DataFrame(rows)
