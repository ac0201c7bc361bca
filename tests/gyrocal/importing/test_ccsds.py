"""CCSDS Attitude Ephemeris Messages, by another implementation and by hand."""

import numpy as np
import pytest

import gyrocal
from gyrocal import InputError, attitude
from gyrocal.importing import aem
from gyrocal.importing.units import convert_to_utc
from tests.gyrocal.importing import mems, mems_log

HALF = np.sqrt(0.5)
QUARTER = f"0 0 {HALF} {HALF}"  # frame B is frame A turned by +90 deg about z: A's x axis has the components (0, −1, 0) in B


AEM = mems.AEM.format(rows=f"2020-08-16T12:02:09.25 {QUARTER}\n2020-229T12:02:10 0.0 0.0 0.0 1.0 0.1 0.2 0.3")
XML = f"""<?xml version="1.0"?>
<n:aem xmlns:n="urn:x" id="CCSDS_AEM_VERS" version="2.0"><header><ORIGINATOR>HAND</ORIGINATOR></header><body><segment>
<metadata><OBJECT_NAME>ONE</OBJECT_NAME><REF_FRAME_A>EME2000</REF_FRAME_A><REF_FRAME_B>SC_BODY_1</REF_FRAME_B>
<TIME_SYSTEM>UTC</TIME_SYSTEM><ATTITUDE_TYPE>QUATERNION/DERIVATIVE</ATTITUDE_TYPE></metadata><data><COMMENT>x</COMMENT>
<attitudeState><quaternionDerivative><EPOCH>2020-229T12:02:10</EPOCH><quaternion><QC>{HALF}</QC><Q1>0</Q1><Q2>0</Q2><Q3>{HALF}</Q3>
</quaternion><quaternionDot><QC_DOT>0</QC_DOT><Q1_DOT>9</Q1_DOT></quaternionDot></quaternionDerivative></attitudeState>
</data></segment></body></n:aem>"""


def read(tmp_path, text, *changes):
    """One of the messages above after some replacements, each of which must apply."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "hand.txt"
    path.write_text(text)
    return aem.read_aem(path)


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
def test_version_1_says_direction_and_order(tmp_path, direction, place):
    turned = -HALF if direction == "B2A" else HALF
    numbers = f"{HALF} 0 0 {turned}" if place == "FIRST" else f"0 0 {turned} {HALF}"
    other = "1.0 0.0 0.0 0.0" if place == "FIRST" else "0.0 0.0 0.0 1.0"
    changes = (*version_1(direction, place), (QUARTER, numbers), ("0.0 0.0 0.0 1.0", other))
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


@pytest.mark.parametrize("frame", ["LVLH_INERTIAL", "ITRF-97", "MY_OWN"])
def test_frames_that_turn_are_refused(tmp_path, frame):
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
        ([("= UTC", "= TDB")], "time system TDB"),
        ([("VERS = 2.0", "VERS = 1.0")], "the metadata have no ATTITUDE_DIR, QUATERNION_TYPE"),
        ([(QUARTER, "0 0 1")], "line 16: 4 numbers"),
        ([(QUARTER, "0 0 0 1\nDATA_STOP\nMETA_STOP")], "META_STOP ends no block"),
    ],
)
def test_what_an_aem_lacks_is_said(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        read(tmp_path, AEM, *changes)


def test_a_gyro_and_a_message_of_another_implementation_are_calibrated(run_cli, tmp_path):
    other = pytest.importorskip("ccsds_ndm")
    log = mems_log.log(np.random.default_rng(12), seconds=60.0)
    quaternions = mems.write_aem(log, tmp_path / "mine.aem")
    other.Aem.from_file(str(tmp_path / "mine.aem")).to_file(str(tmp_path / "theirs"), format="xml")
    found = aem.read_aem(tmp_path / "theirs")
    np.testing.assert_allclose(found.q, quaternions, rtol=0, atol=1e-12)
    gyro, *files = mems.write_gyro(log, tmp_path / "gyro.csv"), str(tmp_path / "theirs"), str(tmp_path / "rec")
    done = run_cli("import", "aem", gyro, *files, *mems.OPTIONS)
    assert done.exit_code == 0, done.stderr
    assert mems.largest_error(gyrocal.load(tmp_path / "rec"), log) < 4
