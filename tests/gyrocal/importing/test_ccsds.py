"""CCSDS attitude messages, AEM and ACM, against another implementation and by hand."""

import re
from dataclasses import replace

import numpy as np
import pytest

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import acm, aem
from gyrocal.importing.units import convert_to_utc
from studies.validation import mems_log
from tests.builders import piecewise_recording
from tests.gyrocal.importing import mems

RECORDING = replace(
    piecewise_recording(series_s=100.0, arw=2e-6), epoch="2020-08-16T12:02:08.250Z", time_scale="UTC", title="a craft <&>"
)
BIAS, BIAS_SIGMA = np.array([1e-6, -2e-6, 3e-6]), np.array([1e-8, 2e-8, 3e-8])
HALF = np.sqrt(0.5)
QUARTER = f"0 0 {HALF} {HALF}"  # frame B is frame A turned by +90 deg about z: A's x axis has the components (0, −1, 0) in B


def check_attitudes(found):
    np.testing.assert_allclose(found.q, RECORDING.attitudes.quaternions, rtol=0, atol=1e-12)
    assert (found.title, found.frames) == ("CRAFT", ("ICRF", "SC_BODY_1"))
    assert (found.clock.scale, found.clock.whole[0], found.clock.part[0]) == ("UTC", 1597579328, 0.25)
    np.testing.assert_allclose(found.clock.subtract(1597579328) - 0.25, RECORDING.attitudes.t_s, rtol=0, atol=1e-6)


def check_message(found):
    check_attitudes(found.attitudes)
    np.testing.assert_allclose(found.sigma, np.sqrt(np.mean(np.square(RECORDING.attitudes.sigma), axis=0)), rtol=1e-12)
    np.testing.assert_allclose(found.gyro_bias, np.tile(BIAS, (len(found.attitudes.q), 1)), rtol=1e-12)
    np.testing.assert_allclose(found.gyro_bias_sigma, BIAS_SIGMA, rtol=1e-12)
    assert found.arw == pytest.approx(2e-6, rel=1e-12)


def write_aem(path, form):
    aem.write_aem(RECORDING, path, object_name="CRAFT", object_id="2020-001A", form=form)
    return path


def write_acm(path, form):
    acm.write_acm(RECORDING, path, bias=BIAS, bias_sigma=BIAS_SIGMA, object_name="CRAFT", form=form)
    return path


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_what_is_written_is_read(tmp_path, form):
    message = write_aem(tmp_path / "out.aem", form)
    found = aem.read_aem(message)
    check_attitudes(found)
    np.testing.assert_allclose(found.q, RECORDING.attitudes.quaternions, rtol=0, atol=4e-16)
    np.testing.assert_allclose(found.clock.subtract(1597579328) - 0.25, RECORDING.attitudes.t_s, rtol=0, atol=2e-9)
    assert re.search(r"CREATION_DATE( = |>)20\d\d-\d\d-\d\dT", message.read_text())
    found = acm.read_acm(write_acm(tmp_path / "out.acm", form))
    check_message(found)
    np.testing.assert_allclose(found.attitudes.q, RECORDING.attitudes.quaternions, rtol=0, atol=1e-15)


