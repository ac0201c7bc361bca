"""Time offset, clock, direction, mounting and factor are found with their sigmas, and a misfit is located."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import gyrocal
import simulator
from gyrocal.importing import motion, validate_mapping
from gyrocal.importing.alignment import estimate_alignment, refine
from gyrocal.importing.build import import_streams
from gyrocal.importing.motion import build_motion
from gyrocal.importing.streams import read_streams
from tests.builders import choose_case_numbers
from tests.gyrocal.importing import mems_log
from tests.gyrocal.importing.mems import CORRECT_MAPPING, find_refusal

RATES = ["gx", "gy", "gz"]


@pytest.fixture(scope="module")
def data():
    return mems_log.log(np.random.default_rng(31), seconds=60.0)


def read(data, **changes):
    mapping = validate_mapping(CORRECT_MAPPING | changes, "x")
    return read_streams(data.gyro, data.attitude, mapping), mapping


def with_clock(data, factor, offset_s):
    """The log with the gyro's clock too fast by a factor, and the attitudes' tags too early by an offset."""
    t = mems_log.UNIX_MS
    gyro = data.gyro.assign(timestamp_ms=t + (data.gyro["timestamp_ms"] - t) / factor)
    return replace(data, gyro=gyro, attitude=data.attitude.assign(timestamp_ms=data.attitude["timestamp_ms"] - 1e3 * offset_s))


@pytest.mark.parametrize("logs", choose_case_numbers(3, 12))
def test_alignment_is_found_within_its_sigmas(logs):
    """Over logs whose G is the identity, so that nothing but what is estimated differs, errors have a chi-square of one."""
    errors = []
    for seed in range(logs):
        rng = np.random.default_rng(seed)
        data = mems_log.log(rng, seconds=60.0)
        raw = np.deg2rad(data.gyro[RATES].to_numpy()) @ data.G.T
        turn = Rotation.from_rotvec([0.6, -0.9, 0.4])
        data = replace(data, gyro=data.gyro.assign(**dict(zip(RATES, np.rad2deg(turn.inv().apply(raw) / 0.25).T, strict=True))))
        streams, _ = read(with_clock(data, 1.0003, 2.5))
        one = streams.sensors[0]
        conjugate = Rotation.from_quat(one.q).inv().as_quat()
        found = estimate_alignment(streams.t_s, streams.raw, streams.sample_s, one.t_s, conjugate)
        assert found.reverse
        assert found.residual < 0.05
        missed = (Rotation.from_matrix(found.C) * turn.inv()).as_rotvec() / found.turn_sigma
        errors.append(
            [
                (found.offset_s - 2.5) / found.offset_sigma,
                (found.time_factor - 1.0003) / found.time_sigma,
                (found.factor - 0.25) / found.factor_sigma,
                *missed,
            ]
        )
    mean = np.mean(np.square(errors), axis=0)
    assert (mean < chi2.ppf(1 - 1e-4, len(errors)) / len(errors)).all(), mean
    assert mean.mean() > chi2.ppf(1e-4, mean.size * len(errors)) / (mean.size * len(errors))


def test_auto_undoes_a_clock_and_an_offset_and_the_mapping_repeats_it(data):
    off = with_clock(data, 1.02, 1.7)
    made = import_streams(*read(off, align="auto"))
    assert made.mapping.align == "as given"
    assert made.mapping.attitude_offset_s == pytest.approx(1.7, abs=0.01)
    assert any("± " in text and "which differs from zero" in text for text in made.assumed)
    again = import_streams(read_streams(off.gyro, off.attitude, made.mapping), made.mapping)
    np.testing.assert_allclose(again.recording.attitudes.t_s, made.recording.attitudes.t_s, atol=1e-9)
    np.testing.assert_allclose(again.recording.gyro.t_s, made.recording.gyro.t_s, atol=1e-9)
    assert any("does not differ from zero" in text for text in again.assumed)
    error = gyrocal.calibrate(made.recording).parameters.G - data.G
    assert np.abs(error).max() < 0.01


def test_temperatures_keep_the_times_of_their_rows(data):
    """Of a clock that runs fast and counts from the start of the device."""
    off, degrees = with_clock(data, 1.02, 1.7), np.arange(len(data.gyro)) / 100.0
    warm = {"warm": np.where(degrees % 0.03 < 0.015, degrees, np.nan)}
    gyro = off.gyro.assign(timestamp_ms=off.gyro["timestamp_ms"] - mems_log.UNIX_MS + 4.2e6, **warm)
    recording = import_streams(*read(replace(off, gyro=gyro), align="auto", temperature="warm")).recording
    found = recording.tables["housekeeping"]
    assert len(found) < 0.7 * len(degrees)
    t_s = np.interp(found["gyro_temperature_c"], degrees, recording.gyro.t_s)
    np.testing.assert_allclose(found["t_s"], t_s, atol=2e-9)


@pytest.mark.parametrize(
    ("stated", "words"), [("deg:XYZ", "the Euler angles as ZYX, not XYZ"), ("rad:ZYX", "the Euler angles in deg, not rad")]
)
def test_euler_angles_in_another_order_or_unit_are_named(data, stated, words):
    q = np.roll(data.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)
    angles = Rotation.from_quat(q).as_euler("ZYX", degrees=True)
    table = data.attitude[["timestamp_ms"]].assign(**dict(zip("abc", angles.T, strict=True)))
    entries = {"quat": None, "euler": f"a,b,c:{stated}:body-to-inertial"}
    message = find_refusal(replace(data, attitude=table), entries)
    assert words in message


def windows_of(data, change):
    streams, _ = read(data)
    one = streams.sensors[0]
    rates = change(streams.raw @ data.G.T + data.bias, streams.t_s - streams.t_s[0])
    return build_motion(streams.t_s, rates, streams.sample_s, one.t_s, one.q)


@pytest.mark.parametrize("from_s", [0.0, 12.0, 35.0])
def test_a_constant_bias_is_told_from_a_step_of_it(data, from_s):
    windows = windows_of(data, lambda w, t: w - 0.2 * (t >= from_s)[:, None])
    bias = motion.estimate_constant_bias(windows)
    if from_s > 0:
        assert bias is None
    else:
        np.testing.assert_allclose(bias, 0.2, atol=0.01)


def test_the_time_of_a_misfit_is_located(data):
    windows = windows_of(data, lambda w, t: w + 0.2 * ((t > 30) & (t < 36))[:, None])
    words = motion.locate_misfit(windows)
    first, last = (float(one) for one in re.search(r"between (\S+) and (\S+) s", words).groups())
    start = windows.t_s[0]
    assert 29.5 < first - start < last - start < 36.5
    assert last - first == pytest.approx(3.0, abs=0.5)


def test_errors_of_the_gyro_are_no_time_offset():
    """References a minute apart in slow turns: unequal scale factors and skew axes passed for 1.06 ± 0.07 s."""
    recording = simulator.simulate(simulator.load("trmm_series"), seed=1)
    gyro, attitudes = recording.gyro, recording.attitudes
    found = refine(build_motion(gyro.t_s, gyro.rates, gyro.sample_s, attitudes.t_s, attitudes.quaternions))
    assert abs(found.offset_s) < 3 * found.offset_sigma
    assert found.offset_sigma < np.median(np.diff(attitudes.t_s))
    assert not found.is_clock_off
