"""From level boresights and R's printed coefficients to the flight, one effect after the other: the misfit of each rung.

A rung is a set of effects of `simulator.mission_mode.effects`. It is simulated in windows, separate single orbits through the
months. Two orbits with the tables of the day let the yaw updates settle. The third is R's "at least a full orbit of data": its
on-board attitude is compared with the ground's batch and with the truth, and its batch gives a bias. Days are spread evenly
over each of R's periods. A random walk of the gyro's bias has one path from day to day, the same in every rung.

A rung is judged by the RMS factor between simulated and flown numbers of R Table 3: over all 18, the 12 of attitude and update,
and those to which no rung so far has fitted a size. Sizes are fitted on the postcalibration period alone:

- the horizon's noise on roll and pitch there, 0.029° and 0.030°; its time constant is taken and not fitted;
- the walk of the y bias on its scatter there, 0.058 deg/h.

The effects of the rungs were chosen with all 18 numbers in view; held-out numbers do not correct for this.

R's own statistic, the geometry of the boresights, and R (6) computed for this geometry need no size. The intervals are the 0.16
and 0.84 quantiles of the factor when the windows are drawn anew with replacement: the uncertainty from one finite record.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gyrocal.arrays import Array
from simulator.mission_mode.config import DAY, MissionConfig, build_period_tables
from simulator.mission_mode.effects import apply_mission_settings, parse
from simulator.mission_mode.flight import simulate_mission
from simulator.streams import generator
from studies.robertson import published_tables
from studies.robertson.calendar import FIRST_DAYS, PERIODS, convert_to_mission_day, shift_mission_start
from studies.robertson.ground import solve_ground_attitude
from studies.robertson.published_tables import ROTATION_NAMES

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


def apply_mission_effects(effects: Sequence[str]) -> MissionConfig:
    """Return the spacecraft with effects, as of `gyrocal mission --effect`."""
    return apply_mission_settings(MissionConfig(), [parse(text) for text in effects])


def simulate_window(effects: Sequence[str], period: str, k: int, count: int, entropy: int) -> dict[str, Any]:
    """Simulate one orbit and solve it on the ground; a row of numbers."""
    config = apply_mission_effects(effects)
    start, stop = (convert_to_mission_day(moment, MissionConfig()) for moment in FIRST_DAYS[period])
    tables, day = build_period_tables(config), start + (stop - start) * (k + 0.5) / count
    seed = entropy + 1000 * PERIODS.index(period) + k
    flown = replace(shift_mission_start(config, day), tables=tables[period])
    flown = replace(flown, gyro=replace(flown.gyro, bias=flown.gyro.bias + simulate_bias_walk(flown, day, entropy)))
    span = config.orbit.period
    run = simulate_mission(flown, seconds=(SETTLING + 1.0) * span, seed=seed, telemetry_every=1)
    telemetry = run.telemetry[run.telemetry["t_s"] >= SETTLING * span]
    row: dict[str, Any] = {"period": period, "day": day, "forward": flown.forward}
    row["yaw_update_deg"] = float(run.updates["update_deg"].abs()[SETTLED_UPDATES:].mean())
    row["sun_angle_deg"] = float(run.updates["sun_angle_deg"].mean())
    row |= solve_ground_attitude(flown, telemetry, tables[period], generator(seed, 0, "ground_sun_sensors")).row()
    return row


def simulate_bias_walk(config: MissionConfig, day: float, entropy: int) -> Array:
    """Simulate the random walk of the bias since launch, (3,) rad/s; one path, scaled by the size of a day's step."""
    rrw = np.broadcast_to(np.asarray(config.gyro.rrw, dtype=float), 3)
    steps = generator(entropy, 0, "bias_walk").standard_normal((400, 3))
    return np.asarray(rrw * np.sqrt(DAY) * steps[: round(day)].sum(axis=0))


def find_number_column(number: Number, against: str = "onboard_minus_ground") -> str:
    """Find the windows' column from which a number of R Table 3 is computed."""
    parameter, axis, _ = number
    columns = {"attitude_accuracy_deg": f"{against}_{axis}_deg", "yaw_update_deg": "yaw_update_deg"}
    return columns.get(parameter, f"bias_{axis}_deg_h")


