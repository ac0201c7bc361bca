"""Three gyros that are not at right angles are noticed by what the fit says, and the option that is named mends them."""

import re

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import gyrocal
from studies.cli.main import main

RATES = ["gx", "gy", "gz"]
AXES = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1]]) / np.sqrt(3)  # three of a tetrahedron
COLUMNS = ("--quat", "qw,qx,qy,qz:body-to-inertial", "--gyro", "gx,gy,gz:deg/s")


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def write_tables(folder, gyro, attitude):
    gyro.to_csv(folder / "g.csv", index=False)
    attitude.to_csv(folder / "a.csv", index=False)
    return "import", "csv", folder / "g.csv", folder / "a.csv", folder / "out", *COLUMNS


def turn_steadily(K, rate_deg_s, sigma_deg):
    """Tables of a body at a constant rate: gyros along the rows of K, and attitudes."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 60, 0.25)
    body = Rotation.from_rotvec(np.deg2rad(t[:, None] * rate_deg_s)) * Rotation.from_rotvec(
        np.deg2rad(sigma_deg) * rng.normal(size=(t.size, 3))
    )
    rates = rate_deg_s @ K.T + 1e-5 * rng.normal(size=(t.size, 3))
    quaternions = dict(zip(("qw", "qx", "qy", "qz"), np.roll(body.as_quat(), 1, axis=1).T, strict=True))
    return pd.DataFrame({"t": t} | dict(zip(RATES, rates.T, strict=True))), pd.DataFrame({"t": t} | quaternions)


def test_skew_gyros_at_a_constant_rate_are_said_by_import_and_calibration(tmp_path):
    rate = np.array([0.06, -0.02, 0.01])
    words = (*write_tables(tmp_path, *turn_steadily(AXES, rate, 0.0005)), "--time", "t:s", "--force")
    taken = run(*words)
    assert taken.exit_code == 0, taken.output
    said = re.search(r"implausible: (the mean rate is .*)", taken.output).group(1)
    by_gyro, by_attitudes = (float(one) for one in re.findall(r"([\d.]+) (?:± [\d.e-]+ )?deg/s by the", said))
    assert by_gyro == pytest.approx(np.linalg.norm(AXES @ rate), rel=1e-3)
    assert by_attitudes == pytest.approx(np.linalg.norm(rate), rel=0.02)
    assert said in run("calibrate", tmp_path / "out").output
    for axes in ("tetrahedron", ";".join(",".join(map(str, row)) for row in AXES)):
        mended = run(*words, "--axes", axes)
        assert mended.exit_code == 0, mended.output
        assert "implausible" not in mended.output
        bias = gyrocal.load(tmp_path / "out").gyro.apriori_bias
        assert np.abs(np.rad2deg(bias)).max() < 1e-3
