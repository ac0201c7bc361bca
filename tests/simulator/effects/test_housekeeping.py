"""Effects that follow housekeeping: accelerations and temperatures, by their equation, sign and need of a column."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from simulator.effects.housekeeping_columns import STANDARD_GRAVITY
from simulator.effects.recording_view import interpolate_housekeeping
from tests.simulator.effects.test_effects import ACCELERATIONS, PLAIN


def test_accelerations_are_those_of_a_body_on_a_rate_table():
    """Standard gravity in any attitude, to five sigma of the noise of 0.01 m/s² about each axis."""
    table = ACCELERATIONS.tables["housekeeping"]
    norm = np.linalg.norm(table[[f"gyro_acceleration_{k}_m_s2" for k in "xyz"]].to_numpy(), axis=1)
    np.testing.assert_allclose(norm, STANDARD_GRAVITY, atol=0.05)


@pytest.mark.parametrize("filler", [1e300, np.inf, np.nan])
def test_housekeeping_is_read_in_order_of_time_and_without_fillers(filler):
    t_s = np.arange(1000.0, -1.0, -10.0)
    table = pd.DataFrame(
        {"t_s": t_s, "gyro_temperature_c": np.where(t_s == 500.0, filler, 20.0 + 0.01 * t_s), "mode": "nominal"}
    )
    found = interpolate_housekeeping(replace(PLAIN, tables={"housekeeping": table}), np.array([100.0, 503.0]))
    assert found.keys() == {"gyro_temperature_c"}
    np.testing.assert_allclose(found["gyro_temperature_c"], [21.0, 25.03])
