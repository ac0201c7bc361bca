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

from studies.robertson import published_tables
from studies.robertson.calendar import YAW_MANEUVER_TIMES
from studies.robertson.published_tables import ROTATION_NAMES
from studies.robertson.runs import SLEW_TABLES, Runs

R_PHASE = {"calibration1": "precalibration", "postcalibration": "postcalibration"}


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
    """R Table 2: the flight's, the seeds' mean and standard deviation, and the difference."""
    out = []
    for maneuver in YAW_MANEUVER_TIMES:
        for tables in SLEW_TABLES:
            chosen = rows[(rows["maneuver"] == maneuver) & (rows["tables"] == tables)]
            for axis in ROTATION_NAMES:
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
