"""Tables as gyro samples and attitudes: accumulated angles, several sensors in one table, tags."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from gyrocal import InputError
from gyrocal.importing import validate_mapping
from gyrocal.importing.streams import read_csv, read_streams
from gyrocal.importing.units import build_clock, continue_tags

BASE = {"time": "t:s", "gyro": "x,y,z:deg/s", "quat": "w,a,b,c:body-to-world:scalar-first"}


def gyro(n=20, dt=0.5):
    t = dt * np.arange(n)
    return pd.DataFrame({"t": t, "x": t, "y": 2 * t, "z": -t})


def attitudes(n=10):
    return pd.DataFrame({"t": 1.0 * np.arange(n), "w": 1.0, "a": 0.0, "b": 0.0, "c": 0.0})


def made(g=None, a=None, **changes):
    return read_streams(gyro() if g is None else g, attitudes() if a is None else a, validate_mapping(BASE | changes, "x"))


def test_rates_and_signs():
    found = made(gyro="y,-x,z:deg/s")
    np.testing.assert_allclose(np.rad2deg(found.raw), np.column_stack([gyro()["y"], -gyro()["x"], gyro()["z"]]), rtol=1e-14)
    assert found.sample_s == 0.5
    np.testing.assert_allclose(made(gyro="y,-x,z:deg/sample").raw, 2 * found.raw, rtol=1e-14)
    fixed_point = made(a=attitudes().assign(w=9830, a=-13107, s=0.5), sigma_deg="s").sensors[0]  # 0.6 and −0.8 times 2^14
    np.testing.assert_allclose(fixed_point.q[0], [-0.8, 0, 0, 0.6], atol=1e-4)
    np.testing.assert_allclose(np.rad2deg(fixed_point.sigma), 0.5)
    assert found.time_scale == "seconds of the file"
    assert [made(tag=tag).t_s[0] for tag in ("start", "middle", "end")] == [0.0, -0.25, -0.5]


def test_an_accumulated_angle_that_wraps_is_a_rate():
    t = np.arange(200.0)
    rate = np.array([1000.0, -700.0, 300.0])  # counts/s
    counts = (np.outer(t, rate) + np.array([30000, 0, -100])).astype(np.int64)
    wrapped = (counts + 2**15) % 2**16 - 2**15
    table = pd.DataFrame(np.column_stack([t, wrapped]), columns=["t", "x", "y", "z"])
    assert (np.abs(np.diff(wrapped, axis=0)) > 2**15).any()
    for wrap in ({}, {"wrap": 65536.0}):
        found = made(table, gyro="x,y,z:counts", lsb="1e-6 rad", **wrap)
        np.testing.assert_allclose(found.raw, np.tile(rate * 1e-6, (199, 1)), rtol=1e-12)
    assert any("wraps at 65536" in text for text in made(table, gyro="x,y,z:counts", lsb="1e-6 rad").assumed)


def test_a_register_that_goes_on_through_a_gap_gives_no_sample_there():
    t = np.concatenate([np.arange(50.0), 1000.0 + np.arange(50.0)])
    counts = np.outer(np.arange(100.0), [1000.0, -700.0, 300.0])
    counts[50:] += [12345.0, -20000.0, 7.0]  # how often it has wrapped in between is not known
    table = pd.DataFrame(np.column_stack([t, np.mod(counts, 2**16)]), columns=["t", "x", "y", "z"])
    found = made(table, gyro="x,y,z:counts", lsb="1e-6 rad")
    np.testing.assert_allclose(found.raw, np.tile([1e-3, -7e-4, 3e-4], (98, 1)), rtol=1e-12)
    np.testing.assert_array_equal(found.t_s, np.concatenate([t[:49], t[50:99]]))
    assert any("1 differences over gaps longer than 1.5 samples are left out" in text for text in found.assumed)


def test_rows_of_several_gyros_and_sensors_in_one_table():
    g = gyro().melt(id_vars="t", var_name="gyro", value_name="rate")
    a = pd.concat([attitudes().assign(name="A"), attitudes().assign(name="B", t=attitudes()["t"] + 0.01)])
    found = made(g, a, gyro="rate:deg/s", gyro_by="gyro", attitude_by="name")
    np.testing.assert_allclose(found.raw, made().raw)
    assert [sensor.name for sensor in found.sensors] == ["A", "B"]
    assert [one.name for one in made(a=a, attitude_by="name", sensor="B").sensors] == ["B"]
    assert found.sensors[1].t_s[0] == 0.01


def test_tags_of_a_register_go_on_where_it_wraps():
    g, a = gyro(), attitudes()
    g["t"] = (2**32 - 3_000_000 + (1e6 * g["t"]).astype("int64")) % 2**32
    a["t"] = 2**32 - 3_000_000 + (1e6 * a["t"]).astype("int64")
    found = made(g, a, time="t:us")
    np.testing.assert_allclose(found.t_s, 2**32 / 1e6 - 3 + gyro()["t"], atol=1e-9)
    assert "the tags of the gyro rows wrap 1 time(s) at 2^32 and go on" in found.assumed
    assert not any("goes back" in text for text in found.assumed)
    a["t"] %= 2**32
    np.testing.assert_allclose(made(g, a, time="t:us").sensors[0].t_s, 2**32 / 1e6 - 3 + attitudes()["t"], atol=1e-9)


@pytest.mark.parametrize(("late", "words"), [(0.03, "are too early by"), (-0.03, "are too late by")])
@pytest.mark.parametrize(("unit", "scale"), [("s", 1), ("ns", 1e9)])
def test_seconds_that_are_counted_up_late_or_early_are_moved(late, words, unit, scale):
    """Whole seconds change 30 ms after, or before, the fraction of a second does."""
    true = np.round(np.arange(0.99, 6.2, 0.01), 2)
    tags = np.floor(np.round(true - late, 9)) + np.round(true % 1, 9)
    clock = build_clock(pd.DataFrame({"t": np.round(scale * tags).astype("int64") if scale > 1 else tags}), unit)
    np.testing.assert_allclose(clock.subtract(0), true, atol=1e-6)
    assert clock.note.startswith(words)


def make_swings(amplitude, seed=0, n=3000):
    """Rates (n, 3), deg/s, of swings of 0.9 Hz, 100 a second, the first of them of that amplitude about a constant."""
    t = np.arange(n) / 100
    x = amplitude * np.sin(2 * np.pi * 0.9 * t) + 40.0
    return np.column_stack([x, 0.3 * x, 5 * np.cos(t)]) + np.random.default_rng(seed).normal(0.0, 0.1, (n, 3))


@pytest.mark.parametrize("amplitude", [2500.0, -3100.0])
def test_rates_that_overflow_are_undone_where_their_full_range_is_stated(amplitude):
    true = make_swings(amplitude)
    table = pd.DataFrame((true + 2000) % 4000 - 2000, columns=["x", "y", "z"]).assign(t=np.arange(len(true)) / 100)
    found = made(table, wrap=4000.0)
    np.testing.assert_allclose(np.rad2deg(found.raw), true, atol=1e-9)
    assert sum("readings of gyro 1 jump" in text for text in found.assumed) == 1
    assert not any("overflow" in text for text in made(table).assumed)


@pytest.mark.parametrize(
    "tags",
    [
        [0.1 * k for k in (*range(50), *range(50))],  # two logs
        [0.1 * k for k in (*range(50), *range(40, 100))],  # a clock that is set back by 1 s
        [0.1, 0.2, 0.4, 0.3, 0.5, 0.6],  # exchanged rows
    ],
)
def test_other_steps_back_are_left_to_the_order_of_time(tags):
    found, said = continue_tags(np.array(tags), "s")
    np.testing.assert_array_equal(found, tags)
    assert said == ""


@pytest.mark.parametrize("digits", [2, 4, None])
def test_attitudes_that_are_off_norm_by_more_than_rounding_are_left_out(digits):
    """Interpolation through a change of the quaternion's sign passes through zero; rounding is judged by the decimals."""
    values = Rotation.random(60, rng=np.random.default_rng(2)).as_quat(scalar_first=True)
    values[[5, 6, 40]] *= np.array([[0.97], [0.2], [1.04]])
    values = values if digits is None else np.round(values, digits)
    a = pd.DataFrame(values, columns=list("wabc")).assign(t=0.1 * np.arange(60))
    found = made(a=a)
    np.testing.assert_array_equal(np.setdiff1d(np.arange(60), np.round(10 * found.sensors[0].t_s)), [5, 6, 40])
    assert "3 attitude row(s) are not of norm 1 within" in found.assumed[0]
    a.loc[:20, list("wabc")] *= 0.5
    with pytest.raises(InputError, match="do not have norm 1"):
        made(a=a)


