"""Time tags and units of other people's files, against hand-worked numbers."""

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError
from gyrocal.importing import units


def tags(values, unit):
    return units.build_clock(pd.DataFrame({"t": values}), unit)


def test_nanoseconds_keep_what_a_float_would_lose():
    clock = tags(np.array([1_700_000_000_000_000_001, 1_700_000_000_000_000_002]), "ns")
    np.testing.assert_allclose(clock.part, [1e-9, 2e-9], rtol=0, atol=1e-18)


def test_iso_dates_with_and_without_a_zone():
    for text in ("2020-08-16T12:02:09.5Z", "2020-08-16T14:02:09.5+02:00", "2020-08-16T12:02:09.5"):
        clock = tags([text], "iso")
        assert units.convert_to_date(int(clock.whole[0]), "UTC").isoformat() == "2020-08-16T12:02:09+00:00"
        assert clock.part[0] == 0.5


def test_gps_weeks_become_utc_with_the_leap_seconds_of_their_day():
    # 2020-08-16T12:02:09 GPS is a Sunday: week 2119 begins on it, and UTC is 18 s behind.
    clock = units.build_clock(pd.DataFrame({"week": [2119], "tow": [12 * 3600 + 2 * 60 + 9.25]}), "gps")
    assert units.convert_to_date(int(clock.whole[0]), "GPS").isoformat() == "2020-08-16T12:02:09+00:00"
    utc = units.convert_to_utc(clock)
    assert units.convert_to_date(int(utc.whole[0]), "UTC").isoformat() == "2020-08-16T12:01:51+00:00"
    assert utc.part[0] == 0.25


@pytest.mark.parametrize(("day", "behind"), [("1981-06-30", 0), ("1981-07-01", 1), ("2016-12-31", 17), ("2017-01-01", 18)])
def test_leap_seconds(day, behind):
    assert units.count_leap_seconds(units.datetime.fromisoformat(f"{day}T12:00:00+00:00")) == behind


@pytest.mark.parametrize(
    ("unit", "lsb", "factor", "accumulated"),
    [
        ("deg/h", None, np.pi / 180 / 3600, False),
        ("counts", "0.0305 deg/s", 0.0305 * np.pi / 180, False),
        ("counts", "5e-9 rad", 5e-9, True),
        ("arcsec", None, np.pi / 180 / 3600, True),
    ],
)
def test_gyro_units(unit, lsb, factor, accumulated):
    found = units.compute_gyro_factor(unit, lsb)
    assert found[0] == pytest.approx(factor, rel=1e-14)
    assert found[1] is accumulated


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: units.compute_gyro_factor("deg/s", "1 rad"), "goes with counts"),
        (lambda: tags(["2020-01-01"], "s"), "not numbers; dates are iso"),
        (lambda: units.build_clock(pd.DataFrame({"a": [1], "b": [2]}), "s"), "give one for each, as in secs,nsecs:s"),
    ],
)
def test_what_cannot_be_read_is_said(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_times_of_day_go_on_after_midnight():
    found = tags(["23:59:59.5", "23:59:59.75", "0:00:00.0", "00:00:00.25"], "iso")
    np.testing.assert_allclose(found.subtract(86399), [0.5, 0.75, 1.0, 1.25])
    assert found.scale == ""


@pytest.mark.parametrize(
    ("first", "second", "unit", "sizes_ns", "scale"),
    [
        ([1_700_000_000, 1_700_000_001], [999_999_999, 7], "s+ns", (10**9, 1), "UTC"),
        ([2286, 2287], [604799.5, 0.25], "gps", (604800 * 10**9, 10**9), "GPS"),
        ([17, 18], [999_999, 0], "100us+us", (10**5, 1000), ""),
    ],
)
def test_columns_of_time_are_added(first, second, unit, sizes_ns, scale):
    clock = units.build_clock(pd.DataFrame({"a": first, "b": second}), unit)
    true = [a * sizes_ns[0] + int(b * sizes_ns[1]) for a, b in zip(first, second, strict=True)]
    np.testing.assert_array_equal(clock.whole * 10**9 + np.round(clock.part * 1e9).astype(int), true)
    assert clock.scale == scale


def test_date_and_time_of_day_are_joined():
    table = pd.DataFrame({"date": ["2024-02-29", "2024-03-01"], "time": ["23:59:59.5", "0:00:00,25"]})
    clock = units.build_clock(table, "iso")
    np.testing.assert_allclose(clock.subtract(int(clock.whole[0])), [0.5, 1.25])
    assert units.convert_to_date(int(clock.whole[0]), "UTC").isoformat() == "2024-02-29T23:59:59+00:00"


@pytest.mark.parametrize("range_s", [86400, 604800])
@pytest.mark.parametrize(("unit", "size"), [("s", 1.0), ("100us", 1e4)])
def test_seconds_of_a_day_or_week_go_on_where_they_start_anew(range_s, unit, size):
    true = np.round(range_s - 1 + 0.05 * np.arange(60), 9)
    rows = np.arange(60)
    rows[[19, 20]] = rows[[20, 19]]  # neighbours at the wrap itself, as some networks exchange them
    values = np.round(size * (true[rows] % range_s), 6)
    clock = tags(values.astype("int64") if unit == "100us" else values, unit)
    np.testing.assert_allclose(clock.subtract(0), true[rows], atol=1e-6)
    assert f"at {range_s} s and go on" in clock.note
