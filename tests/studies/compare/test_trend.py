"""The trend of a unit's simulated recordings: a change is found, dated and shown, and heat or a switch is none."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import simulator
from gyrocal import Attitudes, GyroParameters, InputError, calibrate, save
from gyrocal.calibration.gyros import calibrate_gyros
from studies.compare.trend import ARCSEC_PER_RAD, estimate_trend
from studies.report import trend as trend_report
from tests.builders import piecewise_recording
from tests.gyro_arrays import array_recording

NAMES = ("one", "two", "three", "four", "five", "six")
TURNS = [[(0.1 * sign * np.eye(3)[k] * np.deg2rad(1), 600.0)] for k in range(3) for sign in (1, -1)]
ARW = np.deg2rad(2e-4)


def simulate_unit(change_ppm, first_changed=3):
    """Six months of TRMM's calibration, with the scale factor of gyro x changed from one recording on."""
    scenario = simulator.load("trmm")
    out = {}
    for k, name in enumerate(NAMES):
        G = np.array(scenario.gyro.true_G)
        G[:, 0] /= 1 + 1e-6 * change_ppm * (k >= first_changed)
        changes = {"gyro.true_G": G.tolist(), "gyro.sample_s": 5.0, "epoch": f"1998-0{k + 1}-13T09:45:00Z"}
        out[name] = simulator.simulate(simulator.override(scenario, changes), seed=k)
    return out


@pytest.fixture(scope="module")
def unit():
    return simulate_unit(20000.0)


@pytest.fixture(scope="module")
def found(unit):
    return estimate_trend(dict(reversed(unit.items())))


def test_a_change_of_a_scale_factor_is_named_and_dated(found):
    """The recordings are given last first: the epochs give their order."""
    assert found.recordings["recording"].tolist() == list(NAMES)
    assert found.is_timed
    assert found.days[1] == pytest.approx(31.0)
    ((one, change, alarm),) = found.changes
    assert (one.name, change.date, change.date_interval) == ("gyro x, scale factor", 3, (3, 3))
    assert change.step == pytest.approx(20000, abs=4 * change.step_sigma)
    assert alarm >= 3
    assert found.log_threshold == pytest.approx(np.log(120))


def test_a_unit_without_a_change_has_no_alarm(unit):
    same = {name: unit[name] for name in NAMES[:3]} | simulate_unit(0.0)
    assert estimate_trend(same, largest_walk=0.0).changes == ()


def test_values_and_sigmas_are_those_of_the_calibration_in_gyro_space(unit, found):
    """An independent course: N's own parametrisation, with its own covariance."""
    result = calibrate(unit["one"], parametrisation="gyro")
    summary = result.summary().set_index("parameter")
    for gyro in "xyz":
        shown = {one.parameter: one for one in found.parameters if one.gyro == gyro}
        for ours, theirs, factor in (("scale factor", f"s_{gyro}", 1e6), ("bias", f"c_{gyro}", 3600.0)):
            row = summary.loc[theirs]
            assert shown[ours].sigma[0] == pytest.approx(factor * row["sigma"], rel=1e-3)
            expected = factor * (row["calibrated"] - (ours == "scale factor"))
            assert shown[ours].value[0] == pytest.approx(expected, abs=0.05 * shown[ours].sigma[0])
        for axis in sorted(set("xyz") - {gyro}):
            row = summary.loc[f"u_{gyro}{axis}"]
            one = shown[f"misalignment {axis}"]
            assert one.sigma[0] == pytest.approx(ARCSEC_PER_RAD * row["sigma"], rel=1e-2)
            assert one.value[0] == pytest.approx(ARCSEC_PER_RAD * row["correction"], abs=0.05 * one.sigma[0])


def test_the_page_and_the_sentences_name_the_change(found):
    said = trend_report.describe_trend(found)
    assert said[0] == "1 of 12 parameters has changed over 6 recordings."
    assert said[1].startswith("gyro x, scale factor: changes by +")
    assert "before four; alarm at " in said[1]
    page = trend_report.build_trend_page(found)
    assert said[1] in page
    assert page.count("data:image/svg+xml") == 2
    assert "Not every recording has a housekeeping column" in page
    values = found.tabulate_values()
    assert len(values) == 6 * 12
    assert values["log10_e"].max() > 2


def warm(recording, celsius):
    """The recording with the temperature of its gyro, in which a value is missing."""
    table = pd.DataFrame({"t_s": recording.gyro.t_s[:3], "gyro_temperature_c": [celsius, np.nan, celsius]})
    return replace(recording, tables={"housekeeping": table})