@pytest.mark.parametrize("form", ["kvn", "xml"])
def test_another_implementation_reads_what_is_written_and_writes_what_is_read(tmp_path, form):
    other = pytest.importorskip("ccsds_ndm")
    theirs = other.Aem.from_file(str(write_aem(tmp_path / "out.aem", form)))
    theirs.validate()
    rows = np.concatenate([np.asarray(segment.data.attitude_states_numpy)[:, :4] for segment in theirs.segments])
    np.testing.assert_allclose(rows, RECORDING.attitudes.quaternions, rtol=0, atol=1e-12)
    assert str(theirs.segments[0].data.attitude_states_epochs[0]).startswith("2020-08-16T12:02:08.25")
    assert theirs.segments[0].metadata.ref_frame_b == "SC_BODY_1"
    message = other.Acm.from_file(str(write_acm(tmp_path / "out.acm", form)))
    message.validate()
    data = message.segment.data
    states = np.concatenate([np.array(one.att_lines) for one in data.att])
    np.testing.assert_allclose(states[:, 1:5], RECORDING.attitudes.quaternions, rtol=0, atol=1e-12)
    np.testing.assert_allclose(states[:, 5:], np.tile(np.rad2deg(BIAS), (len(states), 1)), rtol=1e-12)
    variances = np.concatenate([np.array(one.cov_lines) for one in data.cov])
    expected = np.square(np.rad2deg(np.column_stack([RECORDING.attitudes.sigma, np.tile(BIAS_SIGMA, (len(states), 1))])))
    np.testing.assert_allclose(variances[:, 1:], expected, rtol=1e-12)
    assert data.ad.sigma_v == pytest.approx(np.rad2deg(2e-6), rel=1e-12)
    assert (data.cov[0].cov_type, data.att[0].rate_type) == ("ANGLE_GYROBIAS", "GYRO_BIAS")
    for again in ("kvn", "xml"):
        theirs.to_file(str(tmp_path / "again.aem"), format=again)
        check_attitudes(aem.read_aem(tmp_path / "again.aem"))
        message.to_file(str(tmp_path / "again.acm"), format=again)
        check_message(acm.read_acm(tmp_path / "again.acm"))


AEM = f"""CCSDS_AEM_VERS = 2.0
CREATION_DATE = 2020-01-01T00:00:00
ORIGINATOR = HAND
META_START
COMMENT by hand
OBJECT_NAME = ONE
OBJECT_ID = 2020-001A
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
TIME_SYSTEM = UTC
START_TIME = 2020-08-16T12:02:09.25
STOP_TIME = 2020-229T12:02:10
ATTITUDE_TYPE = QUATERNION
META_STOP
DATA_START
2020-08-16T12:02:09.25 {QUARTER}
2020-229T12:02:10 0.0 0.0 0.0 1.0 0.1 0.2 0.3
DATA_STOP
"""
XML = f"""<?xml version="1.0"?>
<n:aem xmlns:n="urn:x" id="CCSDS_AEM_VERS" version="2.0"><header><ORIGINATOR>HAND</ORIGINATOR></header><body><segment>
<metadata><OBJECT_NAME>ONE</OBJECT_NAME><REF_FRAME_A>EME2000</REF_FRAME_A><REF_FRAME_B>SC_BODY_1</REF_FRAME_B>
<TIME_SYSTEM>UTC</TIME_SYSTEM><ATTITUDE_TYPE>QUATERNION/DERIVATIVE</ATTITUDE_TYPE></metadata><data><COMMENT>x</COMMENT>
<attitudeState><quaternionDerivative><EPOCH>2020-229T12:02:10</EPOCH><quaternion><QC>{HALF}</QC><Q1>0</Q1><Q2>0</Q2><Q3>{HALF}</Q3>
</quaternion><quaternionDot><QC_DOT>0</QC_DOT><Q1_DOT>9</Q1_DOT></quaternionDot></quaternionDerivative></attitudeState>
</data></segment></body></n:aem>"""
ACM = """CCSDS_ACM_VERS = 2.0
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


def read(tmp_path, text, *changes):
    """A text of one of the messages above after some replacements, each of which must apply."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "hand.txt"
    path.write_text(text)
    return acm.read_acm(path) if text.startswith("CCSDS_ACM") else aem.read_aem(path)


def x_axis(found):
    """Components of the inertial x axis in the body's axes at the first attitude."""
    return attitude.matrix_from_quaternion(found.q)[0] @ [1, 0, 0]


def version_1(direction="A2B", place="LAST"):
    return (
        ("VERS = 2.0", "VERS = 1.0"),
        ("TIME_SYSTEM", f"ATTITUDE_DIR = {direction}\nQUATERNION_TYPE = {place}\nTIME_SYSTEM"),
    )


def test_a_quarter_turn_by_hand(tmp_path):
    found = read(tmp_path, AEM)
    np.testing.assert_allclose(x_axis(found), [0, -1, 0], atol=1e-15)
    assert found.clock.subtract(int(found.clock.whole[0])).tolist() == [0.25, 1.0]
    turned = read(tmp_path, AEM, ("_A = EME2000", "_A = SC_BODY_1"), ("_B = SC_BODY_1", "_B = EME2000"))
    np.testing.assert_allclose(x_axis(turned), [0, 1, 0], atol=1e-15)
    assert turned.frames == ("EME2000", "SC_BODY_1")


