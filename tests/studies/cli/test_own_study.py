"""A study of one's own: a file with a STUDY, run by its path."""

import json
import re
import sys
from xml.etree import ElementTree

import pytest

MINE = '''"""How well the mean of some noise is known."""

import numpy as np

from {helper} import scale
from studies.montecarlo.study import Streams, Study, StudyConfig


class Mine(StudyConfig):
    size: int = 20


def case(config: Mine, number: int, streams: Streams) -> dict[str, object]:
    draws = scale() * streams.generator("noise").standard_normal(config.size)
    return {{"mean": draws.mean(), "good": bool(draws.mean() > 0), "kind": "even" if number % 2 == 0 else "odd"}}


STUDY = Study("{name}:STUDY", Mine, case)
'''


@pytest.fixture
def mine(tmp_path, monkeypatch):
    """A file with a study, in a folder of its own, of a name that no other test uses."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    known = set(sys.modules)
    number = abs(hash(str(tmp_path)))
    name, helper = f"mine_{number}", f"helper_{number}"
    (tmp_path / f"{helper}.py").write_text("def scale():\n    return 2.0\n")
    path = tmp_path / f"{name}.py"
    path.write_text(MINE.format(name=name, helper=helper))
    yield path
    for module in set(sys.modules) - known:
        if module in (name, helper):
            del sys.modules[module]


def test_it_stops_when_told(mine, run_cli, tmp_path):
    out = tmp_path / "out"
    arguments = ["study", str(mine), "--cases", "500", "--backend", "serial", "--out", str(out), "--until", "std(mean)<0.1"]
    found = run_cli(*arguments, "--json", str(tmp_path / "out.json"))
    assert found.exit_code == 0, found.output
    assert "half-width of std(mean) < 0.1 is met" in found.stdout
    assert json.loads((tmp_path / "out.json").read_text())["until"]["met"] is True


def test_a_script_fails_on_what_it_names_only(mine, run_cli, tmp_path):
    words = ["study", str(mine), "--cases", "70", "--backend", "serial", "--out", str(tmp_path / "out")]
    words += ["--until", "std(mean)<1e-9", "--require", "p50(mean)<-100", "--require", "p10(mean)>-100"]
    found = run_cli(*words, "--fail-on", "failed, until,require", "--junit", str(tmp_path / "out.xml"))
    assert found.exit_code == 3
    told = (
        "--fail-on until: half-width of std(mean) < 1e-09 is not met, --fail-on require: p50(mean) < -100 @ 90 % is not met\n"
    )
    assert found.stderr.endswith(told)
    names = [one.get("name") for one in ElementTree.parse(tmp_path / "out.xml").getroot()[0] if len(one)]
    assert names == ["p50(mean) < -100 @ 90 %", "half-width of std(mean) < 1e-09"]
    assert run_cli(*words, "--fail-on", "failed").exit_code == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "has no STUDY"),
        ("def\n", "SyntaxError"),
        ("raise SystemExit(3)\n", "line 1: SystemExit: 3"),
    ],
)
def test_a_file_that_cannot_be_run_is_one_line(text, message, mine, run_cli):
    mine.write_text(text)
    found = run_cli("study", str(mine))
    assert found.exit_code == 2
    assert message in found.stderr
    assert re.fullmatch(r"gyrocal: [^\n]*\n", found.stderr)
