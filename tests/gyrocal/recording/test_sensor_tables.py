"""Raw tables of the attitude sensors in a recording."""

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError, load, save
from simulator import scenario
from simulator.simulate import simulate

MONTHS = scenario.load("trmm_months")


@pytest.fixture(scope="module")
def recording():
    return simulate(MONTHS.model_copy(update={"interval": MONTHS.interval[2:4]}), seed=2)


def same(a, b):
    for kind in ("sun", "earth", "ephemeris"):
        one, other = getattr(a, kind), getattr(b, kind)
        for name in one.__dataclass_fields__:
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-15, atol=1e-17)


def test_what_is_saved_is_loaded(recording, tmp_path):
    save(recording, tmp_path)
    found = load(tmp_path)
    same(found.sensors, recording.sensors)
    assert not found.tables
    times, counts = found.sensors.sun.select_sensor(2)
    assert times.size == len(counts) == (recording.sensors.sun.sensor == 2).sum()


def broken(column, row, value):
    def change(table):
        table.loc[row, column] = value
        return table

    return change


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("sun_sensor", lambda t: t.drop(columns="count_beta"), "sun_sensor: column count_beta is missing"),
        ("sun_sensor", lambda t: t.assign(count_alpha=t["count_alpha"] + 0.5), "count_alpha is not a whole number"),
        ("sun_sensor", lambda t: t.iloc[::-1], "sun_sensor: row 1: time goes backwards"),
        ("earth_sensor", broken("penetration_1_deg", 7, np.nan), "earth_sensor: row 7: a penetration angle that is used"),
        ("ephemeris", lambda t: t.assign(position_x_m=1e3, position_y_m=0.0, position_z_m=0.0), "unit metres"),
        ("ephemeris", lambda t: t.iloc[10:], "ephemeris: no row at t_s = "),
    ],
)
def test_a_bad_table_is_one_line(recording, tmp_path, name, change, message):
    save(recording, tmp_path)
    path = tmp_path / f"{name}.parquet"
    change(pd.read_parquet(path)).to_parquet(path)
    with pytest.raises(InputError, match=message) as caught:
        load(tmp_path)
    assert str(tmp_path) in str(caught.value)
