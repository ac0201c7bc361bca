"""The command line of the import, and the page that says how it is used."""

import json

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import gyrocal
from studies.cli.main import main
from studies.validation import mems_log
from tests.gyrocal.importing.mems import CORRECT_MAPPING


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("log")
    data = mems_log.log(np.random.default_rng(9), seconds=60.0)
    data.gyro.to_csv(out / "gyro.csv", index=False)
    # The last attitude is at the end of the last gyro sample and has no row in a table of both.
    data.attitude[:-1].to_csv(out / "mocap.csv", index=False)
    data.gyro.merge(data.attitude, how="left", on="timestamp_ms").to_csv(out / "both.csv", index=False)
    return out


OPTIONS = [word for key, value in CORRECT_MAPPING.items() for word in (f"--{key}", value)]


@pytest.fixture(scope="module")
def made(folder):
    """The log as imported, and what the import said in JSON."""
    files = str(folder / "gyro.csv"), str(folder / "mocap.csv")
    done = CliRunner().invoke(main, ["import", "csv", *files, str(folder / "a"), *OPTIONS, "--json", str(folder / "a.json")])
    assert done.exit_code == 0, done.stderr
    assert "2 rest(s) found" in done.stdout
    return folder / "a"


def test_two_tables_one_table_and_a_mapping_file_are_the_same_as_json_says(run_cli, folder, made):
    (folder / "mine.toml").write_text("\n".join(f'{key} = "{value}"' for key, value in CORRECT_MAPPING.items()))
    second = run_cli("import", "csv", str(folder / "both.csv"), str(folder / "b"), "--mapping", str(folder / "mine.toml"))
    assert second.exit_code == 0, second.stderr
    a, b = gyrocal.load(made), gyrocal.load(folder / "b")
    np.testing.assert_array_equal(a.attitudes.quaternions, b.attitudes.quaternions)
    np.testing.assert_array_equal(a.gyro.apriori_bias, b.gyro.apriori_bias)
    said, recording = folder / "said.json", gyrocal.load(made)
    read = json.loads((folder / "a.json").read_text())
    assert (read["folder"], read["epoch"]) == (str(made), recording.epoch)
    assert (read["gyro_samples"], read["references"]) == (recording.gyro.t_s.size, recording.attitudes.t_s.size)
    assert read["arw_deg_per_sqrt_s"] == pytest.approx(recording.gyro.arw_deg_per_sqrt_s, rel=1e-12)
    np.testing.assert_allclose(read["apriori_bias_deg_s"], recording.gyro.apriori_bias_deg_s, rtol=1e-12)
    assert [one["stop_s"] for one in read["intervals"]] == [one.stop_s for one in recording.intervals]
    assert "2 rest(s) found" in read["assumed"]
    written = run_cli("export", "csv", str(made), str(folder / "e"), "--json", str(said))
    assert written.exit_code == 0, written.stderr
    read = json.loads(said.read_text())
    assert read["recording"]["references"] == recording.attitudes.t_s.size
    assert sorted(read["files"]) == sorted(str(path) for path in (folder / "e").iterdir())


def test_a_gyro_mounted_by_hand_is_refused_with_the_option_that_imports_it(run_cli, folder):
    turn = Rotation.from_rotvec(np.deg2rad([50.0, 20.0, -30.0]))
    table = pd.read_csv(folder / "gyro.csv")
    table[["gx", "gy", "gz"]] = turn.apply(table[["gx", "gy", "gz"]].to_numpy())
    table.to_csv(folder / "turned.csv", index=False)
    arguments = ("import", "csv", str(folder / "turned.csv"), str(folder / "mocap.csv"), str(folder / "turned"), *OPTIONS)
    refused = run_cli(*arguments)
    assert refused.exit_code == 2
    assert "--mounting estimate, which rotates the gyro's axes by 6" in refused.stderr
    assert run_cli(*arguments, "--mounting", "estimate").exit_code == 0
    done = run_cli("calibrate", str(folder / "turned"), "--json", str(folder / "turned.json"))
    assert done.exit_code == 0, done.stderr
    assert "Plausible ranges: 0.1 in G and 3.6e+04 deg/h in b (MEMS grade" in " ".join(done.stdout.split())
    found = json.loads((folder / "turned.json").read_text())
    assert found["mounting"]["angle_deg"] == pytest.approx(np.rad2deg(turn.magnitude()), abs=2.0)
    assert found["mounting"]["change_from_apriori_deg"] < 3.0
    assert found["warnings"] == []
