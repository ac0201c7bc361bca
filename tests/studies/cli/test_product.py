"""The command gyrocal product: numbers against a calculation by hand, and faults of a template with their line."""

import hashlib
import json

import numpy as np
import pytest

from gyrocal import NAMES, save
from studies.report.product import build_product, read_default_template, render_product
from tests import ROOT
from tests.builders import piecewise_recording
from tests.docs.blocks import blocks


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A result, an old table with sigmas, and one without."""
    folder = tmp_path_factory.mktemp("product")
    save(piecewise_recording(series_s=100.0, arw=1e-7, rng=np.random.default_rng(1)), folder / "rec")
    return folder


@pytest.fixture
def result(folder, run_cli):
    path = folder / "result.json"
    if not path.exists():
        done = run_cli("calibrate", str(folder / "rec"), "--json", str(path), "--solve-for", "all,-b_z")
        assert done.exit_code == 0, done.stderr
    return path


def test_changes_are_those_by_hand(result):
    document = json.loads(result.read_text())
    old = {"G": np.eye(3).tolist(), "bias_deg_s": [1e-3, 0.0, 0.0]}
    sigmas = [1e-4] * 12
    plain, uncertain = build_product(document, old), build_product(document, old | {"sigma_nominal": sigmas})
    key = "sigma_with_remainder" if document["recommended"] == "with_remainder" else "sigma_nominal"
    for k, (one, two) in enumerate(zip(plain["rows"], uncertain["rows"], strict=True)):
        new = document["G"][k // 3][k % 3] if k < 9 else document["bias_deg_s"][k - 9]
        before = float(k in (0, 4, 8)) if k < 9 else (1e-3, 0.0, 0.0)[k - 9]
        sigma = document[key][k]
        assert (one["name"], one["unit"]) == (NAMES[k], "1" if k < 9 else "deg/s")
        assert one["kind"] == ("bias" if k >= 9 else "scale factor" if k in (0, 4, 8) else "misalignment")
        assert (one["new"], one["old"], one["change"], one["sigma"]) == (new, before, new - before, sigma)
        assert two["change_in_sigma"] == pytest.approx((new - before) / np.sqrt(sigma**2 + 1e-8), rel=1e-12)
        if NAMES[k] == "b_z":  # held
            assert one["change_in_sigma"] is None
            assert not one["calibrated"]
        else:
            assert one["change_in_sigma"] == pytest.approx((new - before) / sigma, rel=1e-12)


def test_the_package_s_template_has_table_span_and_hashes(run_cli, folder, result):
    out = folder / "product.txt"
    done = run_cli("product", str(result), "--out", str(out))
    assert done.exit_code == 0, done.stderr
    text, document = out.read_text(), json.loads(result.read_text())
    (row,) = [line.split() for line in text.splitlines() if line.startswith("G_yz")]
    assert [float(number) for number in row[3:6]] == pytest.approx(
        [0.0, document["G"][1][2], document["G"][1][2]], abs=1e-9
    )  # from the identity
    # The epoch is 2000-01-01; the plan has 10 920 s of motion and five gaps of 300 s.
    assert "data from 2000-01-01T00:00:00.000 until 2000-01-01T03:27:00.000 (UTC)" in text
    assert f"new: result.json, SHA-256 {hashlib.sha256(result.read_bytes()).hexdigest()}" in text
    assert f"gyrocal {document['version']}, commit {document['provenance']['commit'] or 'unknown'}" in text
    assert "resampling=average" in text
    assert run_cli("product", str(result)).stdout == text
    beside = run_cli("product", str(result), "--old", str(result)).stdout
    assert f"old: result.json, SHA-256 {hashlib.sha256(result.read_bytes()).hexdigest()}" in beside
    assert "+0.0" in beside


@pytest.mark.parametrize(
    ("template", "line", "words"),
    [
        ("one\ntwo\n{{ nothing }}", 3, "'nothing' is undefined"),
        ("one\n{% for row in rows %}\n{{ row.nothing }}\n{% endfor %}", 3, "has no attribute 'nothing'"),
        ("one\n{% if %}", 2, "Expected an expression"),
        ("\n\n\n{{ 1 / 0 }}", 4, "division by zero"),
        ("{{ rows|nothing }}", 1, "No filter named 'nothing'"),
        ("\n{{ rows.__class__ }}", 2, "unsafe"),
        ("\n{% include 'other.txt' %}", 2, "no loader"),
    ],
)
def test_a_fault_of_a_template_has_its_line(run_cli, result, tmp_path, template, line, words):
    (tmp_path / "mine.txt").write_text(template)
    done = run_cli("product", str(result), "--template", str(tmp_path / "mine.txt"), "--out", str(tmp_path / "out.txt"))
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    assert f"mine.txt, line {line}: " in done.stderr
    assert words in done.stderr
    assert not (tmp_path / "out.txt").exists()


def test_other_files_are_refused_in_one_line(run_cli, result, tmp_path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    (tmp_path / "empty.json").write_text("[]")
    (tmp_path / "short.json").write_text('{"G": [[1, 0], [0, 1]], "bias_deg_s": [0, 0, 0]}')
    for given, words in {
        ("--template", "binary"): "not UTF-8",
        ("--template", "nothing"): "No such file",
        ("--template", "."): "not a file",
        ("--old", "empty.json"): "not a table with G and bias_deg_s",
        ("--old", "short.json"): "3×3, 3 and 12 finite numbers",
    }.items():
        done = run_cli("product", str(result), given[0], str(tmp_path / given[1]))
        assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.output
        assert words in done.stderr
    assert run_cli("product", str(tmp_path / "short.json")).exit_code == 2


def test_the_page_lists_every_variable_and_its_example_is_filled(run_cli, result, tmp_path):
    values = build_product(json.loads(result.read_text()), None)
    page = (ROOT / "docs" / "product.md").read_text()
    listed = [name for name in values if name != "rows"] + [f"row.{name}" for name in values["rows"][0]]
    assert [name for name in listed if f"`{name}`" not in page and name != "provenance"] == []
    (example,) = [one for one in blocks("docs/product.md", "") if "LOAD" in one]
    (tmp_path / "mine.txt").write_text(example)
    filled = run_cli("product", str(result), "--template", str(tmp_path / "mine.txt")).stdout
    assert filled.count("LOAD ") == 11
    assert f"LOAD G_XX {values['rows'][0]['new']:.9f}  ; was 1.000000000 1" in filled
    used = read_default_template()
    assert "provenance.recording_sha256" in used
    assert render_product("{{ rows|length }}", values, "x") == "12"
