"""CCSDS AEM against another implementation, EuRoC folders and Kalibr's imu.yaml; the page's examples."""

import re
from dataclasses import replace
from datetime import datetime

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import aem, euroc, kalibr
from studies.validation import mems_log
from tests.builders import piecewise_recording

RECORDING = replace(
    piecewise_recording(series_s=100.0), epoch="2020-08-16T12:02:08.250Z", time_scale="UTC", title="a craft <&>"
)


@pytest.fixture(params=["kvn", "xml"])
def message(tmp_path, request):
    path = tmp_path / "out.aem"
    created = datetime(2026, 1, 2, 3, 4, 5)
    aem.write_aem(RECORDING, path, object_name="CRAFT", object_id="2020-001A", created=created, form=request.param)
    return path


def test_what_is_written_is_read(message):
    found = aem.read_aem(message)
    assert found.title == "CRAFT"
    assert found.frames == ("ICRF", "SC_BODY_1")
    np.testing.assert_allclose(found.q, RECORDING.attitudes.quaternions, rtol=0, atol=4e-16)
    since = found.clock.since(int(found.clock.whole[0])) - found.clock.part[0]
    np.testing.assert_allclose(since, RECORDING.attitudes.t_s - RECORDING.attitudes.t_s[0], atol=2e-9)
    assert re.search(r"CREATION_DATE( = |>)2026-01-02T03:04:05", message.read_text())


def test_another_implementation_reads_what_is_written_and_writes_what_is_read(message, tmp_path):
    other = pytest.importorskip("ccsds_ndm")
    theirs = other.Aem.from_file(str(message))
    theirs.validate()
    rows = np.concatenate([np.asarray(segment.data.attitude_states_numpy)[:, :4] for segment in theirs.segments])
    np.testing.assert_allclose(rows, RECORDING.attitudes.quaternions, rtol=0, atol=1e-12)
    first = theirs.segments[0]
    assert str(first.data.attitude_states_epochs[0]).startswith("2020-08-16T12:02:08.25")
    assert first.metadata.ref_frame_b == "SC_BODY_1"
    for form in ("kvn", "xml"):
        theirs.to_file(str(tmp_path / "again.aem"), format=form)
        again = aem.read_aem(tmp_path / "again.aem")
        np.testing.assert_allclose(again.q, RECORDING.attitudes.quaternions, rtol=0, atol=1e-12)
        np.testing.assert_allclose(again.clock.since(0), aem.read_aem(message).clock.since(0), rtol=0, atol=1e-6)


def hand_made(tmp_path, frames=("EME2000", "SC_BODY_1"), system="UTC", first="CCSDS_AEM_VERS = 2.0", kind="QUATERNION", q=None):
    half = np.sqrt(0.5)
    text = f"""{first}
CREATION_DATE = 2020-01-01T00:00:00
ORIGINATOR = HAND
META_START
COMMENT by hand
OBJECT_NAME = ONE
OBJECT_ID = 2020-001A
REF_FRAME_A = {frames[0]}
REF_FRAME_B = {frames[1]}
TIME_SYSTEM = {system}
START_TIME = 2020-08-16T12:02:09.25
STOP_TIME = 2020-229T12:02:10
ATTITUDE_TYPE = {kind}
META_STOP
DATA_START
2020-08-16T12:02:09.25 {q or f"0 0 {half} {half}"}
2020-229T12:02:10 0.0 0.0 0.0 1.0 0.1 0.2 0.3
DATA_STOP
"""
    path = tmp_path / "hand.aem"
    path.write_text(text)
    return path


