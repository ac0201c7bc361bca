"""Housekeeping that effects follow: its columns, and a gyro's temperature and accelerations for scenarios, which have none.

    T(t) = 20 °C + 1.5 K sin(n t + 40°) + 0.05 K/day · (t − t₀) + 0.02 K noise

with n the orbit rate, t since the epoch and t₀ the first interval's start: the Sun once an orbit, a slow warming, and the
noise of a thermistor. Rows are 10 s apart through each interval. Accelerations are those of a body on a rate table: standard
gravity upward along the inertial z axis, turned into body axes at each reference, with noise of 0.01 m/s². What the recording
shows is what the bias follows.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import Array, Parameter, Parameters, Stream, Surroundings
from simulator.effects.common import DAY
from simulator.truth.rotation import convert_to_matrix

if TYPE_CHECKING:
    import pandas as pd

SUFFIX = "temperature_c"
TEMPERATURE_COLUMN = f"gyro_{SUFFIX}"
HOUSEKEEPING_SPACING_S = 10.0
STANDARD_GRAVITY = 9.80665  # m/s²
ACCELERATION = "acceleration_{}_m_s2"  # the end of a column's name, by body axis
ACCELERATION_NOISE = 0.01  # m/s²
TEMPERATURE = Parameter("column", "", "", "housekeeping column; the gyro's temperature if empty", choices=("*",))
MEAN_C, ORBITAL_K, PHASE, DRIFT_K_DAY, NOISE_K = 20.0, 1.5, float(np.deg2rad(40.0)), 0.05, 0.02


def simulate_gyro_temperature(rng: np.random.Generator, spans: list[tuple[float, float]], period_s: float) -> pd.DataFrame:
    """Simulate a table of t_s and gyro_temperature_c in intervals (start, stop), s since the epoch; period_s of the orbit."""
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    t_s = np.unique(np.concatenate([_list_times(start, stop) for start, stop in spans]))
    drift = DRIFT_K_DAY * (t_s - spans[0][0]) / DAY
    temperature = MEAN_C + ORBITAL_K * np.sin(2 * np.pi / period_s * t_s + PHASE) + drift
    return pd.DataFrame({"t_s": t_s, TEMPERATURE_COLUMN: temperature + NOISE_K * rng.standard_normal(t_s.size)})


def simulate_table_acceleration(rng: np.random.Generator, t_s: Array, quaternions: Array) -> pd.DataFrame:
    """Simulate accelerometers on a rate table: t_s and a column per body axis, m/s², of attitudes (m, 4) in any order."""
    import pandas as pd

    _, rows = np.unique(t_s, return_index=True)
    upward = STANDARD_GRAVITY * convert_to_matrix(quaternions[rows])[:, :, 2]
    readings = upward + ACCELERATION_NOISE * rng.standard_normal(upward.shape)
    return pd.DataFrame({"t_s": t_s[rows], **{f"gyro_{ACCELERATION.format(k)}": readings[:, i] for i, k in enumerate("xyz")}})


def _list_times(start: float, stop: float) -> Array:
    return np.append(np.arange(start, stop, HOUSEKEEPING_SPACING_S), stop)


def compute_temperature_change(effect: str, stream: Stream, parameters: Parameters) -> Array:
    """Compute T − mean T (n,) of the named housekeeping column, or of a temperature, the gyro's before others."""
    column, housekeeping = str(parameters.get("column", "")), stream.housekeeping
    fitting = [name for name in housekeeping if (name == column if column else name.endswith(SUFFIX))]
    if not fitting:
        columns = ", ".join(housekeeping) or "no housekeeping"
        raise InputError(f"{effect}: no housekeeping column {column or '…' + SUFFIX}; there is {columns}")
    temperature = housekeeping[min(fitting, key=lambda name: "gyro" not in name)]
    return np.asarray(temperature - temperature.mean())


def no_temperature(around: Surroundings) -> str | None:
    """Give the reason why an effect that follows a temperature cannot act; None if it can."""
    has_column = any(name.endswith(SUFFIX) for name in around.stream.housekeeping)
    return None if has_column else f"the recording has no housekeeping column …{SUFFIX}"
