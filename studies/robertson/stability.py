"""R Table 1's stability, 0.1° peak to peak in a second: what assumed sources of jitter do, and how large they would have to be.

Neither R nor N says what shakes TRMM. Three sources, each with a size that is assumed and is not TRMM's:

- an instrument that scans out of balance, a torque T that turns with it about z: the body swings by ± T/(I ω²) about x and y.
  31.6 rpm is a scan's rate, 1 N m is assumed;
- solar arrays driven in steps δ about y: the body turns back by (I_a/I) δ in each. 0.1° and I_a of 400 kg m² are assumed;
- wheels out of balance, by U_d dynamically and by U_s statically at an arm r: the torque (U_d + U_s r) ω² at the wheel's rate ω
  swings the body by ± (U_d + U_s r)/I at any rate. 1e-5 kg m² is assumed (grams times centimetres at an arm of a metre); it is
  much faster than the loop's cycle, and so is not flown.

The body is rigid: a structure that rings can swing by more, by 1/(2ζ) at resonance. The sizes that would use up the limit are
the answer here. They follow from the closed forms; what is flown shows that the controller adds little.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from simulator.mission_mode.config import MissionConfig, build_period_tables
from simulator.mission_mode.effects import apply_mission_settings, parse
from simulator.mission_mode.flight import simulate_mission
from studies.robertson import published_tables
from studies.robertson.calendar import FIRST_DAYS, PERIODS, convert_to_mission_day, shift_mission_start
from studies.robertson.published_tables import ROTATION_NAMES

CYCLES_S = (0.25, 0.5, 1.0)
DISTURBANCE_SOURCES = {"none": None, "instrument scan": ("scan_torque", 1.0), "array steps": ("array_step", 0.1)}
WHEELS_KGM2 = 1e-5
DISTURBANCE_UNITS = {"instrument scan": "N m", "array steps": "deg", "wheel imbalance": "kg m²"}
SIMULATED_ORBITS = 3.0  # of which the last is looked at


def build_stability_table(entropy: int) -> pd.DataFrame:
    """A row a source and cycle of the loop: jitter flown (deg), its closed form, and the size that alone gives R's limit."""
    limit = published_tables.read_requirement("stability")
    rows: list[dict[str, object]] = []
    for name, effect in DISTURBANCE_SOURCES.items():
        for cycle in CYCLES_S:
            row: dict[str, object] = {"source": name, "cycle_s": cycle, **simulate_jitter(effect, cycle, entropy)}
            rows.append(row if effect is None else row | _compute_limit_size(name, effect[1], limit))
    wheels = _compute_limit_size("wheel imbalance", WHEELS_KGM2, limit)
    return pd.DataFrame([*rows, {"source": "wheel imbalance", "cycle_s": np.nan, **wheels}])


def summarise_stability(table: pd.DataFrame) -> dict[str, object]:
    """Largest jitter flown by source and cycle, deg, and the sizes that use up the limit."""
    flown_rows = table[table["cycle_s"].notna()]
    largest = flown_rows[[f"{axis}_deg" for axis in ROTATION_NAMES]].max(axis=1)
    sized = table[table["size_of_limit"].notna()].drop_duplicates("source")
    return {
        "largest_deg": {
            f"{row.source}, {row.cycle_s:g} s": float(value)
            for row, value in zip(flown_rows.itertuples(), largest, strict=True)
        },
        "size_of_limit": {f"{row['source']} ({row['unit']})": float(row["size_of_limit"]) for row in sized.to_dict("records")},
    }


def simulate_jitter(effect: tuple[str, float] | None, cycle_s: float, entropy: int) -> dict[str, float]:
    """Largest peak to peak within a second over an orbit of the calibrated spacecraft, deg by axis."""
    base = MissionConfig()
    config = shift_mission_start(base, convert_to_mission_day(FIRST_DAYS[PERIODS[2]][0], base))
    config = replace(
        config, tables=build_period_tables(base)[PERIODS[2]], controller=replace(config.controller, cycle_s=cycle_s)
    )
    if effect is not None:
        config = apply_mission_settings(config, [parse(f"{effect[0]}={effect[1]:g}")])
    orbits = simulate_mission(config, seconds=SIMULATED_ORBITS * config.orbit.period, seed=entropy, telemetry_every=None).orbits
    return {f"{axis}_deg": float(orbits[f"jitter_{axis}_deg"].iloc[int(SIMULATED_ORBITS) - 1]) for axis in ROTATION_NAMES}


def compute_peak_to_peak(name: str, size: float) -> float:
    """Closed form on the axis that it moves most, deg."""
    body = MissionConfig().spacecraft
    inertia = np.diag(body.inertia)
    if name == "instrument scan":
        return float(np.rad2deg(2 * size / (inertia[:2].min() * body.scan_rate**2)))
    if name == "array steps":
        return float(size * body.array_inertia / inertia[1])
    return float(np.rad2deg(2 * size / inertia.min()))


def _compute_limit_size(name: str, size: float, limit: float) -> dict[str, object]:
    """The source's size, its closed form, and the size that gives the limit, to which it is proportional."""
    alone = compute_peak_to_peak(name, size)
    return {"size": size, "unit": DISTURBANCE_UNITS[name], "closed_form_deg": alone, "size_of_limit": size * limit / alone}