def turn_recordings(scales, seed=1):
    """Six turns about x, y and z for each of some scale factors of gyro x, a month apart."""
    rng, out = np.random.default_rng(seed), {}
    for k, scale in enumerate(scales):
        truth = GyroParameters(np.diag([1 / scale, 1.0, 1.0]), np.zeros(3))
        one = piecewise_recording(TURNS, 1.0, truth, sigma_deg=0.002, arw=ARW, rng=rng)
        out[NAMES[k % 6] * (k // 6 + 1)] = replace(one, epoch=f"2001-{k + 1:02d}-01T00:00:00")
    return out


def test_heat_is_no_change():
    """A scale factor that follows the temperature: with the column it is constant, without it has changed."""
    celsius = np.array([20.0, 21.0, 24.0, 19.0, 22.0, 23.0, 40.0, 44.0, 41.0, 45.0, 42.0, 43.0])
    cold = turn_recordings(1 + 300e-6 * (celsius - 20))
    heated = {name: warm(one, t) for (name, one), t in zip(cold.items(), celsius, strict=True)}
    found = estimate_trend(heated, largest_walk=1.0)
    assert found.recordings["temperature_c"].tolist() == celsius.tolist()
    assert found.changes == ()
    assert found.log_threshold == pytest.approx(np.log(240))
    assert [one.name for one, *_ in estimate_trend(cold, largest_walk=1.0).changes] == ["gyro x, scale factor"]
    page = trend_report.build_trend_page(found)
    assert page.count("data:image/svg+xml") == 3
    assert "None of 12 parameters is known to have changed" in page
    steady = {name: warm(one, 20.0 + 0.1 * k) for k, (name, one) in enumerate(cold.items())}
    assert len(estimate_trend(steady, largest_walk=1.0).changes) == 1
    mixed = estimate_trend(heated | {"one": cold["one"]}, largest_walk=1.0)
    assert "Not all recordings have a temperature: no parameter is corrected for it." in trend_report.describe_trend(mixed)


def test_one_recording_may_switch_sets_of_gyros():
    """Four gyros, of which gyro 2 is off in two intervals of every second recording, and gyro 4 changes its bias."""
    out = {}
    for k, name in enumerate(NAMES):
        on = [None] * 6 if k % 2 else [None, None, ("1", "3", "4"), ("1", "3", "4"), None, None]
        plan = {"plan": TURNS, "sample_s": 1.0, "series_s": 100.0, "sigma_deg": 0.002}
        one, *_ = array_recording(arw=ARW, rng=np.random.default_rng(k), gyros=on, **plan)
        one.gyro.rates[:, 3] += np.deg2rad(1.0) / 3600 * (k >= 2)
        out[name] = replace(one, epoch=f"2001-0{k + 1}-01T00:00:00Z")
    found = estimate_trend(out, largest_walk=0.0)
    assert found.log_threshold == pytest.approx(np.log(10 * 4 * 5))
    (one, change, _), *others = found.changes
    assert (one.name, change.date) == ("gyro 4, bias", 2)
    assert change.step == pytest.approx(1.0, abs=4 * change.step_sigma)
    assert others == []


def test_sigmas_hold_where_no_remainder_is_estimated():
    """Residuals of gyros without a remainder widen the sigmas by themselves."""
    plan = {"plan": TURNS, "sample_s": 1.0, "series_s": 100.0, "sigma_deg": 0.002}
    one, *_ = array_recording(arw=ARW, rng=np.random.default_rng(1), **plan)
    attitudes = one.attitudes
    worse = replace(one, attitudes=Attitudes(attitudes.t_s, attitudes.quaternions, attitudes.sigma / 5))
    found = estimate_trend({"one": worse, "two": worse})
    assert found.recordings["sigmas"].tolist() == ["scaled", "scaled"]
    assert not found.is_timed
    result = calibrate_gyros(worse)
    excess = (result.chi2 - result.parity_chi2) / (result.dof - result.parity_dof)
    assert excess > 2
    expected = result.summary()["sigma_scale_factor"] * np.sqrt(excess)
    shown = [one.sigma[0] / 1e6 for one in found.parameters if one.parameter == "scale factor"]
    np.testing.assert_allclose(shown, expected)
    said = trend_report.describe_trend(found)
    assert "In 2 of 2 recordings the sigmas are scaled to the residuals, which do not fit the stated noise." in said
    assert any(line.startswith("The recordings overlap in time") for line in said)


def test_what_a_recording_does_not_determine_is_left_out():
    """Without a turn about x the first recording says nothing of that scale factor."""
    out = turn_recordings([1.0] * 3)
    bare = piecewise_recording(TURNS[2:], 1.0, sigma_deg=0.002, arw=ARW, rng=np.random.default_rng(2))
    found = estimate_trend(out | {"one": replace(bare, epoch="2001-01-01")})
    (one,) = [one for one in found.parameters if one.name == "gyro x, scale factor"]
    assert one.places.tolist() == [1, 2]
    assert np.isnan(one.value[0])


def test_the_command_writes_a_table_and_a_page(unit, tmp_path, run_cli):
    for name in NAMES:
        save(unit[name], tmp_path / "unit" / name)
    done = run_cli("trend", str(tmp_path / "unit"), "--out", str(tmp_path / "out"))
    assert done.exit_code == 0, done.stderr
    assert "gyro x, scale factor: changes by +" in done.stdout
    assert "before four;" in done.stdout
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["trend.csv", "trend.html"]
    table = pd.read_csv(tmp_path / "out" / "trend.csv")
    assert set(table["recording"]) == set(NAMES)


def test_recordings_of_different_gyros_are_refused_in_one_line(unit, tmp_path, run_cli):
    save(unit["one"], tmp_path / "one")
    save(array_recording()[0], tmp_path / "two")
    done = run_cli("trend", str(tmp_path / "one"), str(tmp_path / "two"))
    assert (done.exit_code, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "two: has the gyros 1, 2, 3, 4, and one has x, y, z; give recordings of one unit" in done.stderr


def test_a_recording_that_cannot_be_calibrated_is_named(unit):
    still = piecewise_recording([[(np.zeros(3), 10.0)]], sigma_deg=20.0, arw=1.0)
    with pytest.raises(InputError, match=r"^two: "):
        estimate_trend({"one": unit["one"], "two": still})
