"""What a set of effects makes of R's data beside Table 3: Table 2, R (3) and R (6); `studies.robertson.all_data` compares.

Table 2's change with the calibration is flown, a maneuver from +x to −x with the tables of before and of after it. R (3) is
found of flown telemetry of the early orbits by R's first algorithm. R (6) is computed for the sensors as they sit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.mission_mode.config import MissionConfig, crossing_compensation, period_tables, uploads
from simulator.mission_mode.flight import simulate_mission
from simulator.sensors.sun import trmm_alignments
from studies.robertson.calendar import ORBITS_TO_SLEW, PERIODS, slew_flight
from studies.robertson.end_to_end import alignments
from studies.robertson.ground import AXES
from studies.robertson.windows import configured

Array = NDArray[np.float64]

MANEUVER = "+x to -x"
SEEDS = 2
ALL_ANGLES_DEG = (0.0, 58.4)
TABLE2, R3, R6 = "R Table 2", "R (3)", "R (6)"
NAMES = (
    *(f"change_{axis}_deg" for axis in AXES),
    *(f"m_{axis}_deg" for axis in "xyz"),
    *(f"{number}_{k}_1e6" for k in (1, 2) for number in ("c", "d")),
)
BLOCKS = dict(zip(NAMES, [*(TABLE2,) * 3, *(R3,) * 3, *(R6,) * 4], strict=True))


def further(effects: Sequence[str], entropy: int) -> dict[str, float]:
    """The numbers `NAMES` for a set of effects, and the scatter of R (3)'s between the early orbits, "scatter_m_…"."""
    config = configured(effects)
    turns = np.rad2deg(alignments(config, config.tables, entropy)[0])
    spread = turns.std(axis=0, ddof=1) / np.sqrt(len(turns))
    values = [*table2_change(config, entropy), *turns.mean(axis=0), *coefficients(config)]
    return {
        **{name: float(value) for name, value in zip(NAMES, values, strict=True)},
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


def coefficients(config: MissionConfig, angles_deg: tuple[float, float] = ALL_ANGLES_DEG) -> Array:
    """c − 1 and d of DSS-1 and DSS-2, (4,) 1e-6, for the sensors as they sit; angles as of `crossing_compensation`."""
    tables, nominal = uploads(config)[0], trmm_alignments(*config.boresights)
    parts = zip(config.sun_sensors, tables.misalignments, nominal, strict=True)
    pairs = [crossing_compensation(*one, tables.coefficients_beta[k], angles_deg) for k, one in enumerate(parts)]
    return 1e6 * np.array([value for c, d in pairs for value in (c - 1, d)])
