"""The flight's published values, typed from the papers: N Tables 1–5 and R eq. (9). Degrees and deg/s, as printed.

Some printed values contradict each other. Used here:

- N Table 4's "RMS" is sqrt(Σx²)/n, not sqrt(Σx²/n); see `compute_paper_rms`.
- N Table 5's first-iteration bias corrections are those of Δt = 1 s, its G corrections those of G⁻¹ at Δt = 0.5 s.
- N Table 2, calibrated, 2 s, interval 3, yaw −0.042 does not fit Table 4's mean; +0.042 would. It is kept as printed.
- N Table 3 at 0.5 s and R eq. (9) are the same calibration; R eq. (9) has more digits.
"""

from functools import cache
from importlib import resources

import numpy as np
import pandas as pd

from gyrocal import GyroParameters
from gyrocal.arrays import Array
from simulator.scenario import Scenario

FLIGHT_STEPS_S = (0.5, 1.0, 2.0)
SLEW_COUNTS, HOLD_INTERVAL = [0, 1, 0, 2, 0, 1], 4  # of N's intervals
ROTATIONS = ("roll", "pitch", "yaw")
_ROTATION_COLUMNS = [f"{name}_deg" for name in ROTATIONS]


@cache
def read_published_table(name: str) -> pd.DataFrame:
    """Read one table of the flight's files: table1_intervals, table2_residuals, …, g_matrix. Treat it as read-only."""
    with resources.files("studies").joinpath("data", "flight", f"{name}.csv").open("rb") as file:
        return pd.read_csv(file)


@cache
def read_published_residuals(phase: str, step_s: float = 0.5) -> Array:
    """Read N Table 2, (6, 3) deg; phase "prelaunch" or "calibrated"."""
    rows = read_published_table("table2_residuals").query("phase == @phase and step_s == @step_s")
    residuals = rows[_ROTATION_COLUMNS].to_numpy().copy()
    residuals.setflags(write=False)  # a fit asks for them thousands of times
    return residuals


@cache
def read_published_parameters(phase: str, step_s: float | None = None) -> GyroParameters:
    """Read N Table 3; phase "prelaunch" (no step) or "calibrated"."""
    rows = read_published_table("table3_parameters").query("phase == @phase")
    if step_s is not None:
        rows = rows.query("step_s == @step_s")
    G = np.deg2rad(rows[[f"misalignment_{axis}_deg" for axis in "xyz"]].to_numpy())
    np.fill_diagonal(G, rows["scale_factor"].to_numpy())
    return GyroParameters(G, np.deg2rad(rows["bias_deg_s"].to_numpy()))


@cache
def read_published_calibration() -> GyroParameters:
    """Read R eq. (9)."""
    rows = read_published_table("g_matrix")
    return GyroParameters(rows[["g_x", "g_y", "g_z"]].to_numpy(), np.deg2rad(rows["bias_deg_s"].to_numpy()))


def read_published_statistics(phase: str, step_s: float, statistic: str) -> Array:
    """Read N Table 4, (3,) deg; statistic "mean" or "rms"."""
    rows = read_published_table("table4_statistics").query("phase == @phase and step_s == @step_s and statistic == @statistic")
    return rows[_ROTATION_COLUMNS].to_numpy()[0]


def read_published_corrections(iteration: int) -> tuple[Array, Array]:
    """Read N Table 5: corrections to G⁻¹ (3, 3) and to the bias (3,) deg/s, as printed."""
    rows = read_published_table("table5_corrections").query("iteration == @iteration")
    values = rows[["x_gyro", "y_gyro", "z_gyro"]].to_numpy()
    is_bias = (rows["quantity"] == "bias_deg_s").to_numpy()
    return values[~is_bias], values[is_bias][0]


def compute_interval_durations() -> Array:
    """Compute the durations (6,) of the intervals of N Table 1, s."""
    rows = read_published_table("table1_intervals")
    length = pd.to_datetime(rows["stop_utc"]) - pd.to_datetime(rows["start_utc"])
    return np.asarray(length.dt.total_seconds(), dtype=float)


def matches_flight(scenario: Scenario) -> bool:
    """Check that a scenario has the intervals and maneuvers of N Table 1, with references at their ends."""
    lengths = [interval.stop_s - interval.start_s for interval in scenario.interval]
    slews = [len(interval.slew) for interval in scenario.interval]
    holds = [k for k, interval in enumerate(scenario.interval) if interval.hold is not None]
    are_maneuvers_same = slews == SLEW_COUNTS and holds == [HOLD_INTERVAL]
    are_lengths_same = np.array_equal(lengths, compute_interval_durations())
    return scenario.reference.at == "ends" and are_lengths_same and are_maneuvers_same


def compute_paper_rms(values: Array) -> Array:
    """Compute N Table 4's "RMS", sqrt(Σx²)/n along the first axis: smaller than the RMS by sqrt(n)."""
    return np.asarray(np.sqrt(np.sum(np.square(values), axis=0)) / len(values))


def compute_rms(values: Array) -> Array:
    """Compute sqrt(Σx²/n) along the first axis."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))
