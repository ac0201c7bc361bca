"""R (8) on the months: the gyro bias an attitude solution finds at +1 and −1 RPO, and what the formula says it must be.

While the rate is constant a wrong G looks like a bias, b' = ω − G ω_raw with the G that the solution uses and
ω_raw = G_true⁻¹ (ω − b). With G = I that is R (8). On board G was that of before launch (N Table 3).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from simulator.mission_mode.config import PRELAUNCH_G, R9_BIAS, R9_G, MissionConfig
from simulator.mission_mode.flight import MissionRun
from studies.robertson.ground import DEG_H_PER_RAD_S
from studies.robertson.performance import GYRO_AXES, select_full_orbits, select_period

Array = NDArray[np.float64]
USED_G = {"calibration1": PRELAUNCH_G, "postcalibration": R9_G}


def compute_solved_bias(G: Array, forward: str) -> Array:
    """b' at ∓1 RPO about y, flying +x or −x forward, with G in the solution; (3,) rad/s."""
    orbit = MissionConfig().orbit
    rate = orbit.mean_motion + orbit.nodal_rate * np.cos(orbit.inclination)
    omega = np.array([0.0, -rate if forward == "+x" else rate, 0.0])
    return np.asarray(omega - G @ np.linalg.solve(R9_G, omega - R9_BIAS))


def build_apparent_bias_table(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """Mean bias seen in each orientation before and after the gyro's upload, its standard error, and the formula; deg/h."""
    rows = []
    for period, G in USED_G.items():
        orbits = pd.concat([select_full_orbits(select_period(run.orbits, period)) for run in runs])
        for axis, angle in GYRO_AXES.items():
            means, errors, formula = np.empty(2), np.empty(2), np.empty(2)
            for k, forward in enumerate(("+x", "-x")):
                values = orbits.loc[orbits["forward"] == forward, f"apparent_bias_{angle}_deg_h"].to_numpy(dtype=float)
                means[k] = values.mean() if len(values) else np.nan
                errors[k] = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.nan
                formula[k] = compute_solved_bias(G, forward)["xyz".index(axis)] * DEG_H_PER_RAD_S
                rows.append((period, axis, forward, means[k], errors[k], formula[k]))
            spread = np.hypot(errors[0], errors[1])
            rows.append((period, axis, "-x minus +x", means[1] - means[0], spread, formula[1] - formula[0]))
    names = ["period", "axis", "forward", "simulated_deg_h", "standard_error_deg_h", "formula_deg_h"]
    table = pd.DataFrame(rows, columns=names)
    return table.assign(simulated_minus_formula_deg_h=table["simulated_deg_h"] - table["formula_deg_h"])