def summarise_windows(number: Number, values: Array) -> Array:
    """Compute a number of R Table 3 from windows (…, n): a mean, or the standard deviation of the bias."""
    return np.asarray(values.mean(axis=-1) if number[0] in ANGLE_STATISTICS else values.std(axis=-1, ddof=1))


def compute_simulated_numbers(rows: pd.DataFrame, against: str = "onboard_minus_ground") -> dict[Number, float]:
    """Compute R Table 3's numbers from windows, against the ground or, "onboard_minus_true", the truth."""
    parts = {period: rows[rows["period"] == period] for period in PERIODS}
    return {
        number: float(summarise_windows(number, parts[number[2]][find_number_column(number, against)].to_numpy(dtype=float)))
        for number in WINDOW_NUMBERS
    }


def estimate_relative_error(rows: pd.DataFrame) -> dict[Number, float]:
    """Estimate the relative standard error of each number, simulated or flown, from the windows' scatter."""
    out = {}
    for number in WINDOW_NUMBERS:
        values = rows.loc[rows["period"] == number[2], find_number_column(number)]
        n = len(values)
        is_mean = number[0] in ANGLE_STATISTICS  # otherwise a standard deviation, of relative error 1/√(2(n − 1))
        out[number] = float(values.std() / np.sqrt(n) / values.mean() if is_mean else 1 / np.sqrt(2 * (n - 1)))
    return out


def read_published_numbers() -> dict[Number, float]:
    """Read R Table 3."""
    return {number: published_tables.read_published_performance(*number) for number in WINDOW_NUMBERS}


def compute_rms_factor(values: Mapping[Number, float] | Mapping[Number, Array], numbers: Sequence[Number]) -> Any:
    """Compute the RMS factor between simulated and flown numbers: exp of the RMS of the logarithm of their ratio."""
    if not numbers:
        return float("nan")
    logs = [np.log(values[number] / published_tables.read_published_performance(*number)) for number in numbers]
    return np.exp(np.sqrt(np.mean(np.square(logs), axis=0)))


# ---- the ladder ------------------------------------------------------------------------------------------------------------

LEVEL_BORESIGHTS = ("boresight_elevation=0", "printed_coefficients=1")  # with the printed coefficients
HORIZON = "horizon_noise=0.0287"
WALK = "gyro_walk:y=0.018"
LADDER_DRAWS = 200
POST = PERIODS[2]


@dataclass(frozen=True)
class Rung:
    """A step of the ladder."""

    name: str  # of the effect added to the previous rung
    effects: tuple[str, ...]  # all of them
    against: str = "onboard_minus_ground"  # difference of the on-board attitude that is used
    fitted: tuple[Number, ...] = ()  # numbers of R Table 3 that a size was fitted on in this step


RUNGS = (
    Rung("landed", LEVEL_BORESIGHTS, "onboard_minus_true"),
    Rung("ground batch", LEVEL_BORESIGHTS),
    Rung("boresight_elevation", LEVEL_BORESIGHTS[1:]),
    Rung("computed coefficients", ()),
    Rung("horizon_noise", (HORIZON,), fitted=tuple((ANGLE_STATISTICS[0], axis, POST) for axis in ("roll", "pitch"))),
    Rung("gyro_walk:y", (HORIZON, WALK), fitted=(("gyro_bias_std_deg_h", "y", POST),)),
)
NOMINAL = RUNGS[3].effects
WALK_SIZE = 0.02  # deg/h/sqrt(day), trial size of a random walk's column


@dataclass(frozen=True)
class TrialEffect:
    """An effect simulated with a trial size about the nominal."""

    effect: str  # effect, axis, unit: of the candidate
    axis: str | None
    unit: str
    size: float  # flown
    limits: tuple[float, float]  # plausible range of the size
    # set of effects of the windows; empty for a walk of the bias, which is added to the nominal's
    setting: tuple[str, ...] = ()
    squared: bool = True  # whether the amplitude is the square of the size
    switch: bool = False  # whether it is either present or absent


