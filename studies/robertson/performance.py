"""R Tables 1 to 3 and R (8) from the simulated flights, against their truth: accuracy, updates, biases, dates, yaw maneuvers.

Attitude accuracy is the on-board attitude's RMS error over an orbit, averaged over a period's full orbits in normal pointing;
the yaw update the mean of its size; the bias scatter the standard deviation of the bias that an attitude solution over an
orbit would find, ω − G ω_raw with the G on board. Each is formed for each seed; the tables give the seeds' mean and range.

R (8). While the rate is constant a wrong G looks like a bias, b' = ω − G ω_raw with the G that the solution uses and
ω_raw = G_true⁻¹ (ω − b). With G = I that is R (8). On board G was that of before launch (N Table 3).

R Table 2. The miss of a yaw maneuver is the attitude propagated through it by the gyro, from the true attitude at its start,
against the true attitude at its end. R's sign, propagated minus true, is the opposite of the loop's. A calibration of the gyro
cannot take away its white noise, σ √T about each axis, and the error of the on-board yaw bias. R does not say which maneuver
its table is of. N's intervals 2 and 6 are one of each direction, and a wrong G misses differently in them: a term of the miss
that comes from the orbit's rate changes its sign with the direction of flight.
"""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from gyrocal.arrays import Array
from simulator.mission_mode.config import DAY, PRELAUNCH_G, R9_BIAS, R9_G, MissionConfig
from simulator.mission_mode.flight import MissionRun, build_flight_schedule
from studies.robertson import published_tables
from studies.robertson.calendar import FIRST_DAYS, PERIODS, YAW_MANEUVER_TIMES, convert_to_mission_day
from studies.robertson.ground import DEG_H_PER_RAD_S
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.runs import SLEW_TABLES, Runs

GYRO_AXES = {"x": "roll", "y": "pitch", "z": "yaw"}


def select_period(table: pd.DataFrame, period: str) -> pd.DataFrame:
    """Select the rows of a table with t_s that are in one of R Table 3's periods."""
    start, stop = (convert_to_mission_day(moment, MissionConfig()) * DAY for moment in FIRST_DAYS[period])
    return table[table["t_s"].between(start, stop, inclusive="left")]


def select_full_orbits(orbits: pd.DataFrame) -> pd.DataFrame:
    """Select orbits in normal pointing throughout; R's differences are each "over at least a full orbit"."""
    return orbits[(orbits["samples"] > 0) & (orbits["lost"] == 0)]


def compute_performance(run: MissionRun, period: str) -> dict[tuple[str, str], float]:
    """Compute R Table 3 in a period, by parameter and axis: accuracy and updates in deg, bias scatter in deg/h."""
    orbits = select_full_orbits(select_period(run.orbits, period))
    numbers = {("attitude_accuracy_deg", axis): orbits[f"rms_knowledge_{axis}_deg"].mean() for axis in ROTATION_NAMES}
    numbers["yaw_update_deg", "yaw"] = select_period(run.updates, period)["update_deg"].abs().mean()
    if period != "precalibration":
        numbers |= {
            ("gyro_bias_std_deg_h", axis): orbits[f"apparent_bias_{name}_deg_h"].std() for axis, name in GYRO_AXES.items()
        }
    return numbers


