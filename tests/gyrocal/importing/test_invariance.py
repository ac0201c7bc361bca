"""Units, the order of rows and the sign of quaternions change nothing of what is read from other people's tables."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from gyrocal.errors import InputError
from gyrocal.importing import validate_mapping
from gyrocal.importing.streams import read_streams
from studies.validation import mems_log
from tests.gyrocal.importing.mems import CORRECT_MAPPING

FEW = settings(max_examples=20, phases=[Phase.generate])
# By hand: so much of the unit is one deg/s, or a second.
RATES = {"deg/s": 1.0, "rad/s": np.pi / 180, "mrad/s": np.pi / 0.18, "mdeg/s": 1e3, "deg/h": 3600.0, "arcsec/s": 3600.0}
TIMES = {"ms": 1, "us": 10**3, "ns": 10**6}  # of a millisecond
GYRO, QUATERNION = ["gx", "gy", "gz"], ["qw", "qx", "qy", "qz"]


@cache
def log():
    return mems_log.log(np.random.default_rng(5), seconds=60.0)


@cache
def plain():
    return read_streams(log().gyro, log().attitude, validate_mapping(CORRECT_MAPPING, "mapping"))


@FEW
@given(
    st.sampled_from(sorted(RATES)),
    st.sampled_from(sorted(TIMES)),
    st.sampled_from(["as they are", "reversed", "shuffled", "each twice"]),
    st.integers(0, 2**31),
)
def test_units_and_the_order_of_rows_change_nothing(rate, time, order, seed):
    rng = np.random.default_rng(seed)
    tables = []
    for table, columns, factor in ((log().gyro, GYRO, RATES[rate]), (log().attitude, QUATERNION, 1.0)):
        signs = rng.choice([-1.0, 1.0], (len(table), 1)) if columns is QUATERNION else 1.0
        made = pd.DataFrame(table[columns].to_numpy() * factor * signs, columns=columns)
        made.insert(0, "timestamp_ms", table["timestamp_ms"] * TIMES[time])
        rows = {
            "as they are": np.arange(len(made)),
            "reversed": np.arange(len(made))[::-1],
            "shuffled": rng.permutation(len(made)),
            "each twice": np.repeat(np.arange(len(made)), 2),
        }[order]
        tables.append(made.iloc[rows])
    mapping = validate_mapping(CORRECT_MAPPING | {"time": f"timestamp_ms:{time}", "gyro": f"gx,gy,gz:{rate}"}, "mapping")
    if order == "shuffled":  # the rows of several logs would be mixed as well
        with pytest.raises(InputError, match="goes back by"):
            read_streams(*tables, mapping)
        return
    found = read_streams(*tables, mapping)
    np.testing.assert_array_equal(found.t_s, plain().t_s)
    np.testing.assert_allclose(found.raw, plain().raw, rtol=1e-14, atol=1e-18)
    assert (found.epoch, found.time_scale, found.sample_s) == (plain().epoch, plain().time_scale, plain().sample_s)
    (own,), (before,) = found.sensors, plain().sensors
    np.testing.assert_array_equal(own.t_s, before.t_s)
    same = np.abs(np.sum(own.q * before.q, axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-14)
