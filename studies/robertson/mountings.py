"""What the unpublished mounting of the sun sensors does to the yaw updates; the ways are in `simulator.mission_mode.config`."""

from __future__ import annotations

import pandas as pd

from studies.robertson import flown
from studies.robertson.runs import PERIODS, Runs

SETTLED = 4  # yaw updates left out, until the cycle has settled


def mounting_table(runs: Runs) -> pd.DataFrame:
    """Mean size of the yaw updates by mounting and tables, deg, and the flight's."""
    rows: dict[str, dict[str, object]] = {}
    for name, run in runs.items():
        if name[0] == "mounting":
            row = rows.setdefault(name[1], {"mounting": name[1]})
            row[name[2]] = float(run.updates["update_deg"][SETTLED:].abs().mean())
    flight = {"mounting": "flight", **{period: flown.performance("yaw_update_deg", "yaw", period) for period in PERIODS}}
    return pd.DataFrame([flight, *rows.values()])[["mounting", *PERIODS]]
