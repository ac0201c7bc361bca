"""R Table 2 from the yaw maneuvers: how far the gyro misses in a turn by 180°, before and after its calibration.

The miss is the attitude propagated through the maneuver by the gyro, from the true attitude at its start, against the true
attitude at its end. R's sign, propagated minus true, is the opposite of the loop's. What a calibration of the gyro cannot
take away is its white noise, σ √T about each axis, and the error of the on-board yaw bias.

R does not say which maneuver its table is of. N's intervals 2 and 6 are one of each direction, and a wrong G misses
differently in them: a term of the miss that comes from the orbit's rate changes its sign with the direction of flight.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from simulator.mission_mode.config import PRELAUNCH_BIAS, PRELAUNCH_G, R9_BIAS, R9_G, MissionConfig, YawManeuver
from studies.robertson import published_tables
from studies.robertson.biases import compute_solved_bias
from studies.robertson.calendar import YAW_MANEUVER_TIMES
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.runs import SLEW_TABLES, Runs

Array = NDArray[np.float64]
R_PHASE = {"calibration1": "precalibration", "postcalibration": "postcalibration"}
N_PHASE = {"calibration1": "prelaunch", "postcalibration": "calibrated"}
MANEUVER_STEPS = 5000  # of the maneuver; leaves 1e-6 deg


def collect_slew_misses(runs: Runs) -> pd.DataFrame:
    """A row a slew and seed: maneuver, tables, propagated minus true (deg), the yaw bias on board at its start (deg/h)."""
    rows = []
    for name, run in runs.items():
        if name[0] == "slew":
            slew = run.slews.iloc[0]
            miss = {f"{axis}_deg": -slew[f"targeting_{axis}_deg"] for axis in ROTATION_NAMES}
            about = {"maneuver": name[1], "tables": name[2], "seed": int(name[3])}
            rows.append({**about, **miss, "bias_yaw_deg_h": slew["bias_yaw_deg_h"]})
    return pd.DataFrame(rows)


def build_slew_table(rows: pd.DataFrame) -> pd.DataFrame:
    """R Table 2: the flight's, the seeds' mean and standard deviation, the difference, and what G and b alone say."""
    out = []
    for maneuver in YAW_MANEUVER_TIMES:
        for tables in SLEW_TABLES:
            chosen = rows[(rows["maneuver"] == maneuver) & (rows["tables"] == tables)]
            solved, published = (compute_noise_free_miss(maneuver, tables, solved=flag) for flag in (True, False))
            for k, axis in enumerate(ROTATION_NAMES):
                values = chosen[f"{axis}_deg"].to_numpy()
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
                        "noise_free_deg": solved[k],
                        "published_bias_deg": published[k],
                        "flight_by_N_deg": published_tables.read_published_slew_residual(maneuver, N_PHASE[tables], axis),
                    }
                )
    return pd.DataFrame(out)


def compute_slew_gaps(table: pd.DataFrame) -> dict[str, float]:
    """RMS of simulated minus flown before calibration, deg, over the three axes, for each maneuver it may have been."""
    rows = table[table["tables"] == "calibration1"]
    return {
        str(maneuver): float(np.sqrt((chosen["simulated_minus_flight_deg"] ** 2).mean()))
        for maneuver, chosen in rows.groupby("maneuver", sort=False)
    }


def compute_noise_free_miss(maneuver: str, tables: str, solved: bool = True, duration_s: float | None = None) -> Array:
    """The miss by G and b alone, propagated minus true, (3,) deg: a turn at constant orbital rate with the loop's yaw profile.

    With A_propagated = exp(−[ε×]) A the error grows as ε' = δω − ω × ε, δω the propagated rate minus the true one, so that at
    the end it is A ∫ Aᵀ δω dt. The orbital rate n in the body turns with the yaw κ: ω = (−n sin κ, −n cos κ, κ').

    Parameters
    ----------
    maneuver : "+x to -x", by +180°, or "-x to +x", by −180°
    tables : "calibration1" with the gyro's parameters of before launch, "postcalibration" with R (9)
    solved : whether the yaw bias is the one solved for before the maneuver, as on board, or the published one
    duration_s : of the maneuver, s; the simulated one's by default
    """
    G, b = (R9_G, R9_BIAS) if tables == "postcalibration" else (PRELAUNCH_G, PRELAUNCH_BIAS)
    start, sign = (0.0, 1.0) if maneuver == "+x to -x" else (np.pi, -1.0)
    if solved:
        b = np.array([b[0], b[1], compute_solved_bias(G, maneuver[:2])[2]])
    shape = YawManeuver(0.0) if duration_s is None else YawManeuver(0.0, duration_s)
    t, dt, r = (np.arange(MANEUVER_STEPS) + 0.5) / MANEUVER_STEPS, shape.duration_s / MANEUVER_STEPS, shape.ramp_fraction
    rise, fall = np.clip(t / r, 0, 1), np.clip((t - 1 + r) / r, 0, 1)
    rate = sign * np.pi / shape.duration_s / (1 - r) * ((3 - 2 * rise) * rise**2 - (3 - 2 * fall) * fall**2)
    yaw = start + (np.cumsum(rate) - 0.5 * rate) * dt
    n = MissionConfig().orbit.mean_motion
    omega = np.stack([-n * np.sin(yaw), -n * np.cos(yaw), rate], axis=-1)
    wrong = (omega - R9_BIAS) @ np.linalg.inv(R9_G).T @ G.T + b - omega
    to_start = _rotate_pitch_yaw(yaw, -n * t * shape.duration_s).transpose(0, 2, 1)
    gathered = np.einsum("kij,kj->i", to_start, wrong) * dt
    end = _rotate_pitch_yaw(np.array([start + sign * np.pi]), np.array([-n * shape.duration_s]))[0]
    return np.asarray(np.round(np.rad2deg(end @ gathered), 9) + 0.0)


def _rotate_pitch_yaw(yaw: Array, pitch: Array) -> Array:
    """Body axes turned by the pitch about y and then by the yaw about z, (k, 3, 3)."""
    return np.asarray(Rotation.from_euler("YZ", np.stack([pitch, yaw], axis=-1)).as_matrix().transpose(0, 2, 1))
