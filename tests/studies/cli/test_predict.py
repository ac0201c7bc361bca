"""The command gyrocal predict."""

import numpy as np
import pandas as pd

from gyrocal import save
from tests.builders import TRUTH, piecewise_recording
from tests.pages import checked


def test_prediction_as_csv(run_cli, tmp_path):
    save(piecewise_recording(series_s=100.0, apriori=TRUTH, gap_s=300.0), tmp_path / "rec")
    done = run_cli("predict", str(tmp_path / "rec"), "--from", "2500", "--out", str(tmp_path / "p.csv"))
    assert done.exit_code == 0, done.stderr
    assert "26 references used" in done.stdout
    table = pd.read_csv(tmp_path / "p.csv")
    assert list(table.columns) == ["t_s", "q1", "q2", "q3", "q4", *(f"sigma_{axis}_arcsec" for axis in "xyz")]
    assert (np.diff(table["t_s"]) > 0).all()
    assert table["t_s"].iloc[-1] == 3000.0  # the end of the stretch without a gap
    assert table["sigma_x_arcsec"].iloc[-1] > table["sigma_x_arcsec"].iloc[0]


def test_prediction_as_a_page(run_cli, tmp_path):
    save(piecewise_recording(series_s=100.0, apriori=TRUTH, gap_s=300.0), tmp_path / "rec")
    page = tmp_path / "p.html"
    done = run_cli("predict", str(tmp_path / "rec"), "--from", "2500", "--report", str(page), "--out", str(tmp_path / "p.csv"))
    assert done.exit_code == 0, done.stderr
    last = pd.read_csv(tmp_path / "p.csv").filter(like="sigma").iloc[-1].max()
    assert f"By gyro alone the attitude is known to {last:.3g} arcsec after 500 s" in checked(page.read_text()).words
    refused = run_cli("predict", str(tmp_path / "rec"), "--from", "2500", "--report", str(page), "--out", str(page))
    assert refused.exit_code == 2
    assert "files of their own" in refused.stderr


def test_faults_are_one_line(run_cli, tmp_path):
    save(piecewise_recording(series_s=100.0), tmp_path / "rec")
    done = run_cli("predict", str(tmp_path / "rec"), "--from", "-1")
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    assert "no interval begins before" in done.stderr