TRIED_EFFECTS = (
    TrialEffect("horizon_noise", None, "deg", 0.0287, (0.003, 0.2), (HORIZON,)),
    TrialEffect("horizon_season", "winter lower", "deg", 0.15, (0.02, 0.6), ("horizon_season=0.15",)),
    TrialEffect("horizon_season", "winter higher", "deg", 0.15, (0.02, 0.6), ("horizon_season=-0.15",)),
    TrialEffect("dss_transfer", "up", "1", 0.001, (1e-4, 0.01), ("dss_transfer=0.001",), squared=False),
    TrialEffect("dss_transfer", "down", "1", 0.001, (1e-4, 0.01), ("dss_transfer=-0.001",), squared=False),
    TrialEffect("cross_track", None, "km", 2.0, (0.2, 10.0), ("cross_track=2",)),
    TrialEffect("bias_gain", None, "1", 0.3, (0.02, 0.6), ("bias_gain=1.3",), squared=False),
    *(TrialEffect("gyro_walk", axis, "deg/h/sqrt(day)", WALK_SIZE, (0.001, 0.2)) for axis in "xyz"),
    TrialEffect("late_filter_upload", None, "", 1.0, (0.0, 1.0), ("late_filter_upload=1",), switch=True),
    TrialEffect("printed_coefficients", None, "", 1.0, (0.0, 1.0), LEVEL_BORESIGHTS[1:], switch=True),
    TrialEffect("boresights level", None, "", 1.0, (0.0, 1.0), LEVEL_BORESIGHTS, switch=True),
)


SETS = tuple(dict.fromkeys([*(rung.effects for rung in RUNGS), *(one.setting for one in TRIED_EFFECTS)]))
"""Every set of effects that windows are flown with."""


def build_ladder_table(windows: Mapping[tuple[str, ...], pd.DataFrame]) -> pd.DataFrame:
    """Build the table of the rungs, first to last: effect, setting, factors and their intervals."""
    out: list[dict[str, Any]] = []
    fitted: list[Number] = []
    for rung in RUNGS:
        fitted += rung.fitted
        rows = windows[rung.effects]
        values = compute_simulated_numbers(rows, rung.against)
        record: dict[str, Any] = {"effect": rung.name, "setting": " ".join(rung.effects) or "nominal"}
        groups, resampled = group_numbers(fitted), resample_numbers(rows, rung.against)
        for name, numbers in groups.items():
            low, high = np.quantile(compute_rms_factor(resampled, numbers), [0.16, 0.84])
            record |= {name: float(compute_rms_factor(values, numbers)), f"{name}_low": float(low), f"{name}_high": float(high)}
        out.append(record)
    return pd.DataFrame(out)


def group_numbers(fitted: Sequence[Number] = ()) -> dict[str, list[Number]]:
    """Return the numbers of each factor; the last leaves out those to which a size was fitted."""
    return {
        "factor_18": list(WINDOW_NUMBERS),
        "factor_12": [number for number in WINDOW_NUMBERS if number[0] in ANGLE_STATISTICS],
        "factor_unfitted": [number for number in WINDOW_NUMBERS if number not in fitted],
    }


def resample_numbers(rows: pd.DataFrame, against: str) -> dict[Number, NDArray[np.float64]]:
    """Compute R Table 3's numbers (`LADDER_DRAWS`,) from windows drawn anew within each period."""
    rng = generator(1998, 0, "ladder_intervals")
    parts = {period: rows[rows["period"] == period] for period in PERIODS}
    draws = [{period: rng.integers(0, len(part), len(part)) for period, part in parts.items()} for _ in range(LADDER_DRAWS)]
    out = {}
    for number in WINDOW_NUMBERS:
        period = number[2]
        values = parts[period][find_number_column(number, against)].to_numpy(dtype=float)
        out[number] = summarise_windows(number, values[np.array([draw[period] for draw in draws])])
    return out


def build_rung_numbers(windows: Mapping[tuple[str, ...], pd.DataFrame], published: Mapping[Number, float]) -> pd.DataFrame:
    """Build the table of R Table 3's 18 numbers: the flight's, and those of every rung."""
    rows = []
    for number in WINDOW_NUMBERS:
        row: dict[str, Any] = dict(zip(("parameter", "axis", "period"), number, strict=True)) | {"flight": published[number]}
        for rung in RUNGS:
            row[rung.name.replace(" ", "_")] = compute_simulated_numbers(windows[rung.effects], rung.against)[number]
        rows.append(row | {"last_over_flight": row[RUNGS[-1].name] / published[number]})
    return pd.DataFrame(rows)
