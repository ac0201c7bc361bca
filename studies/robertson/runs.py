"""The flights of the reproduction of R, as cases of a study.

`months`, one a seed: launch to the end of April 1998 with the uploads and yaw maneuvers on their days; telemetry is not kept.
`slew`: the yaw maneuvers of N's intervals 2 and 6, with the gyro's parameters of before and after its calibration, over seeds.
`yaw`: eight orbits early in December and in March, with telemetry every 10 s.
`spikes`: four orbits with the Sun passing through a quadrant of the Earth sensor, for three states of the S filter.
`window`: single orbits through the months with effects, see `studies.robertson.ladder`.

A flight is a case of a study, so that finished flights are kept if a run is stopped. Its rows are those of its tables.
"""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import Field

from simulator.mission_mode.calendar import compute_sun_angle
from simulator.mission_mode.config import DAY, MissionConfig, build_period_tables
from simulator.mission_mode.flight import MissionRun, build_flight_schedule, simulate_mission
from simulator.sensors.earth import Filter
from studies.montecarlo.study import GridConfig, Streams, Study
from studies.robertson.calendar import ORBITS_TO_SLEW, YAW_MANEUVER_TIMES, build_slew_config, shift_mission_start
from studies.robertson.ladder import PERIOD_COUNTS, SETS, simulate_window

DAYS = 154.2  # from launch to the end of April 1998
SLEW_TABLES = ("calibration1", "postcalibration")  # both maneuvers came after the alignment's upload
YAW_DAYS = {"precalibration": 6.0, "postcalibration": 100.0}  # from launch; R does not say when its figures 7 and 12 are from
YAW_ORBITS = 8.0
SPIKE_ORBITS = 4.0
SLEW_ORBITS = ORBITS_TO_SLEW + 0.5
SPIKE_SUN_DEG = 42.0  # from the XZ plane; the Sun then passes a quadrant's view once an orbit
SPIKE_FILTERS: tuple[Filter, ...] = ("restarted", "correct", "off")
KEPT_TABLES = {  # tables of each kind of flight that the reproduction uses
    "months": ("orbits", "updates"),
    "yaw": ("telemetry", "updates"),
    "spikes": ("telemetry",),
    "slew": ("slews",),
}

WINDOW = "window"  # flown for the ladder's sets of effects
Name = tuple[str, ...]  # of a flight: its kind, and its identifiers within the kind
Runs = dict[Name, MissionRun]


class MissionStudy(GridConfig):
    """What is flown; seeds are counted from the entropy."""

    axes: ClassVar = ("seeds", "slews")
    days: float = Field(default=DAYS, gt=0)  # of the months from launch; R's periods end on May 1, 1998
    seeds: int = Field(default=1, ge=1)  # of the months
    slews: int = Field(default=20, ge=1)  # seeds of the yaw maneuver
    windows: bool = True  # whether the ladder's windows are flown

    def points(self) -> list[Name]:
        """List the name of each flight, the longest first."""
        seeds = map(str, range(self.slews))
        names: list[Name] = [("months", str(k)) for k in range(self.seeds)]
        names += [*(("yaw", period) for period in YAW_DAYS), *(("spikes", state) for state in SPIKE_FILTERS)]
        names += [("slew", *identifiers) for identifiers in product(YAW_MANEUVER_TIMES, SLEW_TABLES, seeds)]
        if self.windows:
            windows = [(period, str(k)) for period, count in PERIOD_COUNTS.items() for k in range(count)]
            names += [(WINDOW, str(effects), *window) for effects, window in product(range(len(SETS)), windows)]
        return names


def find_spike_day(config: MissionConfig) -> float:
    """Find the first day after R's alignment upload on which the Sun is SPIKE_SUN_DEG from the orbit plane."""
    days = np.arange(14.0, 60.0, 0.05)
    angle = np.abs(np.rad2deg(compute_sun_angle(config.epoch, config.orbit, days * DAY)))
    return float(days[np.argmax(angle >= SPIKE_SUN_DEG)])


def fly_mission(study: MissionStudy, name: Name) -> MissionRun:
    """Fly the flight of a name, of those without effects."""
    base, seed, (kind, *identifiers) = MissionConfig(), study.entropy, name
    period, tables = base.orbit.period, build_period_tables()
    telemetry_every: int | None = None
    if kind == "months":
        config, seconds = build_flight_schedule(base, study.days), study.days * DAY
        seed += int(identifiers[0])
    elif kind == "yaw":
        config = replace(shift_mission_start(base, YAW_DAYS[identifiers[0]]), tables=tables[identifiers[0]])
        seconds, telemetry_every = YAW_ORBITS * period, 20
    elif kind == "spikes":
        s_filter: Filter = identifiers[0]  # type: ignore[assignment]
        flight_tables = replace(tables["postcalibration"], s_filter=s_filter)
        config = replace(shift_mission_start(base, find_spike_day(base)), tables=flight_tables)
        seconds, telemetry_every = SPIKE_ORBITS * period, 4
    else:
        maneuver, upload, number = identifiers
        config, seconds = build_slew_config(base, tables[upload], maneuver), SLEW_ORBITS * period
        seed += int(number)
    # With a progress function the simulation returns to Python once a day, which lets Ctrl-C through.
    return simulate_mission(config, seconds=seconds, seed=seed, telemetry_every=telemetry_every, progress=lambda days: None)


def run_case(config: MissionStudy, number: int, streams: Streams) -> list[dict[str, Any]]:
    """Simulate a flight: a row for each row of its tables that the reproduction uses."""
    name = config.points()[number]
    if name[0] == WINDOW:
        _, effects, period, k = name
        return [{"table": WINDOW, **simulate_window(SETS[int(effects)], period, int(k), PERIOD_COUNTS[period], config.entropy)}]
    run = fly_mission(config, name)
    return [{"table": table, **row} for table in KEPT_TABLES[name[0]] for row in getattr(run, table).to_dict("records")]


STUDY = Study("studies.robertson.runs:STUDY", MissionStudy, run_case)


def load_flights(config: MissionStudy, path: Path) -> Runs:
    """Load the flights from the study's table; tables that are not kept are empty."""
    rows = pq.read_table(path)
    names = ("telemetry", "updates", "slews", "orbits")
    return {
        flight: MissionRun(**{name: _select_flight_table(rows, number, name) for name in names})
        for number, flight in enumerate(config.points())
        if flight[0] != WINDOW
    }


def load_windows(path: Path) -> dict[tuple[str, ...], pd.DataFrame]:
    """Load the windows of each set of effects from the study's table."""
    rows = _drop_empty_columns(pq.read_table(path, filters=pc.field("table") == WINDOW)).to_pandas()
    count = sum(PERIOD_COUNTS.values())  # windows of a set; sets follow one another
    return {effects: rows.iloc[k * count : (k + 1) * count].reset_index(drop=True) for k, effects in enumerate(SETS)}


def _select_flight_table(rows: pa.Table, number: int, name: str) -> pd.DataFrame:
    """Select one table of one flight; in Arrow, which distinguishes NaN from a missing value."""
    return _drop_empty_columns(rows.filter((pc.field("case") == number) & (pc.field("table") == name))).to_pandas()


def _drop_empty_columns(rows: pa.Table) -> pa.Table:
    """Drop the empty columns, those of the engine and the table's name."""
    return rows.select([column for column in rows.column_names[3:] if rows[column].null_count < len(rows)])
