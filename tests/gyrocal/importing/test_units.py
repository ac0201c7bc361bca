"""Time tags and units of other people's files, against hand-worked numbers."""

import numpy as np
import pandas as pd
import pytest

from gyrocal import InputError
from gyrocal.importing import units


def tags(values, unit):
    return units.build_clock(pd.DataFrame({"t": values}), unit)


def test_milliseconds_of_unix_time_are_exact():
    clock = tags(np.array([1_700_000_000_123, 1_700_000_000_133]), "ms")
    assert clock.scale == "UTC"
    assert clock.whole.tolist() == [1_700_000_000] * 2
    np.testing.assert_allclose(clock.part, [0.123, 0.133], rtol=0, atol=1e-15)
    assert units.convert_to_date(1_700_000_000, "UTC").isoformat() == "2023-11-14T22:13:20+00:00"


def test_nanoseconds_keep_what_a_float_would_lose():
    clock = tags(np.array([1_700_000_000_000_000_001, 1_700_000_000_000_000_002]), "ns")
    np.testing.assert_allclose(clock.part, [1e-9, 2e-9], rtol=0, atol=1e-18)


def test_seconds_from_an_unknown_start_have_no_date():
    assert tags(np.array([0.0, 0.5]), "s").scale == ""
    assert tags(np.array([-1.25, 0.5]), "s").subtract(-2).tolist() == [0.75, 2.5]


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
        (lambda: units.compute_gyro_factor("furlong", None), "is not known"),
        (lambda: units.compute_gyro_factor("deg/s", "1 rad"), "goes with counts"),
        (lambda: tags([1.0, np.nan], "s"), "row 1: not a finite number"),
        (lambda: tags(["2020-01-01"], "s"), "not numbers; dates are iso"),
        (lambda: units.expect_date(tags([1_700_000_000_123], "s"), "time"), "unix time if its unit is 1000 times finer"),
    ],
)
def test_what_cannot_be_read_is_said(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_times_of_day_go_on_after_midnight():
    found = tags(["23:59:59.5", "23:59:59.75", "0:00:00.0", "00:00:00.25"], "iso")
    np.testing.assert_allclose(found.subtract(86399), [0.5, 0.75, 1.0, 1.25])
    assert found.scale == ""
    with pytest.raises(InputError, match="is not ISO 8601") as caught:
        tags(["12:00", "12:01"], "iso")
    assert "You might" not in str(caught.value)


def test_multiple_of_a_unit():
    np.testing.assert_allclose(tags([0, 200, 10_000], "100us").subtract(0), [0.0, 0.02, 1.0])