def test_a_log_that_starts_anew_is_refused_and_the_remedy_that_is_printed_works(tmp_path, monkeypatch):
    """Rows of two logs would be mixed by the order of their times."""
    monkeypatch.chdir(tmp_path)
    g = pd.concat([gyro(40), gyro(30)])
    Path("g.csv").write_text("log of a test\n" + g.to_csv(index=False))
    with pytest.raises(InputError, match="which is no wrap; if another log starts there") as caught:
        made(read_csv(Path("g.csv")), attitudes(20))
    command = re.search(r"head -n .*\.csv", str(caught.value))[0]
    subprocess.run(command, shell=True, check=True)
    assert made(read_csv(Path("part.csv")), attitudes(20)).t_s.size == 40


def test_stray_tags_are_left_out_exchanged_rows_are_put_in_order_and_a_reversed_table_is_turned():
    g, a = gyro(400), attitudes(200)
    g.loc[[50, 300], "t"] = [0.0, 1e9]  # rows that a logger could not tag
    a = a.iloc[[*range(20), 21, 20, *range(22, 200)]]
    found = made(g, a)
    said = " ".join(found.assumed)
    assert "2 of the gyro rows have a time tag far from those beside them: left out, the first row 50" in said
    assert "the time goes back 1 time(s) in the attitude rows, first to 20 s: put in order" in said
    np.testing.assert_array_equal(found.t_s, gyro(400)["t"])
    turned = made(gyro().iloc[::-1])
    np.testing.assert_array_equal(turned.raw, made().raw)
    assert any("in the reverse order of time" in text for text in turned.assumed)
