"""CI regression of recovered parameters: ``gyrocal baseline`` shows what moved, ``gyrocal baseline --write`` accepts it."""

import pandas as pd

from studies.validation import baseline
from tests import ROOT

STORED = ROOT / "results" / "baseline" / "recovered.csv"


def test_recovered_parameters_are_those_of_the_baseline():
    new = baseline.recovered()
    stored = baseline.read(STORED)
    assert baseline.moved(stored, new).empty
    values = [column for column in new.columns if column not in baseline.KEYS]
    pd.testing.assert_frame_equal(stored[values], new[values], rtol=baseline.RTOL, atol=0)


def test_a_small_change_is_seen():
    stored = baseline.read(STORED)
    changed = stored.copy()
    changed.loc[2, "second_b_x_deg_h"] *= 1 + 2 * baseline.RTOL
    table = baseline.moved(stored, changed)
    assert table["quantity"].tolist() == ["second_b_x_deg_h"]
    assert baseline.moved(stored, stored).empty
    assert not baseline.moved(stored, stored.head(3)).empty


def test_command_shows_what_moved(run_cli, tmp_path):
    path = tmp_path / "recovered.csv"
    missing = run_cli("baseline", "--file", str(path))
    assert missing.exit_code == 2
    stored = baseline.read(STORED)
    stored.loc[0, "nees"] *= 1.1
    baseline.write(stored, path)
    shown = run_cli("baseline", "--file", str(path))
    assert shown.exit_code == 1
    assert "nees" in shown.stdout
    assert run_cli("baseline", "--file", str(path), "--write").exit_code == 0
    assert run_cli("baseline", "--file", str(path)).exit_code == 0
