import json
import os

import numpy as np
import pandas as pd

from studies.montecarlo import files


def test_json_is_plain(tmp_path):
    value = {
        "a": np.float64(0.1 + 0.2),
        "b": [np.int64(2), float("nan"), (np.inf, True)],
        "c": np.eye(2),
        "d": np.bool_(False),
        "ψ": None,
        3: "x",
    }
    files.write_json(tmp_path / "a.json", value)
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    expected = {"a": 0.1 + 0.2, "b": [2, None, [None, True]], "c": [[1.0, 0.0], [0.0, 1.0]], "d": False, "ψ": None, "3": "x"}
    assert json.loads(text) == expected
    assert "ψ" in text
    assert text.endswith("}\n")


def test_tables(tmp_path):
    table = pd.DataFrame({"x": [1 / 3, np.nan], "name": ["a", "b"]})
    files.write_csv(tmp_path / "a.csv", table, 3)
    assert (tmp_path / "a.csv").read_text() == "x,name\n0.333,a\n,b\n"
    files.write_csv(tmp_path / "a.csv", pd.DataFrame({"x": [1 / 3, "b", 12345678]}, dtype=object), 3)
    assert (tmp_path / "a.csv").read_text() == "x\n0.333\nb\n12345678\n"
    files.write_csv(tmp_path / "a.csv", table)  # nine digits unless asked: what is committed is compared by them
    assert (tmp_path / "a.csv").read_text() == "x,name\n0.333333333,a\n,b\n"
    files.write_parquet(tmp_path / "a.parquet", table)
    pd.testing.assert_frame_equal(pd.read_parquet(tmp_path / "a.parquet"), table)
    assert sorted(os.listdir(tmp_path)) == ["a.csv", "a.parquet"]