@pytest.mark.parametrize("place", ["FIRST", "LAST"])
@pytest.mark.parametrize("direction", ["A2B", "B2A"])
@pytest.mark.parametrize("kind", ["QUATERNION", "QUATERNION/RATE"])
def test_version_1_says_direction_and_order(tmp_path, direction, place, kind):
    turned = -HALF if direction == "B2A" else HALF
    numbers = f"{HALF} 0 0 {turned}" if place == "FIRST" else f"0 0 {turned} {HALF}"
    other = "1.0 0.0 0.0 0.0" if place == "FIRST" else "0.0 0.0 0.0 1.0"
    changes = (*version_1(direction, place), (QUARTER, numbers), ("0.0 0.0 0.0 1.0", other), ("= QUATERNION\n", f"= {kind}\n"))
    found = read(tmp_path, AEM, *changes)
    np.testing.assert_allclose(x_axis(found), [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(found.q[1], [0, 0, 0, 1], atol=1e-15)
    # With the frames exchanged it is the inverse.
    found = read(tmp_path, AEM, *changes, ("_A = EME2000", "_A = SC_BODY_1"), ("_B = SC_BODY_1", "_B = EME2000"))
    np.testing.assert_allclose(x_axis(found), [0, 1, 0], atol=1e-15)


@pytest.mark.parametrize("place", ["FIRST", "LAST"])
def test_elements_of_xml_have_names_whatever_their_order(tmp_path, place):
    found = read(tmp_path, XML)
    np.testing.assert_allclose(x_axis(found), [0, -1, 0], atol=1e-15)
    assert (found.title, found.clock.whole.tolist()) == ("ONE", [1597579330])
    words = f"<ATTITUDE_DIR>A2B</ATTITUDE_DIR><QUATERNION_TYPE>{place}</QUATERNION_TYPE><TIME_SYSTEM>"
    older = read(tmp_path, XML, ('version="2.0"', 'version="1.0"'), ("<TIME_SYSTEM>", words))
    np.testing.assert_allclose(x_axis(older), [0, -1, 0], atol=1e-15)


@pytest.mark.parametrize("frame", ["ICRF", "ICRF3", "GCRF", "EME2000", "J2000", "TOD", "TOD_EARTH", "TEME", "mod"])
def test_inertial_frames_are_read(tmp_path, frame):
    assert read(tmp_path, AEM, ("EME2000", frame)).frames == (frame, "SC_BODY_1")
    assert read(tmp_path, ACM, ("J2000", frame)).attitudes.frames == (frame, "SC_BODY_1")


@pytest.mark.parametrize(
    "frame", ["LVLH", "LVLH_ROTATING", "LVLH_INERTIAL", "RTN", "ITRF", "ITRF-97", "ITRF2014", "GTOD", "TDR", "EFG", "MY_OWN"]
)
def test_frames_that_turn_are_refused(tmp_path, frame):
    for text, name in ((AEM, "EME2000"), (ACM, "J2000"), (XML, "EME2000")):
        with pytest.raises(InputError, match=f"the frame {frame} turns, or is not known"):
            read(tmp_path, text, (name, frame))
    with pytest.raises(InputError, match=f"the frame {frame} turns"):
        read(tmp_path, AEM, ("_A = EME2000", "_A = SC_BODY_1"), ("_B = SC_BODY_1", f"_B = {frame}"))


@pytest.mark.parametrize(("system", "behind"), [("UTC", 18), ("GPS", 0), ("TAI", 19)])
def test_time_systems(tmp_path, system, behind):
    found = read(tmp_path, AEM, ("= UTC", f"= {system}"))
    second = 1597579329  # of unix time: 2020-08-16T12:02:09 UTC
    assert convert_to_utc(found.clock).whole[0] == second - (0 if system == "UTC" else 18 + behind)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([("VERS = 2.0", "VERS = 3.0")], "version 3.0 is not read; read is 1.0 or 2.0"),
        ([("CCSDS_AEM", "CCSDS_OEM")], "not an AEM"),
        ([("SC_BODY_1", "ICRF")], "one must be of a spacecraft"),
        ([("= UTC", "= TDB")], "time system TDB"),
        ([("= QUATERNION", "= EULER_ANGLE")], "attitude type EULER_ANGLE"),
        ([("= QUATERNION", "= QUATERNION/RATE")], "attitude type QUATERNION/RATE"),
        ([("TIME_SYSTEM", "QUATERNION_TYPE = FIRST\nTIME_SYSTEM")], "QUATERNION_TYPE: no keyword of this version"),
        ([("TIME_SYSTEM", "ATTITUDE_DIR = B2A\nTIME_SYSTEM")], "ATTITUDE_DIR: no keyword of this version"),
        ([("TIME_SYSTEM", "RATE_FRAME = SC_BODY_1\nTIME_SYSTEM")], "RATE_FRAME: no keyword"),
        ([("VERS = 2.0", "VERS = 1.0")], "the metadata have no ATTITUDE_DIR, QUATERNION_TYPE"),
        ([*version_1(), ("TIME_SYSTEM", "ANGVEL_FRAME = SC_BODY_1\nTIME_SYSTEM")], "ANGVEL_FRAME: no keyword"),
        ([*version_1(), ("= QUATERNION", "= QUATERNION/ANGVEL")], "attitude type QUATERNION/ANGVEL"),
        (version_1("A-B"), "ATTITUDE_DIR is A-B, which is neither A2B nor B2A"),
        (version_1(place="1"), "QUATERNION_TYPE is 1, which is neither FIRST nor LAST"),
        ([(QUARTER, "0 0 0 0.9")], "attitude 1 has norm 0.9"),
        ([(QUARTER, "0 0 0.708 0.708")], "attitude 1 has norm 1.001"),
        ([(QUARTER, "0 0 x 1")], "line 16"),
        ([(QUARTER, "0 0 1")], "line 16: 4 numbers"),
        ([(QUARTER, "0 0 nan 1")], "line 16: 4 numbers"),
        ([(QUARTER, "0 0 0 1\nDATA_STOP\nMETA_STOP")], "META_STOP ends no block"),
        ([(QUARTER, "0 0 0 1\nEXTRA_START")], "DATA_STOP ends no block"),
    ],
)
def test_what_an_aem_lacks_is_said(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, AEM, *changes)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('version="2.0"', 'version="1.0"', "have no ATTITUDE_DIR, QUATERNION_TYPE"),
        ("</segment>", "", "not XML"),
        ("n:aem xmlns", "n:oem xmlns", "not XML"),
        ("<Q2>0</Q2>", "", "attitude 1: 4 numbers"),
        ("<Q2>0</Q2>", "<Q2/>", "could not convert"),
        ("</data>", "<attitudeState><spin><EPOCH>2020-229T12:02:10</EPOCH></spin></attitudeState></data>", "attitude 2: 4"),
    ],
)
def test_what_an_aem_in_xml_lacks_is_said(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, XML, (old, new))


