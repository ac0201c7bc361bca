"""The command gyrocal predict."""

import numpy as np
import pandas as pd
import pytest

from gyrocal import save
from tests.builders import TRUTH, piecewise_recording
from tests.gyrocal.calibration.remainder_cases import simulate_remainder
from tests.pages import checked


@pytest.mark.usefixtures("blank_figures")
def test_prediction_as_csv_and_as_a_page(run_cli, tmp_path):
    save(piecewise_recording(series_s=100.0, apriori=TRUTH, gap_s=300.0), tmp_path / "rec")
    page = tmp_path / "p.html"
    done = run_cli("predict", str(tmp_path / "rec"), "--from", "2500", "--out", str(tmp_path / "p.csv"), "--report", str(page))
    assert done.exit_code == 0, done.stderr
    assert "26 references are used" in done.stdout
    table = pd.read_csv(tmp_path / "p.csv")
    assert list(table.columns) == ["t_s", "q1", "q2", "q3", "q4", *(f"sigma_{axis}_arcsec" for axis in "xyz")]
    assert (np.diff(table["t_s"]) > 0).all()
    assert table["t_s"].iloc[-1] == 3000.0  # the end of the stretch without a gap
    assert table["sigma_x_arcsec"].iloc[-1] > table["sigma_x_arcsec"].iloc[0]
    last = table.filter(like="sigma").iloc[-1].max()
    assert f"By gyro alone the attitude is known to {last:.3g} arcsec after 500 s" in checked(page.read_text()).words


@pytest.mark.usefixtures("blank_figures")
def test_prediction_with_an_earlier_calibration(run_cli, tmp_path):
    save(simulate_remainder(0, rate=np.deg2rad(0.1)), tmp_path / "earlier")
    save(simulate_remainder(1, rate=np.deg2rad(0.1)), tmp_path / "rec")
    result = tmp_path / "result.json"
    done = run_cli("calibrate", str(tmp_path / "earlier"), "--json", str(result), "--report", str(tmp_path / "c.html"))
    assert done.exit_code == 0, done.stderr
    assert "Use the sigmas with remainder" in done.stdout
    assert "sigma with remainder" in checked((tmp_path / "c.html").read_text()).words
    given = ("predict", str(tmp_path / "rec"), "--from", "30", "--out")
    sigma = {}
    for name, more in {
        "with": ("--calibration", str(result)),
        "without": ("--prior-sigma-g", "1e-4", "--prior-sigma-bias", "1e-3"),
    }.items():
        done = run_cli(*given, str(tmp_path / f"{name}.csv"), *more)
        assert done.exit_code == 0, done.stderr
        sigma[name] = pd.read_csv(tmp_path / f"{name}.csv").filter(like="sigma").iloc[-1]
    assert (sigma["with"] > 1.5 * sigma["without"]).all()
    refused = run_cli(*given, str(tmp_path / "p.csv"), "--calibration", str(result), "--prior-scale", "0.1")
    assert refused.exit_code == 2
    assert "leave out --prior-sigma-g" in refused.stderr
