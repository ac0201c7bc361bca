"""The command line of the import, and the page that says how it is used."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

import gyrocal
from studies.cli.main import main
from tests.gyrocal.importing import mems_log
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