def build_performance_table(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """Build R Table 3 against the simulated truth: a row for each number, with the flight's value, the seeds' mean and range.

    `ladder.build_rung_numbers` computes the same numbers against the ground batch, as R did.
    """
    rows = []
    for period in PERIODS:
        by_seed = [compute_performance(run, period) for run in runs]
        for parameter, axis in by_seed[0]:
            values = [numbers[parameter, axis] for numbers in by_seed]
            flight = published_tables.read_published_performance(parameter, axis, period)
            rows.append((parameter, axis, period, flight, float(np.mean(values)), min(values), max(values)))
    names = ["parameter", "axis", "period", "flight", "simulated", "lowest", "highest"]
    table = pd.DataFrame(rows, columns=names)
    return table.assign(
        simulated_minus_flight=table["simulated"] - table["flight"], simulated_over_flight=table["simulated"] / table["flight"]
    )


def build_requirements_table(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """Build R Table 1 in each period and axis: three times the RMS over all orbits in normal pointing."""
    rows = []
    columns = {"knowledge": "rms_knowledge", "pointing": "rms_error", "stability": "jitter"}
    for period in PERIODS:
        orbits = pd.concat([select_period(run.orbits, period) for run in runs])
        orbits = orbits[orbits["samples"] > 0]
        for name, column in columns.items():
            limit = published_tables.read_requirement(name)
            for axis in ROTATION_NAMES:
                values, weights = orbits[f"{column}_{axis}_deg"].to_numpy(), orbits["samples"].to_numpy()
                value = np.nan
                if len(values):
                    rms = np.sqrt(weights @ values**2 / weights.sum())
                    value = float(values.max() if name == "stability" else 3 * rms)
                rows.append(
                    {
                        "period": period,
                        "requirement": name,
                        "axis": axis,
                        "limit_deg": limit,
                        "simulated_deg": value,
                        # Stability is not tested without a source of jitter; NaN, without a flight, is not met either.
                        "met": None if name == "stability" else bool(value < limit),
                    }
                )
    return pd.DataFrame(rows)


def compare_orientations(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """Compare yaw accuracy and updates of each period between +x and −x forward."""
    rows = []
    for period in PERIODS:
        orbits = pd.concat([select_full_orbits(select_period(run.orbits, period)) for run in runs])
        updates = pd.concat([select_period(run.updates, period) for run in runs])
        for forward in ("+x", "-x"):
            rows.append(
                {
                    "period": period,
                    "forward": forward,
                    "orbits": int((orbits["forward"] == forward).sum()),
                    "yaw_accuracy_deg": orbits.loc[orbits["forward"] == forward, "rms_knowledge_yaw_deg"].mean(),
                    "yaw_update_deg": updates.loc[updates["forward"] == forward, "update_deg"].abs().mean(),
                }
            )
    return pd.DataFrame(rows)


def compare_maneuver_dates(days: float) -> pd.DataFrame:
    """Compare the simulated maneuver dates with the nearest published ones."""
    base = MissionConfig()
    schedule = build_flight_schedule(base, days)
    published = published_tables.read_maneuver_dates()
    rows = []
    forward = schedule.forward
    for maneuver in schedule.maneuvers:
        moment = pd.Timestamp(base.epoch) + pd.Timedelta(seconds=maneuver.start_s + 0.5 * maneuver.duration_s)
        forward = "-x" if forward == "+x" else "+x"
        differences = (moment - published["date_utc"]).dt.total_seconds() / DAY
        nearest = int(differences.abs().argmin())
        is_near = abs(differences[nearest]) < 5.0
        rows.append(
            {
                "simulated_utc": f"{moment:%Y-%m-%d %H:%M}",
                "forward_after": forward,
                "flight": published["source"][nearest] if is_near else "",
                "flight_utc": f"{published['date_utc'][nearest]:%Y-%m-%d}" if is_near else "",
                "simulated_minus_flight_days": float(differences[nearest]) if is_near else np.nan,
            }
        )
    return pd.DataFrame(rows, columns=["simulated_utc", "forward_after", "flight", "flight_utc", "simulated_minus_flight_days"])


USED_G = {"calibration1": PRELAUNCH_G, "postcalibration": R9_G}


def compute_solved_bias(G: Array, forward: str) -> Array:
    """Compute b' (3,) at ∓1 RPO about y, flying +x or −x forward, with G in the solution; rad/s."""
    orbit = MissionConfig().orbit
    rate = orbit.mean_motion + orbit.nodal_rate * np.cos(orbit.inclination)
    omega = np.array([0.0, -rate if forward == "+x" else rate, 0.0])
    return np.asarray(omega - G @ np.linalg.solve(R9_G, omega - R9_BIAS))


def build_apparent_bias_table(runs: Sequence[MissionRun]) -> pd.DataFrame:
    """Build the mean bias by orientation before and after the gyro's upload, its standard error, and R (8); deg/h."""
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
            difference_error = np.hypot(errors[0], errors[1])
            rows.append((period, axis, "-x minus +x", means[1] - means[0], difference_error, formula[1] - formula[0]))
    names = ["period", "axis", "forward", "simulated_deg_h", "standard_error_deg_h", "formula_deg_h"]
    table = pd.DataFrame(rows, columns=names)
    return table.assign(simulated_minus_formula_deg_h=table["simulated_deg_h"] - table["formula_deg_h"])


R_PHASE = {"calibration1": "precalibration", "postcalibration": "postcalibration"}


def collect_slew_misses(runs: Runs) -> pd.DataFrame:
    """Collect a row a slew and seed: maneuver, tables, propagated minus true (deg), yaw bias on board (deg/h)."""
    rows = []
    for name, run in runs.items():
        if name[0] == "slew":
            slew = run.slews.iloc[0]
            miss = {f"{axis}_deg": -slew[f"targeting_{axis}_deg"] for axis in ROTATION_NAMES}
            flight = {"maneuver": name[1], "tables": name[2], "seed": int(name[3])}
            rows.append({**flight, **miss, "bias_yaw_deg_h": slew["bias_yaw_deg_h"]})
    return pd.DataFrame(rows)


def build_slew_table(rows: pd.DataFrame) -> pd.DataFrame:
    """Build R Table 2: the flight's, the seeds' mean and standard deviation, and the difference."""
    out = []
    for maneuver in YAW_MANEUVER_TIMES:
        for tables in SLEW_TABLES:
            slews = rows[(rows["maneuver"] == maneuver) & (rows["tables"] == tables)]
            for axis in ROTATION_NAMES:
                values = slews[f"{axis}_deg"].to_numpy()
                flight, mean = published_tables.read_published_slew_error(axis, R_PHASE[tables]), float(values.mean())
                out.append(
                    {
                        "maneuver": maneuver,
                        "tables": tables,
                        "axis": axis,
                        "flight_deg": flight,
                        "simulated_deg": mean,
                        "std_deg": float(values.std(ddof=1)) if len(values) > 1 else np.nan,
                        "simulated_minus_flight_deg": mean - flight,
                    }
                )
    return pd.DataFrame(out)


def compute_slew_gaps(table: pd.DataFrame) -> dict[str, float]:
    """Compute the RMS over axes of simulated minus flown before calibration, deg, for each candidate maneuver."""
    rows = table[table["tables"] == "calibration1"]
    return {
        str(maneuver): float(np.sqrt((maneuver_rows["simulated_minus_flight_deg"] ** 2).mean()))
        for maneuver, maneuver_rows in rows.groupby("maneuver", sort=False)
    }
