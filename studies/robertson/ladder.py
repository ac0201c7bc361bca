"""From the Mission Mode as landed to the flight, one effect after the other, and what each rung leaves.

A rung is a set of effects of `simulator.mission_mode.effects`, flown in windows (`studies.robertson.windows`). What a rung is
judged by is the RMS factor between simulated and flown numbers of R Table 3: over all 18, the 12 of attitude and update, the 6
of yaw, and those to which no rung so far has fitted a size. Sizes are fitted on the postcalibration period alone:

- the horizon's noise on roll and pitch there, 0.029° and 0.030°; its time constant is taken and not fitted;
- the walk of the y bias on its scatter there, 0.058 deg/h.

Which effects are rungs at all was chosen with all 18 numbers in view, which no held-out number makes up for.

What needs no size is R's own statistic, the geometry of the boresights and R (6) computed for it. The intervals are the
0.16 and 0.84 quantiles of the factor when the windows are drawn anew with replacement: how far one finite record fixes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from simulator.streams import generator
from studies.robertson.calendar import PERIODS
from studies.robertson.windows import (
    ANGLE_STATISTICS,
    WINDOW_NUMBERS,
    Number,
    compute_rms_factor,
    compute_simulated_numbers,
    find_number_column,
    summarise_windows,
)

LANDED = ("boresight_elevation=0", "printed_coefficients=1")
HORIZON = "horizon_noise=0.0287"
WALK = "gyro_walk:y=0.018"
LADDER_DRAWS = 200
POST = PERIODS[2]


@dataclass(frozen=True)
class Rung:
    """A step of the ladder."""

    name: str  # what it adds to the rung before
    effects: tuple[str, ...]  # all of them
    against: str = "onboard_minus_ground"  # what the on-board attitude is compared with
    fitted: tuple[Number, ...] = ()  # numbers of R Table 3 that a size was fitted on in this step


RUNGS = (
    Rung("landed", LANDED, "onboard_minus_true"),
    Rung("ground batch", LANDED),
    Rung("boresight_elevation", LANDED[1:]),
    Rung("computed coefficients", ()),
    Rung("horizon_noise", (HORIZON,), fitted=tuple((ANGLE_STATISTICS[0], axis, POST) for axis in ("roll", "pitch"))),
    Rung("gyro_walk:y", (HORIZON, WALK), fitted=(("gyro_bias_std_deg_h", "y", POST),)),
)
NOMINAL = RUNGS[3].effects
TRIED = (  # about the nominal, for the diagnosis
    ("horizon_season=0.15",),
    ("horizon_season=-0.15",),
    ("dss_transfer=0.001",),
    ("dss_transfer=-0.001",),
    ("late_filter_upload=1",),
    ("cross_track=2",),
    ("bias_gain=1.3",),
)
SETS = tuple(dict.fromkeys([*(rung.effects for rung in RUNGS), *TRIED]))
"""Every set of effects that windows are flown with."""


def build_ladder_table(windows: Mapping[tuple[str, ...], pd.DataFrame]) -> pd.DataFrame:
    """The rungs from landed to last: effect, its setting, the four factors and their intervals."""
    out: list[dict[str, Any]] = []
    used: list[Number] = []
    for rung in RUNGS:
        used += rung.fitted
        rows = windows[rung.effects]
        values = compute_simulated_numbers(rows, rung.against)
        record: dict[str, Any] = {"effect": rung.name, "setting": " ".join(rung.effects) or "nominal"}
        own, drawn = group_numbers(used), resample_numbers(rows, rung.against)
        for name, numbers in own.items():
            low, high = np.quantile(compute_rms_factor(drawn, numbers), [0.16, 0.84])
            record |= {name: float(compute_rms_factor(values, numbers)), f"{name}_low": float(low), f"{name}_high": float(high)}
        out.append(record)
    return pd.DataFrame(out)


def group_numbers(used: Sequence[Number] = ()) -> dict[str, list[Number]]:
    """The numbers each factor is over."""
    twelve = [one for one in WINDOW_NUMBERS if one[0] in ANGLE_STATISTICS]
    return {
        "factor_18": list(WINDOW_NUMBERS),
        "factor_12": twelve,
        "factor_6": [one for one in twelve if one[1] == "yaw"],
        "factor_12_unfitted": [one for one in twelve if one not in used],
        "factor_unfitted": [one for one in WINDOW_NUMBERS if one not in used],
    }


def resample_numbers(rows: pd.DataFrame, against: str) -> dict[Number, NDArray[np.float64]]:
    """R Table 3's numbers of windows drawn anew within each period, `LADDER_DRAWS` times."""
    rng = generator(1998, 0, "ladder_intervals")
    parts = {period: rows[rows["period"] == period] for period in PERIODS}
    draws = [{period: rng.integers(0, len(part), len(part)) for period, part in parts.items()} for _ in range(LADDER_DRAWS)]
    out = {}
    for number in WINDOW_NUMBERS:
        period = number[2]
        values = parts[period][find_number_column(number, against)].to_numpy(dtype=float)
        out[number] = summarise_windows(number, values[np.array([one[period] for one in draws])])
    return out


def build_rung_numbers(windows: Mapping[tuple[str, ...], pd.DataFrame], published: Mapping[Number, float]) -> pd.DataFrame:
    """R Table 3's 18 numbers: the flight's, and those of every rung."""
    rows = []
    for number in WINDOW_NUMBERS:
        row: dict[str, Any] = dict(zip(("parameter", "axis", "period"), number, strict=True)) | {"flight": published[number]}
        for rung in RUNGS:
            row[rung.name.replace(" ", "_")] = compute_simulated_numbers(windows[rung.effects], rung.against)[number]
        rows.append(row | {"last_over_flight": row[RUNGS[-1].name] / published[number]})
    return pd.DataFrame(rows)
