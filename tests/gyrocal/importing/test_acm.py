"""CCSDS ACM against another implementation and by hand."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import acm
from studies.validation import mems_log
from tests.builders import piecewise_recording

RECORDING = replace(
    piecewise_recording(series_s=200.0, arw=2e-6), epoch="2020-08-16T12:02:08.250Z", time_scale="UTC", title="a craft <&>"
)
BIAS, BIAS_SIGMA = np.array([1e-6, -2e-6, 3e-6]), np.array([1e-8, 2e-8, 3e-8])


@pytest.fixture(params=["kvn", "xml"])
def message(tmp_path, request):
    path = tmp_path / "out.acm"
    acm.write_acm(RECORDING, path, bias=BIAS, bias_sigma=BIAS_SIGMA, object_name="CRAFT", form=request.param)
    return path


def check(found):
    np.testing.assert_allclose(found.attitudes.q, RECORDING.attitudes.quaternions, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.sigma, np.sqrt(np.mean(np.square(RECORDING.attitudes.sigma), axis=0)), rtol=1e-12)
    np.testing.assert_allclose(found.gyro_bias, np.tile(BIAS, (len(found.attitudes.q), 1)), rtol=1e-12)
    np.testing.assert_allclose(found.gyro_bias_sigma, BIAS_SIGMA, rtol=1e-12)
    assert found.arw == pytest.approx(2e-6, rel=1e-12)
    assert (found.attitudes.title, found.attitudes.frames) == ("CRAFT", ("ICRF", "SC_BODY_1"))
    clock = found.attitudes.clock
    assert (clock.scale, clock.whole[0], clock.part[0]) == ("UTC", 1597579328, 0.25)
    np.testing.assert_allclose(clock.since(1597579328) - 0.25, RECORDING.attitudes.t_s, rtol=0, atol=1e-8)


def test_what_is_written_is_read(message):
    check(acm.read_acm(message))


def test_another_implementation_reads_what_is_written_and_writes_what_is_read(message, tmp_path):
    other = pytest.importorskip("ccsds_ndm")
    theirs = other.Acm.from_file(str(message))
    theirs.validate()
    data = theirs.segment.data
    states = np.concatenate([np.array(one.att_lines) for one in data.att])
    np.testing.assert_allclose(states[:, 1:5], RECORDING.attitudes.quaternions, rtol=0, atol=1e-12)
    np.testing.assert_allclose(states[:, 5:], np.tile(np.rad2deg(BIAS), (len(states), 1)), rtol=1e-12)
    variances = np.concatenate([np.array(one.cov_lines) for one in data.cov])
    expected = np.square(np.rad2deg(np.column_stack([RECORDING.attitudes.sigma, np.tile(BIAS_SIGMA, (len(states), 1))])))
    np.testing.assert_allclose(variances[:, 1:], expected, rtol=1e-12)
    assert data.ad.sigma_v == pytest.approx(np.rad2deg(2e-6), rel=1e-12)
    assert (data.cov[0].cov_type, data.att[0].rate_type) == ("ANGLE_GYROBIAS", "GYRO_BIAS")
    for form in ("kvn", "xml"):
        theirs.to_file(str(tmp_path / "again.acm"), format=form)
        check(acm.read_acm(tmp_path / "again.acm"))


HAND = """CCSDS_ACM_VERS = 2.0
CREATION_DATE = 2020-01-01T00:00:00
ORIGINATOR = HAND
META_START
OBJECT_NAME = ONE
TIME_SYSTEM = TAI
EPOCH_TZERO = 2020-08-16T12:02:46.5
META_STOP
ATT_START
REF_FRAME_A = J2000
REF_FRAME_B = SC_BODY_1
NUMBER_STATES = 7
ATT_TYPE = QUATERNION
RATE_TYPE = GYRO_BIAS
0.75 0 0 0.70710678118654752 0.70710678118654752 0.001 0 -0.002
2020-08-16T12:02:48.5 0 0 0 1 0.001 0 -0.002
ATT_STOP
COV_START
COV_BASIS = DETERMINED_OBC
COV_REF_FRAME = SC_BODY_1
COV_TYPE = ANGLE_GYROBIAS
0.75 9e-6 1e-6 4e-6 1e-8 4e-8 9e-8
1.75 7e-6 1e-6 4e-6 1e-8 4e-8 16e-8
COV_STOP
AD_START
ATTITUDE_STATES = QUATERNION
SIGMA_V = 2.0e-4 [deg/s**0.5]
SENSOR_START
SENSOR_NUMBER = 1
SENSOR_STOP
AD_STOP
"""


def test_a_message_by_hand(tmp_path):
    # Frame B is frame A turned by +90 deg about z: A's x axis has the components (0, −1, 0) in B. Variances are in deg².
    path = tmp_path / "hand.acm"
    path.write_text(HAND)
    found = acm.read_acm(path)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.attitudes.q)[0] @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(np.rad2deg(found.sigma), [np.sqrt(8e-6), 1e-3, 2e-3], rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(found.gyro_bias_sigma), [1e-4, 2e-4, 4e-4], rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(found.gyro_bias[1]), [1e-3, 0, -2e-3], rtol=1e-12)
    assert np.rad2deg(found.arw) == pytest.approx(2e-4, rel=1e-12)
    # TAI is 19 s ahead of GPS time, which was 18 s ahead of UTC: 12:02:47.25 TAI is 12:02:10.25 UTC.
    utc = gyrocal.importing.units.to_utc(found.attitudes.clock)
    assert (utc.whole.tolist(), utc.part.tolist()) == ([1597579330, 1597579331], [0.25, 0.5])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("CCSDS_ACM_VERS", "CCSDS_AEM_VERS", "not an ACM"),
        ("EPOCH_TZERO = 2020-08-16T12:02:46.5", "EPOCH_TZERO = noon", "EPOCH_TZERO: time data"),
        ("EPOCH_TZERO = 2020-08-16T12:02:46.5\n", "", "no EPOCH_TZERO"),
        ("ATT_TYPE = QUATERNION", "ATT_TYPE = DCM", "attitude type DCM is not read"),
        ("TIME_SYSTEM = TAI", "TIME_SYSTEM = TDB", "time system TDB"),
        ("0.001 0 -0.002\n2020", "0.001 0\n2020", "line 15: 7 numbers are needed"),
        ("0.75 9e-6", "0.75 -9e-6", "line 22: a variance is negative"),
        ("SIGMA_V = 2.0e-4", "SIGMA_V = low", "SIGMA_V: could not convert"),
        ("0.75 0 0 0.7", "x.75 0 0 0.7", "line 15: could not convert"),
        ("AD_STOP\n", "", "AD_START without AD_STOP"),
        ("ATT_START", "MAN_START", "ATT_STOP ends no block"),
    ],
)
def test_what_an_acm_lacks_is_said(tmp_path, old, new, words):
    path = tmp_path / "hand.acm"
    path.write_text(HAND.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        acm.read_acm(path)


def test_a_held_bias_is_not_written(tmp_path):
    for given in ({"bias": BIAS}, {"bias": BIAS, "bias_sigma": [1e-8, 0.0, 1e-8]}):
        with pytest.raises(InputError, match="bias and bias_sigma"):
            acm.write_acm(RECORDING, tmp_path / "x.acm", **given)
    acm.write_acm(RECORDING, tmp_path / "x.acm")
    found = acm.read_acm(tmp_path / "x.acm")
    assert found.gyro_bias is None
    assert found.arw is None
    np.testing.assert_allclose(found.sigma, RECORDING.attitudes.sigma[0], rtol=1e-12)


def test_a_gyro_and_an_acm_are_calibrated_and_the_result_is_exported(run_cli, tmp_path):
    log = mems_log.log(np.random.default_rng(12), seconds=60.0)
    g = log.gyro.assign(time=pd.to_datetime(log.gyro["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f"))
    g.to_csv(tmp_path / "gyro.csv", index=False)
    q = np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)
    t = (log.attitude["timestamp_ms"] - mems_log.UNIX_MS).to_numpy() / 1000
    made = gyrocal.Recording.from_arrays(
        t,
        np.zeros((t.size, 3)),
        t,
        q,
        sigma=np.deg2rad(mems_log.SIGMA_DEG),
        arw=np.deg2rad(mems_log.ARW_DEG_PER_SQRT_S),
        epoch="2023-11-14T22:13:20.123Z",
        time_scale="UTC",
    )
    acm.write_acm(made, tmp_path / "a.acm", bias=BIAS, bias_sigma=BIAS_SIGMA)
    arguments = [str(tmp_path / name) for name in ("gyro.csv", "a.acm", "rec")]
    done = run_cli("import", "acm", *arguments, "--time", "time:iso", "--gyro", "gx,gy,gz:deg/s")
    assert done.exit_code == 0, done.stderr
    assert "its sign is not told" in " ".join(done.stdout.split())
    recording = gyrocal.load(tmp_path / "rec")
    assert np.rad2deg(recording.gyro.arw) == pytest.approx(mems_log.ARW_DEG_PER_SQRT_S, rel=1e-12)
    assert np.rad2deg(recording.attitudes.sigma[0]) == pytest.approx(mems_log.SIGMA_DEG, rel=1e-12)
    done = run_cli("calibrate", str(tmp_path / "rec"), "--json", str(tmp_path / "result.json"))
    assert done.exit_code == 0, done.stderr
    arguments = ["export", "acm", str(tmp_path / "rec"), str(tmp_path / "b.acm"), "--form", "xml"]
    done = run_cli(*arguments, "--calibration", str(tmp_path / "result.json"))
    assert done.exit_code == 0, done.stderr
    found = acm.read_acm(tmp_path / "b.acm")
    assert (np.abs(found.gyro_bias[0] - log.bias) < 4 * found.gyro_bias_sigma).all()
    for text in ("{}", "[" * 100_000):
        (tmp_path / "result.json").write_text(text)
        refused = run_cli(*arguments, "--calibration", str(tmp_path / "result.json"))
        assert (refused.exit_code, "not a result of gyrocal calibrate" in refused.stderr) == (2, True)
