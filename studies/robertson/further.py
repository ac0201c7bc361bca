"""What a set of effects makes of R's data beside Table 3: Table 2 and R (3); `studies.robertson.all_data` compares.

Table 2's change with the calibration is flown, a maneuver from +x to −x with the tables of before and of after it. R (3) is
found of flown telemetry of the early orbits by R's first algorithm.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.mission_mode.config import MissionConfig, period_tables
from simulator.mission_mode.flight import simulate_mission
from studies.robertson.calendar import ORBITS_TO_SLEW, PERIODS, slew_flight
from studies.robertson.end_to_end import alignments
from studies.robertson.flown import AXES
from studies.robertson.windows import configured

Array = NDArray[np.float64]

MANEUVER = "+x to -x"
SEEDS = 2
TABLE2, R3 = "R Table 2", "R (3)"
BLOCKS = {f"change_{axis}_deg": TABLE2 for axis in AXES} | {f"m_{axis}_deg": R3 for axis in "xyz"}


def further(effects: Sequence[str], entropy: int) -> dict[str, float]:
    """The numbers of `BLOCKS` for a set of effects, and the scatter of R (3)'s between the early orbits, "scatter_m_…"."""
    config = configured(effects)
    turns = np.rad2deg(alignments(config, config.tables, entropy)[0])
    spread = turns.std(axis=0, ddof=1) / np.sqrt(len(turns))
    values = [*table2_change(config, entropy), *turns.mean(axis=0)]
    return {
        **{name: float(value) for name, value in zip(BLOCKS, values, strict=True)},
        **{f"scatter_m_{axis}_deg": float(value) for axis, value in zip("xyz", spread, strict=True)},
    }


def table2_change(config: MissionConfig, entropy: int) -> Array:
    """Miss of the yaw maneuver with the tables before less after the gyro's calibration, (3,) deg, mean over `SEEDS`."""
    tables = period_tables(config)
    span = (ORBITS_TO_SLEW + 0.5) * config.orbit.period
    misses = {
        name: np.array([_miss(slew_flight(config, tables[name], MANEUVER), span, entropy + k) for k in range(SEEDS)])
        for name in PERIODS[1:]
    }
    return np.asarray((misses[PERIODS[1]] - misses[PERIODS[2]]).mean(axis=0))


def _miss(config: MissionConfig, span: float, seed: int) -> list[float]:
    slew = simulate_mission(config, seconds=span, seed=seed, telemetry_every=None).slews.iloc[0]
    return [-float(slew[f"targeting_{axis}_deg"]) for axis in AXES]
