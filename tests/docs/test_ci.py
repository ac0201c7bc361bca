"""The workflows of docs/ci.md run step by step in a folder with a reader's files, pass, and fail when a parameter moved."""

import json
import re
import shlex
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from gyrocal.estimation.remainder_noise import read_calibration
from studies.cli.main import main
from tests.docs import world
from tests.docs.blocks import blocks, list_steps

SMALL = ((r"--cases \d+", "--cases 3"), (r"'p95\((\w+)\)<(\d+)'", r"'p50(\1)<\2 @ 60%' --backend serial"))
FEW = re.compile(r"gyrocal (import|study) ")  # steps that a moved parameter does not change


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    """A folder in which the values have been stored once, as the page says."""
    folder = tmp_path_factory.mktemp("ci")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "path", list(sys.path))
        world.make_log(folder)
        (folder / "mystudy.py").write_text(blocks("docs/studies.md", "python")[1])
        (folder / "baseline.toml").write_text(blocks("docs/ci.md", "toml")[0])
        for _, line in list_steps("docs/ci.md"):
            assert run(line) == 0, line
        yield folder
    sys.modules.pop("mystudy", None)


def list_commands(name):
    """The shell lines of a workflow, without those of its installation."""
    github, gitlab = map(yaml.safe_load, blocks("docs/ci.md", "yaml"))
    steps = [step.get("run", "") for step in github["jobs"]["gyro"]["steps"]] if name == "GitHub" else gitlab["gyro"]["script"]
    return [step for step in steps if step.startswith("gyrocal ")]


def run(line):
    for shown, typed in SMALL:
        line = re.sub(shown, typed, line)
    done = CliRunner().invoke(main, shlex.split(line)[1:])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.output
    return done.exit_code


def test_both_workflows_run_the_same_commands():
    github, gitlab = map(list_commands, ("GitHub", "GitLab"))
    assert [line.split()[1] for line in github] == [line.split()[1] for line in gitlab]
    assert {line.split()[1] for line in github} == {"import", "calibrate", "baseline", "study"}


def test_a_workflow_passes_when_nothing_moved(stored):
    commands = list_commands("GitHub")
    assert [run(line) for line in commands] == [0] * len(commands)


def test_a_workflow_fails_when_a_parameter_moved_by_four_sigma(stored):
    """The stored values move, which is the same as those of the recording the other way."""
    for file in (stored / "reference.json", stored / "expected" / "rec.json"):
        document = json.loads(file.read_text())
        document["bias_deg_s"][2] += 4 * float(np.rad2deg(np.sqrt(read_calibration(file).covariance[11, 11])))
        file.write_text(json.dumps(document))
    own = [line for line in list_commands("GitHub") if not FEW.match(line)]
    assert [line.split()[1] for line in own if run(line) == 1] == ["calibrate", "baseline"]
    (suite,) = ElementTree.parse(stored / "baseline.xml").getroot()
    assert any("b_z" in one.get("name") and len(one) for one in suite)
