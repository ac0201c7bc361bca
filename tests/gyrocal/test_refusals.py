"""Input that no other test reaches is refused in one line that says what to do."""

import pytest

import gyrocal
from gyrocal import GyroParameters, InputError
from gyrocal.importing import validate_mapping
from tests.builders import piecewise_recording

COLUMNS = {"time": "t:s", "gyro": "x,y,z:deg/s", "quat": "a,b,c,d:scalar-last:body-to-inertial"}
PLAN = ((((0.001, 0.0, 0.0), 60.0),),)


@pytest.mark.parametrize(
    ("entries", "gyros", "words"),
    [
        ({}, 4, "4 columns; with other than three give the gyros' axes"),
        ({"axes": "tetrahedron"}, 5, "axes: 4 rows, but 5 gyros"),
        ({"axes": [[1, 0, 0], [0, 1, 0], [0, 0, 0]]}, 3, "axes: a row is zero"),
        ({"G": [[1, 0], [0, 1], [0, 0]]}, 3, "G: three rows of 3 numbers"),
        ({"G": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "axes": "tetrahedron"}, 3, "give axes or G, not both"),
    ],
)
def test_axes_that_do_not_fit_the_gyros(entries, gyros, words):
    with pytest.raises(InputError, match=words):
        validate_mapping(COLUMNS | entries, "options").directions(gyros)


@pytest.mark.parametrize(
    ("G", "bias", "words"), [([[1.0]], [0.0] * 3, "G must be 3×3"), ([[float("nan")] * 3] * 3, [0.0] * 3, "must be finite")]
)
def test_parameters_of_a_wrong_shape_or_without_a_value(G, bias, words):
    with pytest.raises(InputError, match=words):
        GyroParameters(G, bias)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[gyro]", '[gyro]\nnames = ["g1", "g2", "g3"]', "names of gyros, and gyros of an interval, need format = 2"),
        (
            "[gyro]",
            "[orbit]\nperiod_s = 5500\naltitude_km = 350\ninclination_deg = 35\nraan_deg = 1\n\n[gyro]",
            "raan_deg .* need format = 2",
        ),
        ("[[interval]]", "[[other]]", "interval"),
    ],
)
def test_a_header_that_contradicts_itself(tmp_path, old, new, words):
    gyrocal.save(piecewise_recording(PLAN), tmp_path / "rec")
    header = tmp_path / "rec" / "recording.toml"
    text = header.read_text(encoding="utf-8")
    assert old in text
    header.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        gyrocal.load(tmp_path / "rec")
