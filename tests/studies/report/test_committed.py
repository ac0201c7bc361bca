"""Results beside the committed ones."""

import json

import numpy as np
import pandas as pd
import pytest

from studies.report import committed_results


def folder(path, summary, table, config=None):
    path.mkdir()
    (path / "summary.json").write_text(json.dumps(summary))
    (path / "manifest.json").write_text(json.dumps({"config": config or {"cases": 3}}))
    pd.DataFrame(table).to_csv(path / "table.csv", index=False)
    return committed_results.read(path)


SUMMARY = {"a": {"b": 1.23456, "c": [1, 0.0]}, "word": "x", "yes": True, "none": None}
TABLE = {"name": ["p", "q"], "value": [1.0, 2e-3], "empty": [np.nan, 1.0]}


def test_the_last_bits_do_not_move_and_a_digit_does(tmp_path):
    then = folder(tmp_path / "then", SUMMARY, TABLE)
    bits = {**SUMMARY, "a": {"b": 1.23456 * (1 + 1e-6), "c": [1, 3e-17]}}
    same = folder(tmp_path / "same", bits, {**TABLE, "value": [1.0 + 1e-9, 2e-3 + 1e-12]})
    assert committed_results.list_moved_numbers(same, then).empty
    assert "agrees with" in committed_results.compare_results(same, then)[0]
    other = folder(tmp_path / "other", {**SUMMARY, "word": "y", "new": 1}, {**TABLE, "value": [1.0, 2.1e-3]})
    said, found = committed_results.compare_results(other, then)
    assert found["number"].tolist() == ["word", "new", "value, row 2"]
    assert "DIFFERS" in said
    assert "3 numbers moved" in said


def test_other_settings_are_named_and_not_compared(tmp_path):
    then = folder(tmp_path / "then", SUMMARY, TABLE)
    now = folder(tmp_path / "now", SUMMARY, TABLE, {"cases": 4})
    assert "cases: 3 → 4" in committed_results.compare_results(now, then)[0]
    assert "nothing committed" in committed_results.compare_results(now, None)[0]
    assert committed_results.read(tmp_path / "nowhere") is None


@pytest.mark.usefixtures("blank_figures")
def test_the_command_writes_elsewhere_and_ends_with_the_page(run_cli, monkeypatch, tmp_path):
    """Nothing committed is touched; what moved is shown; the last line is the page's path."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    for name in ("reproduction", "mission"):
        folder(tmp_path / "results" / name, {"a": 1.0}, TABLE)
    before = {path: path.read_bytes() for path in (tmp_path / "results").rglob("*.*")}

    def ran(where, *_):
        where.parent.mkdir(exist_ok=True)
        folder(where, {"a": None}, TABLE)
        return {"a": None}

    monkeypatch.setattr("studies.natanson.reproduce.run", ran)
    monkeypatch.setattr("studies.robertson.reproduce.run", ran)
    result = run_cli("reproduce")
    assert result.exit_code == 0, result.stderr
    assert {path: path.read_bytes() for path in (tmp_path / "results").rglob("*.*")} == before
    assert result.stdout.splitlines()[-1] == "build/index.html"
    assert result.stdout.count("DIFFERS") == 2
    assert (tmp_path / "build" / "index.html").read_text().startswith("<!doctype html>")