def test_xml_of_another_message_is_refused(tmp_path):
    with pytest.raises(InputError, match="not an AEM: its XML begins with <oem>"):
        read(tmp_path, XML.replace("n:aem", "n:oem"))


def test_an_acm_by_hand(tmp_path):
    found = read(tmp_path, ACM)
    np.testing.assert_allclose(x_axis(found.attitudes), [0, -1, 0], atol=1e-15)
    # Variances are in deg².
    np.testing.assert_allclose(np.rad2deg(found.sigma), [np.sqrt(8e-6), 1e-3, 2e-3], rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(found.gyro_bias_sigma), [1e-4, 2e-4, 4e-4], rtol=1e-12)
    np.testing.assert_allclose(np.rad2deg(found.gyro_bias[1]), [1e-3, 0, -2e-3], rtol=1e-12)
    assert np.rad2deg(found.arw) == pytest.approx(2e-4, rel=1e-12)
    # TAI is 19 s ahead of GPS time, which was 18 s ahead of UTC: 12:02:47.25 TAI is 12:02:10.25 UTC.
    utc = convert_to_utc(found.attitudes.clock)
    assert (utc.whole.tolist(), utc.part.tolist()) == ([1597579330, 1597579331], [0.25, 0.5])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("VERS = 2.0", "VERS = 1.0", "ACM version 1.0 is not read; read is 2.0"),
        ("EPOCH_TZERO = 2020-08-16T12:02:46.5", "EPOCH_TZERO = noon", "EPOCH_TZERO: time data"),
        ("EPOCH_TZERO = 2020-08-16T12:02:46.5\n", "", "no EPOCH_TZERO"),
        ("ATT_TYPE = QUATERNION", "ATT_TYPE = DCM", "attitude type DCM is not read"),
        ("NUMBER_STATES", "QUATERNION_TYPE = FIRST\nNUMBER_STATES", "QUATERNION_TYPE: no keyword"),
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
    with pytest.raises(InputError, match=words):
        read(tmp_path, ACM, (old, new))


