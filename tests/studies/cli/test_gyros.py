"""Commands on recordings of several gyros."""

import json

import numpy as np
import pytest

SHORT = ("--set", "gyro.sample_s=5.0", "--set", "reference.every_s=300.0")


@pytest.fixture
def four(tmp_path, run_cli):
    folder, truth = tmp_path / "rec", tmp_path / "truth.json"
    done = run_cli("simulate", "trmm_tetrahedron", str(folder), "--truth", str(truth), *SHORT)
    assert done.exit_code == 0, done.stderr
    return folder, truth


def test_four_gyros_are_simulated_and_calibrated(four, tmp_path, run_cli):
    folder, truth = four
    out = tmp_path / "result.json"
    done = run_cli("calibrate", str(folder), "--truth", str(truth), "--json", str(out))
    assert done.exit_code == 0, done.stderr
    assert "Parity of the gyros alone" in done.stdout
    result, gyros = json.loads(out.read_text()), json.loads(truth.read_text())["gyros"]
    K, c = np.array(gyros["K"]), np.array(gyros["c_deg_s"])
    error = np.column_stack([np.array(result["K"]) - K, np.array(result["c_deg_s"]) - c]).ravel()
    assert np.abs(error / np.sqrt(np.diag(result["covariance"]))).max() < 4.5
    assert np.shape(result["G"]) == (3, 4)
    np.testing.assert_allclose(np.array(result["G"]) @ K, np.eye(3), atol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(("--solve-for", "bias"), "--solve-for is for the gyros x, y and z; there are 1, 2, 3, 4"), (("--step", "5"), "--step")],
)
def test_options_of_three_gyros_are_refused(four, run_cli, arguments, words):
    done = run_cli("calibrate", str(four[0]), *arguments)
    assert done.exit_code == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_attitude_is_carried_on_by_their_body_rates(four, tmp_path, run_cli):
    done = run_cli("predict", str(four[0]), "--from", "3000")
    assert done.exit_code == 0, done.stderr