def test_a_quarter_turn_by_hand(tmp_path):
    # Frame B is frame A turned by +90 deg about z: A's x axis has the components (0, −1, 0) in B.
    found = aem.read_aem(hand_made(tmp_path))
    A = attitude.matrix_from_quaternion(found.q)
    np.testing.assert_allclose(A[0] @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    assert found.clock.since(int(found.clock.whole[0])).tolist() == [0.25, 1.0]
    turned = aem.read_aem(hand_made(tmp_path, ("SC_BODY_1", "EME2000")))
    np.testing.assert_allclose(attitude.matrix_from_quaternion(turned.q), A.transpose(0, 2, 1), atol=1e-15)
    assert turned.frames == ("EME2000", "SC_BODY_1")


def test_xml_by_hand_in_any_order_of_elements(tmp_path):
    # Other writers put the scalar part first; the elements have names.
    half = np.sqrt(0.5)
    path = tmp_path / "hand.xml"
    text = f"""<?xml version="1.0"?>
<n:aem xmlns:n="urn:x" id="CCSDS_AEM_VERS" version="2.0"><header><ORIGINATOR>HAND</ORIGINATOR></header><body><segment>
<metadata><OBJECT_NAME>ONE</OBJECT_NAME><REF_FRAME_A>EME2000</REF_FRAME_A><REF_FRAME_B>SC_BODY_1</REF_FRAME_B>
<TIME_SYSTEM>UTC</TIME_SYSTEM><ATTITUDE_TYPE>QUATERNION/DERIVATIVE</ATTITUDE_TYPE></metadata><data><COMMENT>x</COMMENT>
<attitudeState><quaternionDerivative><EPOCH>2020-229T12:02:10</EPOCH><quaternion><QC>{half}</QC><Q1>0</Q1><Q2>0</Q2><Q3>{half}</Q3>
</quaternion><quaternionDot><QC_DOT>0</QC_DOT><Q1_DOT>9</Q1_DOT></quaternionDot></quaternionDerivative></attitudeState>
</data></segment></body></n:aem>"""
    path.write_text(text)
    found = aem.read_aem(path)
    np.testing.assert_allclose(attitude.matrix_from_quaternion(found.q)[0] @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    assert (found.title, found.clock.whole.tolist()) == ("ONE", [1597579330])
    for old, new, words in (
        ('version="2.0"', 'version="1.0"', "version 1.0; only 2.0"),
        ("</segment>", "", "not XML"),
        ("n:aem", "n:oem", "not an AEM: its XML begins with <oem>"),
        ("<Q2>0</Q2>", "", "attitude 1: four numbers"),
        ("<Q2>0</Q2>", "<Q2/>", "could not convert"),
        ("</data>", "<attitudeState><spin><EPOCH>2020-229T12:02:10</EPOCH></spin></attitudeState></data>", "attitude 2: four"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=words):
            aem.read_aem(path)


@pytest.mark.parametrize(("system", "behind"), [("UTC", 18), ("GPS", 0), ("TAI", 19)])
def test_time_systems(tmp_path, system, behind):
    found = aem.read_aem(hand_made(tmp_path, system=system))
    second = 1597579329  # of unix time: 2020-08-16T12:02:09 UTC
    if system == "UTC":
        assert found.clock.whole[0] == second
    else:
        utc = gyrocal.importing.units.to_utc(found.clock)
        assert utc.whole[0] == second - 18 + (0 if system == "GPS" else -behind)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"first": "CCSDS_AEM_VERS = 1.0"}, "version 1.0; only 2.0"),
        ({"first": "CCSDS_OEM_VERS = 2.0"}, "not an AEM"),
        ({"frames": ("EME2000", "ICRF")}, "one must be of a spacecraft"),
        ({"system": "TDB"}, "time system TDB"),
        ({"kind": "EULER_ANGLE"}, "attitude type EULER_ANGLE"),
        ({"q": "0 0 0 0.9"}, "attitude 1 has norm 0.9"),
        ({"q": "0 0 0.708 0.708"}, "attitude 1 has norm 1.001"),
        ({"q": "0 0 x 1"}, "line 16"),
        ({"q": "0 0 1"}, "line 16: four numbers"),
        ({"q": "0 0 nan 1"}, "attitude 1 has norm nan"),
        ({"q": "0 0 0 1\nDATA_STOP\nMETA_STOP"}, "META_STOP ends no block"),
        ({"q": "0 0 0 1\nEXTRA_START"}, "DATA_STOP ends no block"),
    ],
)
def test_what_an_aem_lacks_is_said(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        aem.read_aem(hand_made(tmp_path, **changes))


def test_a_recording_without_a_date_is_not_written(tmp_path):
    with pytest.raises(InputError, match="needs dates in UTC or GPS"):
        aem.write_aem(replace(RECORDING, time_scale="seconds"), tmp_path / "x.aem")


@pytest.fixture(scope="module")
def log():
    return mems_log.log(np.random.default_rng(11), seconds=60.0)


def calibrated(folder, log):
    result = gyrocal.calibrate(gyrocal.load(folder))
    error = result.parameters.vector - np.concatenate([log.G.ravel(), log.bias])
    return np.abs(error / result.sigma).max()


def test_gyro_and_aem_become_a_recording_and_the_way_back(run_cli, log, tmp_path):
    g = log.gyro
    g = g.assign(time=pd.to_datetime(g["timestamp_ms"], unit="ms").dt.strftime("%Y-%m-%dT%H:%M:%S.%f"))
    g.to_csv(tmp_path / "gyro.csv", index=False)
    q = np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1)
    t = (log.attitude["timestamp_ms"] - mems_log.UNIX_MS).to_numpy() / 1000
    source = gyrocal.Recording.from_arrays(
        t, np.zeros((t.size, 3)), t, q, sigma=1e-3, arw=1e-6, epoch="2023-11-14T22:13:20.123Z", time_scale="UTC"
    )
    aem.write_aem(source, tmp_path / "a.aem")
    options = ["--time", "time:iso", "--gyro", "gx,gy,gz:deg/s"]
    done = run_cli("import", "aem", str(tmp_path / "gyro.csv"), str(tmp_path / "a.aem"), str(tmp_path / "rec"), *options)
    assert done.exit_code == 0, done.stderr
    assert calibrated(tmp_path / "rec", log) < 4
    back = run_cli("export", "aem", str(tmp_path / "rec"), str(tmp_path / "b.aem"), "--object", "CRAFT")
    assert back.exit_code == 0, back.stderr
    assert aem.read_aem(tmp_path / "b.aem").title == "CRAFT"