def test_what_cannot_be_written_is_said(tmp_path):
    with pytest.raises(InputError, match="needs dates in UTC or GPS"):
        aem.write_aem(replace(RECORDING, time_scale="seconds"), tmp_path / "x.aem")
    for given in ({"bias": BIAS}, {"bias": BIAS, "bias_sigma": [1e-8, 0.0, 1e-8]}):
        with pytest.raises(InputError, match="bias and bias_sigma"):
            acm.write_acm(RECORDING, tmp_path / "x.acm", **given)
    acm.write_acm(RECORDING, tmp_path / "x.acm")
    found = acm.read_acm(tmp_path / "x.acm")
    assert (found.gyro_bias, found.arw) == (None, None)
    np.testing.assert_allclose(found.sigma, RECORDING.attitudes.sigma[0], rtol=1e-12)


def test_a_gyro_and_a_message_are_calibrated_and_the_way_back(run_cli, tmp_path):
    log = mems_log.log(np.random.default_rng(12), seconds=60.0)
    sigma, arw = np.deg2rad(mems_log.REFERENCE_SIGMA_DEG), np.deg2rad(mems_log.MEMS_ARW_DEG_PER_SQRT_S)
    source, gyro = mems.references(log, sigma=sigma, arw=arw), mems.write_gyro(log, tmp_path / "gyro.csv")
    aem.write_aem(source, tmp_path / "a.aem")
    acm.write_acm(source, tmp_path / "a.acm", bias=BIAS, bias_sigma=BIAS_SIGMA)
    for form in ("aem", "acm"):
        done = run_cli("import", form, gyro, str(tmp_path / f"a.{form}"), str(tmp_path / form), *mems.OPTIONS)
        assert done.exit_code == 0, done.stderr
        assert mems.largest_error(gyrocal.load(tmp_path / form), log) < 4
    assert "its sign is not told" in " ".join(done.stdout.split())
    recording = gyrocal.load(tmp_path / "acm")
    assert recording.gyro.arw == pytest.approx(arw, rel=1e-12)
    assert np.rad2deg(recording.attitudes.sigma[0]) == pytest.approx(mems_log.REFERENCE_SIGMA_DEG, rel=1e-12)
    back = run_cli("export", "aem", str(tmp_path / "aem"), str(tmp_path / "b.aem"), "--object", "CRAFT")
    assert back.exit_code == 0, back.stderr
    assert aem.read_aem(tmp_path / "b.aem").title == "CRAFT"
    done = run_cli("calibrate", str(tmp_path / "acm"), "--json", str(tmp_path / "result.json"))
    assert done.exit_code == 0, done.stderr
    arguments = ["export", "acm", str(tmp_path / "acm"), str(tmp_path / "b.acm"), "--form", "xml"]
    done = run_cli(*arguments, "--calibration", str(tmp_path / "result.json"))
    assert done.exit_code == 0, done.stderr
    found = acm.read_acm(tmp_path / "b.acm")
    assert (np.abs(found.gyro_bias[0] - log.bias) < 4 * found.gyro_bias_sigma).all()
    for text in ("{}", "[" * 100_000):
        (tmp_path / "result.json").write_text(text)
        refused = run_cli(*arguments, "--calibration", str(tmp_path / "result.json"))
        assert (refused.exit_code, "not a result of gyrocal calibrate" in refused.stderr) == (2, True)
