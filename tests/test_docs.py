"""The examples of README and docstrings run as they stand."""

import doctest
import re

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import gyrocal
import simulator.scenario
from simulator import adopted_scenario
from studies.cli import export, import_
from tests import ROOT


def test_readme_examples(capsys):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    assert len(blocks) == 1
    exec(compile(blocks[0], "README.md", "exec"), {})
    assert "G_xx" in capsys.readouterr().out


def test_docstring_examples():
    for module in (simulator, simulator.scenario):
        result = doctest.testmod(module)
        assert result.attempted > 0
        assert result.failed == 0


def test_recording_example_makes_a_recording(tmp_path):
    text = (ROOT / "docs" / "recording.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    folder = tmp_path / "mine"
    exec(compile(block.replace("/tmp/mine", str(folder)), "recording.md", "exec"), {})
    result = gyrocal.calibrate(gyrocal.load(folder))
    # The example's rates and attitudes agree, in sign and convention: nothing is left to correct.
    np.testing.assert_allclose(result.G, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(result.bias, 0, atol=1e-12)
    assert result.dof == 6
    # The header with every key that there is, on the first interval of the same data.
    attitude = pd.read_csv(folder / "attitude.csv")
    attitude[attitude["t_s"] <= 600.0].to_csv(folder / "attitude.csv", index=False)
    header = re.search(r"```toml\n(.*?)```", text, flags=re.DOTALL).group(1)
    (folder / "recording.toml").write_text(
        header.replace("stop_s = 6000.0", "stop_s = 600.0").replace("sample_s = 0.5", "sample_s = 1.0")
    )
    assert gyrocal.load(folder).intervals[0].name == "m1"


PAGES = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs" / "formats").glob("*.md"))


@pytest.mark.parametrize("page", [*PAGES, "docs/broad.md"])
def test_examples_of_formats(page):
    modules = {
        "ros": "rosbags.highlevel",
        "euroc": "yaml",
    }
    optional = modules.get(page.rpartition("/")[2].removesuffix(".md"))
    if optional:
        pytest.importorskip(optional)
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)
    namespace = {}
    exec(compile(block, page, "exec"), namespace)
    if "found" in namespace:
        np.testing.assert_allclose(namespace["found"].q[1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], rtol=0, atol=1e-15)
    if "result" in namespace:
        assert np.abs(np.abs(namespace["result"].bias_deg_s) - 0.4).max() < 0.02
    if page.endswith("csv.md"):
        assert pd.read_csv(f"{namespace['folder']}/attitude.csv")["unix_ns"].tolist() == [
            1597579328000000000,
            1597579338000000000,
        ]


def test_every_format_has_its_page():
    listed = set(re.findall(r"\((formats/[a-z]+\.md)\)", (ROOT / "docs" / "formats.md").read_text()))
    assert {f"docs/{name}" for name in listed} == set(PAGES)
    commands = {*import_.command.commands, *export.command.commands}
    assert {"csv", "aem", "ck", "euroc", "bag", "broad"} == commands


def test_gyros_example_recovers_the_scale_factor(tmp_path, capsys):
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "gyros.md").read_text(), flags=re.DOTALL)
    namespace = {}
    exec(compile(block.replace("/tmp/tetrahedron", str(tmp_path)), "gyros.md", "exec"), namespace)
    result = namespace["result"]
    assert "sigma_scale_factor" in capsys.readouterr().out
    error = result.gyros.vector - np.column_stack([namespace["K"], np.zeros(4)]).ravel()
    assert np.abs(error / np.sqrt(np.diag(result.covariance))).max() < 4.5
    back = gyrocal.load(tmp_path)
    assert back.intervals[4].gyros == ("1", "3", "4")


def test_references_example_finds_its_alignment(capsys):
    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "references.md").read_text(), flags=re.DOTALL)
    namespace = {}
    exec(compile(block, "references.md", "exec"), namespace)
    found, turn = namespace["found"], namespace["turn"]
    M = Rotation.from_matrix(found.misalignment["DSS-2"])
    error = (Rotation.from_rotvec(turn) * M.inv()).as_rotvec()
    assert (np.abs(error) < 4 * found.sigma[:3]).all()
    assert (np.abs(error) < 0.2 * np.abs(turn)).all()
    assert 1e-4 < namespace["result"].p_value < 1 - 1e-4
    assert capsys.readouterr().out.count("a rotation of all sensors together") == 3


def test_scenario_example_is_a_scenario(tmp_path):
    (block,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "scenario.md").read_text(), flags=re.DOTALL)
    (tmp_path / "mine.toml").write_text(block)
    scenario = simulator.load(tmp_path / "mine.toml")
    assert scenario.interval[0].hold.transition_s == 30.0
    simulator.motion(scenario)


def test_compare_example_is_a_scenario(tmp_path):
    (block,) = re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "compare.md").read_text(), flags=re.DOTALL)
    gyrocal.save(simulator.simulate(simulator.load("trmm"), seed=1), tmp_path / "rec")
    (tmp_path / "mine.toml").write_text(re.sub(r'sha256 = ".*?"', "", block))
    loaded = adopted_scenario.load(tmp_path / "mine.toml")
    assert loaded.covariance.shape == (2, 2)
    assert loaded.fly(1, draw=True).gyro.rates.shape == loaded.plan.recording.gyro.rates.shape