def euroc_folder(root, log, turn=None, reference="vicon0"):
    """A folder of the EuRoC form; the reference sensor is turned against the IMU."""
    (root / "mav0" / "imu0").mkdir(parents=True)
    (root / "mav0" / reference).mkdir()
    gyro = pd.DataFrame({"#timestamp [ns]": log.gyro["timestamp_ms"] * 1_000_000})
    for axis in "xyz":
        gyro[f"w_RS_S_{axis} [rad s^-1]"] = np.deg2rad(log.gyro[f"g{axis}"])
    gyro.to_csv(root / "mav0" / "imu0" / "data.csv", index=False)
    q = Rotation.from_quat(np.roll(log.attitude[["qw", "qx", "qy", "qz"]].to_numpy(), -1, axis=1))
    q = np.roll((q if turn is None else q * turn).as_quat(), 1, axis=1)
    table = pd.DataFrame({"#timestamp [ns]": log.attitude["timestamp_ms"] * 1_000_000, " p_RS_R_x [m]": 0.0})
    for k, element in enumerate("wxyz"):
        table[f" q_RS_{element} []"] = q[:, k]
    table.to_csv(root / "mav0" / reference / "data.csv", index=False)
    density = np.deg2rad(mems_log.ARW_DEG_PER_SQRT_S)
    sheet = f"#Default imu sensor yaml file\nsensor_type: imu\nrate_hz: 100\ngyroscope_noise_density: {density}\n"
    (root / "mav0" / "imu0" / "sensor.yaml").write_text(sheet)
    if turn is not None:
        T = np.eye(4)
        T[:3, :3] = turn.as_matrix()  # the reference sensor's axes to the body's, which are the IMU's
        data = ", ".join(f"{value:.15g}" for value in T.ravel())
        (root / "mav0" / reference / "sensor.yaml").write_text(f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n")
    return root


@pytest.mark.parametrize("turn", [None, Rotation.from_rotvec([0.3, -1.2, 0.5])])
def test_a_euroc_folder_is_calibrated(run_cli, log, tmp_path, turn):
    root = euroc_folder(tmp_path / "V1_01_easy", log, turn)
    done = run_cli("import", "euroc", str(root), str(tmp_path / "rec"))
    assert done.exit_code == 0, done.stderr
    recording = gyrocal.load(tmp_path / "rec")
    assert np.rad2deg(recording.gyro.arw) == pytest.approx(mems_log.ARW_DEG_PER_SQRT_S, rel=1e-12)
    assert recording.title == "EuRoC form, V1_01_easy"
    assert calibrated(tmp_path / "rec", log) < 4


def test_an_estimated_reference_is_said_to_be_one(log, tmp_path):
    made = euroc.import_euroc(euroc_folder(tmp_path / "a", log, reference="state_groundtruth_estimate0"), stated_noise=False)
    assert any("not independent" in text for text in made.assumed)
    assert made.mapping.arw_deg_per_sqrt_s is None


def test_kalibr_s_imu_yaml(tmp_path):
    path = tmp_path / "imu.yaml"
    for text in (
        "gyroscope_noise_density: 0.001\nupdate_rate: 200.0\n",
        "imu0:\n  gyroscope_noise_density: 1.0e-3\n  rostopic: /imu0\n",
        "%YAML:1.0\ngyroscope_noise_density: 0.001\n",
        "gyroscope_noise_density: 1e-3\n",
    ):
        path.write_text(text)
        assert np.deg2rad(kalibr.noise_density(path)) == pytest.approx(1e-3)
    for text in ("update_rate: 200.0\n", "gyroscope_noise_density: fast\n", "- 1\n", "a: [\n", "gyroscope_noise_density: -1\n"):
        path.write_text(text)
        with pytest.raises(InputError, match=r"imu\.yaml: "):
            kalibr.noise_density(path)


def test_a_folder_that_is_not_of_the_form(tmp_path):
    with pytest.raises(InputError, match="not a folder of the EuRoC form"):
        euroc.import_euroc(tmp_path)
