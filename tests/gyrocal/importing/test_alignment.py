"""Time offset, clock, direction, mounting and factor are found with their sigmas, and faults of a misfit are named."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import gyrocal
import simulator
from gyrocal import InputError, importing
from gyrocal.importing import misfit, validate_mapping
from gyrocal.importing.agreement import evaluate_agreement
from gyrocal.importing.alignment import estimate_alignment, refine
from gyrocal.importing.build import build
from gyrocal.importing.motion import build_motion
from gyrocal.importing.streams import read_streams
from studies.cli import import_
from studies.validation import mems_log
from tests.builders import choose_case_numbers
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


@pytest.mark.parametrize("factor", [1 - 75e-6, 1.02])
def test_auto_undoes_a_clock_and_an_offset_and_the_mapping_repeats_it(data, factor):
    off = with_clock(data, factor, 1.7)
    made = build(*read(off, align="auto"))
    assert made.mapping.align == "as given"
    assert made.mapping.attitude_offset_s == pytest.approx(1.7, abs=0.01)
    assert any("± " in text and "which differs from zero" in text for text in made.assumed)
    again = build(read_streams(off.gyro, off.attitude, made.mapping), made.mapping)
    np.testing.assert_allclose(again.recording.attitudes.t_s, made.recording.attitudes.t_s, atol=1e-9)
    np.testing.assert_allclose(again.recording.gyro.t_s, made.recording.gyro.t_s, atol=1e-9)
    assert any("does not differ from zero" in text for text in again.assumed)
    error = gyrocal.calibrate(made.recording).parameters.G - data.G
    assert np.abs(error).max() < 0.01


def test_temperatures_keep_the_times_of_their_rows(data):
    """Of a clock that runs fast and counts from the start of the device."""
    off = with_clock(data, 1.02, 1.7)
    degrees = np.arange(len(off.gyro)) / 100.0
    off = replace(off, gyro=off.gyro.assign(warm=np.where(degrees % 0.03 < 0.015, degrees, np.nan)))
    off = replace(off, gyro=off.gyro.assign(timestamp_ms=off.gyro["timestamp_ms"] - mems_log.UNIX_MS + 4.2e6))
    made = build(*read(off, align="auto", temperature="warm"))
    again = build(read_streams(off.gyro, off.attitude, made.mapping), made.mapping)
    for recording in (made.recording, again.recording):
        warm = recording.tables["housekeeping"]
        assert warm.columns.tolist() == ["t_s", "gyro_temperature_c"]
        assert len(warm) < 0.7 * len(degrees)
        t_s = np.interp(warm["gyro_temperature_c"], degrees, recording.gyro.t_s)
        np.testing.assert_allclose(warm["t_s"], t_s, atol=2e-9)


def test_increments_per_sample_are_named_and_read(data):
    angle = np.deg2rad(data.gyro[RATES]) * mems_log.MEMS_SAMPLE_S
    wrong = replace(data, gyro=data.gyro.assign(**angle))
    words = "the gyro as increments in rad/sample, not rad"
    assert find_refusal(wrong, {"gyro": "gx,gy,gz:rad"}).endswith(words)
    right, _ = read(wrong, gyro="gx,gy,gz:rad/sample")
    np.testing.assert_allclose(right.raw, np.deg2rad(data.gyro[RATES]), rtol=1e-9)


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


def test_sigma_is_a_number_three_or_columns(data):
    table = data.attitude.assign(s=np.linspace(0.1, 0.3, len(data.attitude)))
    own = replace(data, attitude=table)
    for stated, wanted in ((0.3, 0.3), ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3])):
        sigma = build(*read(own, sigma_deg=stated)).recording.attitudes.sigma
        np.testing.assert_allclose(np.rad2deg(sigma), np.broadcast_to(wanted, sigma.shape))
    made = build(*read(own, sigma_deg="s"))
    sigma = np.rad2deg(made.recording.attitudes.sigma[:, 0])
    assert sigma[0] < 0.12
    assert sigma[-1] > 0.28
    assert not made.recording.attitudes.sigma_estimated
    with pytest.raises(InputError, match="not a number, three numbers, a column"):
        read(own, sigma_deg="s,s")


def windows_of(data, change):
    streams, _ = read(data)
    one = streams.sensors[0]
    rates = change(streams.raw @ data.G.T + data.bias, streams.t_s - streams.t_s[0])
    return build_motion(streams.t_s, rates, streams.sample_s, one.t_s, one.q)


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("bias", lambda w, t: w + 0.2),
        ("scale", lambda w, t: 0.7 * w),
        ("step", lambda w, t: w + 0.2 * (t > 35)[:, None]),
        ("jump", lambda w, t: np.where((t > 30)[:, None], np.roll(w, 25, axis=0), w)),
        ("clipping", lambda w, t: np.clip(w, [-9, -0.4, -9], [9, 0.4, 9])),
    ],
)
def test_the_fault_that_explains_a_misfit_is_named(data, kind, change):
    found = misfit.explain_misfit(windows_of(data, change))
    assert found.kind == kind
    assert (found.bias is None) == (kind != "bias")


def test_noise_is_no_fault_and_a_misfit_is_located(data):
    rng = np.random.default_rng(3)

    def shaken(w, t):
        return w + np.where(((t > 20) & (t < 28))[:, None], rng.normal(size=w.shape) * 5, 0)

    windows = windows_of(data, shaken)
    assert misfit.explain_misfit(windows) is None
    start, stop = (float(word) for word in misfit.locate_misfit(windows).split(" s, ")[0].split("between ")[1].split(" and "))
    assert 19 < start < stop < 29


def test_a_constant_bias_is_no_cause_of_a_misfit_that_is_stated_without_it(data):
    rng = np.random.default_rng(4)
    windows = windows_of(data, lambda w, t: w + 6.0 + rng.normal(size=w.shape))
    found = evaluate_agreement(windows)
    assert "fit only roughly" in found.summary
    assert "bias" not in found.summary


def test_every_command_takes_the_same_alignment_options(data, tmp_path):
    for name in ("csv", "aem", "ck", "euroc", "bag"):
        known = {option for one in import_.command.commands[name].params for option in one.opts}
        wanted = {"--align", "--attitude-offset", "--time-factor", "--rate-factor", "--mounting", "--sigma", "--unchecked"}
        assert wanted <= known, name
    gyro, attitude = tmp_path / "g.csv", tmp_path / "a.csv"
    gyro_table = data.gyro.assign(**dict(zip(RATES, 4 * data.gyro[RATES].to_numpy().T, strict=True)))
    gyro_table.assign(warm=31.5).to_csv(gyro, index=False)
    data.attitude.to_csv(attitude, index=False)
    words = [str(gyro), str(attitude), str(tmp_path / "out"), "--time", "timestamp_ms:ms", "--gyro", "gx,gy,gz:deg/s"]
    words += ["--quat", "qw,qx,qy,qz:body-to-world", "--align", "auto", "--sigma", "0.1", "--temperature", "warm"]
    ran = CliRunner().invoke(import_.command, ["csv", *words])
    assert ran.exit_code == 0, ran.output
    assert ran.output.startswith("implausible: the rates are multiplied by 0.2")
    written = gyrocal.recording.read_toml(tmp_path / "out" / importing.NOTES_FILE)["mapping"]
    assert written["sigma_deg"] == 0.1
    assert (gyrocal.load(tmp_path / "out").tables["housekeeping"]["gyro_temperature_c"] == 31.5).all()
    assert written["rate_factor"] == pytest.approx(0.25, rel=0.03)


def test_errors_of_the_gyro_do_not_widen_the_time_offsets_sigma():
    """The residuals beside a rotation and a scale factor hold them: sigma was three times too large."""
    data = mems_log.log(np.random.default_rng(3), seconds=60.0)
    streams, _ = read(data)
    one = streams.sensors[0]
    with_errors, without = (
        refine(build_motion(streams.t_s, rates, streams.sample_s, one.t_s, one.q), False, with_clock=False)
        for rates in (streams.raw, streams.raw @ data.G.T)
    )
    assert with_errors.offset_sigma == pytest.approx(without.offset_sigma, rel=0.2)


def test_errors_of_the_gyro_are_no_time_offset():
    """References a minute apart in slow turns: unequal scale factors and skew axes passed for 1.06 ± 0.07 s."""
    recording = simulator.simulate(simulator.load("trmm_series"), seed=1)
    gyro, attitudes = recording.gyro, recording.attitudes
    found = refine(build_motion(gyro.t_s, gyro.rates, gyro.sample_s, attitudes.t_s, attitudes.quaternions))
    assert abs(found.offset_s) < 3 * found.offset_sigma
    assert found.offset_sigma < np.median(np.diff(attitudes.t_s))
    assert not found.is_clock_off


@pytest.mark.parametrize("are_small_rates_read", [True, False])
def test_a_rotation_about_the_only_axis_of_a_motion_needs_the_other_rates(are_small_rates_read):
    """A pendulum about z that cones: if the gyro has an error in place of its small rates, the angle about z is left open."""
    step, turn = 0.01, Rotation.from_rotvec([0.0, 0.0, np.deg2rad(120.0)])
    t = step * np.arange(6000)
    rng = np.random.default_rng(8)
    cones = 0.1 * np.cos(4.1 * t)
    rates = np.column_stack([cones, 0.02 * np.sin(1.7 * t), 1.5 * np.sin(4.1 * t)])
    steps = Rotation.from_rotvec(rates * step)
    body = [Rotation.identity()]
    for one in steps:
        body.append(body[-1] * one)
    q = Rotation.concatenate(body[::5])
    q = (q * Rotation.from_rotvec(1e-3 * rng.standard_normal((len(q), 3)))).as_quat()
    read_rates = turn.inv().apply(rates) * [are_small_rates_read, are_small_rates_read, 1.0]
    if not are_small_rates_read:
        read_rates[:, 1] += 0.2 * cones
    found = estimate_alignment(t, read_rates, step, step * 5 * np.arange(len(q)), q)
    assert not found.reverse
    assert found.is_turned == are_small_rates_read
    assert np.abs((Rotation.from_matrix(found.C) * turn.inv()).as_rotvec())[2] < 4 * found.turn_sigma[2]


def test_a_delay_that_differs_between_parts_is_in_the_sigma_of_the_offset():
    """A clock that slips back every 20 s: parts of the recording agree within their sigmas; a constant delay has less."""
    found, constant = [], []
    for seed in range(4):
        data = mems_log.log(np.random.default_rng([8, seed]), seconds=60.0)
        streams, _ = read(data)
        one = streams.sensors[0]
        for delay, out in ((0.02 * ((one.t_s / 20) % 1), found), (np.full(one.t_s.size, 0.01), constant)):
            for part in (one.t_s < 36.0, one.t_s > -1.0):
                rows = streams.t_s < one.t_s[part][-1]
                samples = streams.t_s[rows], streams.raw[rows], streams.sample_s
                windows = build_motion(*samples, (one.t_s - delay)[part], one.q[part])
                out.append(refine(windows, reverse=False, with_clock=False))
    z = [
        (a.offset_s - b.offset_s) / np.hypot(a.offset_sigma, b.offset_sigma)
        for a, b in zip(found[::2], found[1::2], strict=True)
    ]
    assert np.abs(z).max() < 3
    assert all(abs(one.offset_s - 0.01) < 3 * one.offset_sigma for one in [*found, *constant])
    assert np.mean([one.offset_sigma for one in constant]) < 0.4 * np.mean([one.offset_sigma for one in found])
