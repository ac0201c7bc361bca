"""What a set of effects makes of R's data beside Table 3: Table 2 and R (3); `studies.robertson.combined_diagnosis` compares.

Table 2's change with the calibration is flown, a maneuver from +x to −x with the tables of before and of after it. R (3) is
found of flown telemetry of the early orbits by R's first algorithm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.mission_mode.config import MissionConfig, build_period_tables
from simulator.mission_mode.flight import simulate_mission
from studies.robertson.calendar import ORBITS_TO_SLEW, PERIODS, build_slew_config
from studies.robertson.end_to_end import estimate_orbit_alignments
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.windows import apply_mission_effects

Array = NDArray[np.float64]

MANEUVER = "+x to -x"
FURTHER_SEEDS = 2
TABLE2, R3 = "R Table 2", "R (3)"
NUMBER_SOURCES = {f"change_{axis}_deg": TABLE2 for axis in ROTATION_NAMES} | {f"m_{axis}_deg": R3 for axis in "xyz"}


def compute_further_numbers(effects: Sequence[str], entropy: int) -> dict[str, float]:
    """Compute the numbers of `NUMBER_SOURCES` for a set of effects, and the scatter of R (3)'s, "scatter_m_…"."""
    config = apply_mission_effects(effects)
    turns = np.rad2deg(estimate_orbit_alignments(config, config.tables, entropy)[0])
    spread = turns.std(axis=0, ddof=1) / np.sqrt(len(turns))
    values = [*compute_table2_change(config, entropy), *turns.mean(axis=0)]
    return {
        **{name: float(value) for name, value in zip(NUMBER_SOURCES, values, strict=True)},
        **{f"scatter_m_{axis}_deg": float(value) for axis, value in zip("xyz", spread, strict=True)},
    }


def compute_table2_change(config: MissionConfig, entropy: int) -> Array:
    """Compute by how much the calibration reduces the miss of the yaw maneuver, (3,) deg, mean over `FURTHER_SEEDS`."""
    tables = build_period_tables(config)
    span = (ORBITS_TO_SLEW + 0.5) * config.orbit.period
    misses = {
        name: np.array(
            [
                _simulate_slew_miss(build_slew_config(config, tables[name], MANEUVER), span, entropy + k)
                for k in range(FURTHER_SEEDS)
            ]
        )
        for name in PERIODS[1:]
    }
    return np.asarray((misses[PERIODS[1]] - misses[PERIODS[2]]).mean(axis=0))


def _simulate_slew_miss(config: MissionConfig, span: float, seed: int) -> list[float]:
    slew = simulate_mission(config, seconds=span, seed=seed, telemetry_every=None).slews.iloc[0]
    return [-float(slew[f"targeting_{axis}_deg"]) for axis in ROTATION_NAMES]
