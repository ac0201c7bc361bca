"""Columns by number, names with colons, and tables with two header rows."""

import bz2
import gzip
import lzma
import zipfile

import numpy as np
import pandas as pd
import pytest

from gyrocal.importing import validate_mapping
from gyrocal.importing.columns import resolve_columns
from gyrocal.importing.streams import read_csv, read_streams
from gyrocal.importing.table_layout import find_layout


@pytest.mark.parametrize("text", ["a,b\n1,2\n3,4\n", "a,b\nx,y\nu,v\n", "t,a\n2020-01-01T00:00:00,nan\n2,3\n", "a,b\n"])
def test_one_header_row_stays_one(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    assert find_layout(tmp_path / "a.csv").first_line == 1


ROWS = "0.5,1.25,3\n1.0,2.5,4\n"


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("// Rate: 50 Hz\n// v4\nt\tx\ty\n" + ROWS.replace(",", "\t"), ["t", "x", "y"]),
        ("# ground truth of the log\n# t x y\n" + ROWS.replace(",", " "), ["t", "x", "y"]),
        ("Take 1,3\n,Body,Body\n,1,2\n,Angle,Angle\nt,x,y\n" + ROWS, ["t", "Angle x", "Angle y"]),
        ("t,x,y\ns,deg/s,[rad/s]\n" + ROWS, ["t", "x", "y"]),
        ("t;x;y\n" + ROWS.replace(",", ";").replace(".", ","), ["t", "x", "y"]),
        ("Rate: 50\n" + ROWS, ["1", "2", "3"]),
        ("t|x|y\n" + ROWS.replace(",", "|"), ["t", "x", "y"]),
        ("#t; x; y\n" + ROWS.replace(",", "; "), ["t", "x", "y"]),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16-le"])
def test_header_is_found_in_the_file(tmp_path, text, names, encoding):
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode(encoding))
    frame = read_csv(path)
    assert list(frame.columns) == names
    np.testing.assert_array_equal(frame.to_numpy(), [[0.5, 1.25, 3.0], [1.0, 2.5, 4.0]])
    if names != ["t", "x", "y"]:
        assert any("header" in note for note in frame.attrs["notes"])


def write_zip(path, data, names=("a/t.csv",)):
    with zipfile.ZipFile(path, "w") as file:
        for name in names:
            file.writestr(name, data)


@pytest.mark.parametrize("name", ["t.csv", "t.csv.gz"])
@pytest.mark.parametrize(
    "write",
    [
        lambda path, data: path.write_bytes(gzip.compress(data)),
        lambda path, data: path.write_bytes(bz2.compress(data)),
        lambda path, data: path.write_bytes(lzma.compress(data)),
        write_zip,
        lambda path, data: path.write_bytes(data),
    ],
    ids=["gzip", "bz2", "xz", "zip", "plain"],
)
def test_a_compressed_table_is_read_whatever_its_name(tmp_path, name, write):
    write(tmp_path / name, b"t;x;y\r\n0.5;1.25;3\r\n1.0;2.5;4\r\n")
    np.testing.assert_array_equal(read_csv(tmp_path / name).to_numpy(), [[0.5, 1.25, 3], [1.0, 2.5, 4]])


@pytest.mark.parametrize("word", ["-nan(ind)", "1.#QNAN", "NaN", "-Infinity", ""])
@pytest.mark.parametrize("separator", [",", ";"])
def test_not_a_number_in_any_spelling_is_left_out_and_counted(tmp_path, word, separator):
    rows = [[0.01 * k, 0.5, 1.5, -0.25, 1.0, 0.0, 0.0, 0.0] for k in range(40)]
    rows[7][2] = rows[9][0] = rows[11][5] = rows[12][5] = word
    text = "\n".join([separator.join("tabcwxyz"), *(separator.join(map(str, row)) for row in rows), ""])
    (tmp_path / "a.csv").write_text(text.replace(".", ",") if separator == ";" and "#" not in word else text)
    frame = read_csv(tmp_path / "a.csv")
    found = read_streams(
        frame, frame, validate_mapping({"time": "t:s", "gyro": "a,b,c:deg/s", "quat": "w,x,y,z:body-to-world"}, "x")
    )
    said = " ".join(found.assumed)
    assert "2 gyro row(s) without numbers are left out, the first of them row 7" in said
    assert "3 attitude row(s) without numbers are left out, the first of them row 9" in said


@pytest.mark.parametrize("form", ["{name}", "#{place}", "{place}"])
def test_every_entry_with_columns_is_read_by_one_grammar(form):
    names = ["secs", "rest", "who", "n", "heat", "x", "w", "a", "b", "c", "s"]
    words = {name: form.format(name=name, place=place) for place, name in enumerate(names, 1)}
    entries = {
        "time": "{secs},{rest}:s+ns", "gyro": "-{x}:deg/s", "gyro_by": "{who}", "sample_number": "{n}", "temperature": "{heat}",
        "rows": "{who}:a:b", "attitude_time": "{secs},{rest}:s+ns", "quat": "{w},{a},{b},{c}:body-to-world:scalar-first",
        "attitude_by": "{who}", "sigma_deg": "{s}",
    }  # fmt: skip
    frame = pd.DataFrame(np.zeros((2, len(names))), columns=names)
    mapping = validate_mapping({key: text.format(**words) for key, text in entries.items()}, "x")
    found = resolve_columns(frame, frame, mapping)[2]
    assert {key: getattr(found, key) for key in entries} == {
        key: text.format(**dict(zip(names, names, strict=True))) for key, text in entries.items()
    }
    assert mapping.model_copy(update={"gyros": "#1, 3,b"}).choose_gyros(["a", "-b", "c"]) == [0, 2, 1]
