"""Single orbits through the months, each flown for itself with some effects and solved on the ground.

Two orbits with the tables of the day let the yaw updates settle, the third is R's "at least a full orbit of data": its
on-board attitude is compared with the ground's batch and with the truth, and its batch gives a bias. Days are spread evenly
over each of R's periods; a walk of the gyro's bias goes on from day to day by a path of its own, the same in every rung.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from simulator.mission_mode.config import DAY, MissionConfig, build_period_tables
from simulator.mission_mode.effects import apply_mission_settings, parse
from simulator.mission_mode.flight import simulate_mission
from simulator.streams import generator
from studies.robertson import published_tables
from studies.robertson.calendar import FIRST_DAYS, PERIODS, convert_to_mission_day, shift_mission_start
from studies.robertson.ground import solve_ground_attitude
from studies.robertson.published_tables import ROTATION_NAMES

Array = NDArray[np.float64]
Number = tuple[str, str, str]  # parameter, axis and period of R Table 3

SETTLING = 2.0  # orbits before the one that is solved, four yaw updates
PERIOD_COUNTS = {"precalibration": 4, "calibration1": 10, "postcalibration": 8}
SETTLED_UPDATES = 3
ANGLE_STATISTICS = ("attitude_accuracy_deg", "yaw_update_deg")
WINDOW_NUMBERS: tuple[Number, ...] = tuple(
    (parameter, axis, period)
    for period in PERIODS
    for parameter, axes in (
        ("attitude_accuracy_deg", ROTATION_NAMES),
        ("yaw_update_deg", ("yaw",)),
        ("gyro_bias_std_deg_h", "xyz"),
    )
    for axis in axes
    if parameter in ANGLE_STATISTICS or period != PERIODS[0]
)
"""R Table 3's 18 numbers."""


def place_windows(period: str, count: int) -> Array:
    """Days from launch of a period's windows."""
    start, stop = (convert_to_mission_day(moment, MissionConfig()) for moment in FIRST_DAYS[period])
    return np.asarray(start + (stop - start) * (np.arange(count) + 0.5) / count)


def apply_mission_effects(effects: Sequence[str]) -> MissionConfig:
    """The spacecraft with effects, as of `gyrocal mission --effect`."""
    return apply_mission_settings(MissionConfig(), [parse(text) for text in effects])


def simulate_window(effects: Sequence[str], period: str, k: int, count: int, entropy: int) -> dict[str, Any]:
    """Simulate one orbit and solve it on the ground; a row of numbers."""
    config = apply_mission_effects(effects)
    tables, day = build_period_tables(config), float(place_windows(period, count)[k])
    seed = entropy + 1000 * PERIODS.index(period) + k
    flying = replace(shift_mission_start(config, day), tables=tables[period])
    flying = replace(flying, gyro=replace(flying.gyro, bias=flying.gyro.bias + simulate_bias_walk(flying, day, entropy)))
    span = config.orbit.period
    run = simulate_mission(flying, seconds=(SETTLING + 1.0) * span, seed=seed, telemetry_every=1)
    sent = run.telemetry[run.telemetry["t_s"] >= SETTLING * span]
    row: dict[str, Any] = {"period": period, "day": day, "forward": flying.forward}
    row["yaw_update_deg"] = float(run.updates["update_deg"].abs()[SETTLED_UPDATES:].mean())
    row["sun_angle_deg"] = float(run.updates["sun_angle_deg"].mean())
    row |= solve_ground_attitude(flying, sent, tables[period], generator(seed, 0, "ground_sun_sensors")).row()
    return row


def simulate_bias_walk(config: MissionConfig, day: float, entropy: int) -> Array:
    """Simulate the random walk of the bias since launch, (3,) rad/s; one path, scaled by the size of a day's step."""
    rrw = np.broadcast_to(np.asarray(config.gyro.rrw, dtype=float), 3)
    steps = generator(entropy, 0, "bias_walk").standard_normal((400, 3))
    return np.asarray(rrw * np.sqrt(DAY) * steps[: round(day)].sum(axis=0))


def find_number_column(number: Number, against: str = "onboard_minus_ground") -> str:
    """The windows' column that a number of R Table 3 is formed of."""
    parameter, axis, _ = number
    of_angles = {"attitude_accuracy_deg": f"{against}_{axis}_deg", "yaw_update_deg": "yaw_update_deg"}
    return of_angles.get(parameter, f"bias_{axis}_deg_h")


def summarise_windows(number: Number, values: Array) -> Array:
    """A number of R Table 3 of windows (…, n): a mean, or the standard deviation of the bias."""
    return np.asarray(values.mean(axis=-1) if number[0] in ANGLE_STATISTICS else values.std(axis=-1, ddof=1))


def compute_simulated_numbers(rows: pd.DataFrame, against: str = "onboard_minus_ground") -> dict[Number, float]:
    """R Table 3's numbers of windows; against "onboard_minus_true" for the truth in place of the ground."""
    parts = {period: rows[rows["period"] == period] for period in PERIODS}
    return {
        number: float(summarise_windows(number, parts[number[2]][find_number_column(number, against)].to_numpy(dtype=float)))
        for number in WINDOW_NUMBERS
    }


def estimate_relative_error(rows: pd.DataFrame) -> dict[Number, float]:
    """Relative standard error of each number by the windows' scatter, which the flight's own finite record shares."""
    out = {}
    for number in WINDOW_NUMBERS:
        own = rows.loc[rows["period"] == number[2], find_number_column(number)]
        n = len(own)
        out[number] = float(own.std() / np.sqrt(n) / own.mean() if number[0] in ANGLE_STATISTICS else 1 / np.sqrt(2 * (n - 1)))
    return out


def read_published_numbers() -> dict[Number, float]:
    """R Table 3."""
    return {number: published_tables.read_published_performance(*number) for number in WINDOW_NUMBERS}


def compute_rms_factor(values: Mapping[Number, float] | Mapping[Number, Array], numbers: Sequence[Number]) -> Any:
    """RMS factor between simulated and flown over some numbers: exp of the RMS of the logarithm of their ratio."""
    if not numbers:
        return float("nan")
    logs = [np.log(values[one] / published_tables.read_published_performance(*one)) for one in numbers]
    return np.exp(np.sqrt(np.mean(np.square(logs), axis=0)))
