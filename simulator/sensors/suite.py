"""Raw tables of the sun and Earth sensors, as a recording holds them: counts and penetration angles of a given motion.

The Sun is that of the epoch and the tags (`simulator.truth.sun`). A sun sensor has a row where the Sun is in its view and not
in the Earth's shadow; no row means nothing was seen. The Earth sensor has a row for every tag.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array
from simulator.sensors import earth as earth_sensor
from simulator.sensors import sun as sun_sensor
from simulator.sensors.earth import TrueEarthSensor
from simulator.sensors.sun import TrueSunSensor, build_trmm_sensors
from simulator.truth.sun import is_eclipsed

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class SensorSuite:
    """The attitude sensors of a spacecraft."""

    sun_sensors: tuple[TrueSunSensor, ...] = field(default_factory=build_trmm_sensors)  # numbered 1, 2, … in the table
    earth: TrueEarthSensor = field(default_factory=TrueEarthSensor)  # the Earth sensor


def simulate_sun_table(
    rng: np.random.Generator | None, sensors: tuple[TrueSunSensor, ...], t: Array, A: Array, position: Array, sun: Array
) -> pd.DataFrame:
    """Simulate the counts of the sun sensors.

    Parameters
    ----------
    rng : source of the noise, None for none; every sensor draws for every tag, whatever it sees
    sensors : the sensors
    t : (n,) s, ascending
    A : (n, 3, 3) true attitudes
    position : (n, 3) from the Earth's centre, inertial, m
    sun : (n, 3) unit vectors, inertial

    Returns
    -------
    DataFrame
        t_s, sensor (1, 2, …), count_alpha, count_beta; in the order of t_s, then sensor.
    """
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    lit = ~is_eclipsed(position, sun)
    parts = []
    for number, sensor in enumerate(sensors, start=1):
        counts, visible = sun_sensor.observe(rng, sensor, A, sun)
        rows = visible & lit
        parts.append(
            pd.DataFrame({"t_s": t[rows], "sensor": number, "count_alpha": counts[rows, 0], "count_beta": counts[rows, 1]})
        )
    table = pd.concat(parts, ignore_index=True).sort_values(["t_s", "sensor"], kind="stable", ignore_index=True)
    return table.astype({"sensor": np.int64})


def simulate_earth_table(
    rng: np.random.Generator, sensor: TrueEarthSensor, t: Array, A: Array, position: Array, sun: Array
) -> pd.DataFrame:
    """Simulate the penetration angles of the Earth sensor; parameters as in `simulate_sun_table`.

    Returns
    -------
    DataFrame
        t_s, penetration_1_deg … penetration_4_deg, used_1 … used_4 in the order of the quadrants of
        `simulator.sensors.earth`. The angle of a quadrant that is not used means nothing.
    """
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    angles, used = earth_sensor.observe(rng, sensor, t, A, position, sun)
    columns: dict[str, NDArray[np.generic]] = {"t_s": t}
    columns |= {f"penetration_{i + 1}_deg": np.rad2deg(angles[:, i]) for i in range(angles.shape[1])}
    columns |= {f"used_{i + 1}": used[:, i] for i in range(used.shape[1])}
    return pd.DataFrame(columns)
