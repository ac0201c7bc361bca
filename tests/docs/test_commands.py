"""Every command that a page or a ``--help`` shows is typed, with what `world` makes behind its names.

What takes minutes is made small by `SMALL`; what cannot be made small is only parsed, `ONLY_PARSED`. Both are lists by name.
A line that stands in several places runs in the first of them, and a command draws its page and its pictures in one place. In
the others, the line is parsed, unless later lines there need the files that it writes.
"""

import json
import re
import runpy
import shlex
import shutil
import sys
import tomllib
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from diagnosis.diagnose import diagnose
from studies import catalogue
from studies.cli.main import main
from studies.cli.options import parse_assignment
from studies.montecarlo.study import load_config
from tests import ROOT
from tests.docs import world
from tests.docs.blocks import PAGES, helped, shell

HELP, TUTORIAL = helped(), "docs/tutorial.md"
SHOWN = {page: lines for page in PAGES if (lines := shell(page))} | HELP
SMALL = (  # what is typed in place of what is shown
    (r"\btrmm_series\b", "series.toml"),
    (r"\btrmm_tetrahedron\b", "four.toml"),
    (r"(?<=scenario=)mine\.toml", "scenario.toml"),
    (r"bias_orbital:z=0\.[23](,phase_deg=60)?( --seed 1)?|(?<=series.toml /rec )--seed 1 --effect .*", "bias_orbital:z=0.3"),
    (r"^(gyrocal plan )mine\.toml\b", r"\1series.toml"),
    (r"--days \d+", "--days 0.02"),
    (r"--cases \d+", "--cases 3"),
    (r"^gyrocal study (\S+) (?!.*--(cases|rerun))", r"gyrocal study \1 --cases 3 "),
    (r"--rerun 17\b", "--rerun 1"),
    (r"^(gyrocal study (?!.*--rerun)\S+ .*)", r"\1 --backend serial"),
    (r"my_effect:z=0\.5", "bias_eclipse:z=2"),
)
ONLY_PARSED = {  # why each is not run here
    "gyrocal plan trmm": "as is the next, a minute; the one of mine.toml is run",
    "gyrocal plan trmm_series": "as above",
    "gyrocal study paper --set": "another one of the study is run",
    "gyrocal study paper --rerun": "that of ./mystudy.py is run",
    "gyrocal baseline --write": "replaces a committed file",
    "gyrocal reproduce": "minutes; tests/studies/natanson and tests/studies/robertson run its parts",
    "gyrocal study heads": "minutes for any number of cases",
    "gyrocal study real": "needs the trials of BROAD",
    "gyrocal study withheld": "minutes; tests/studies/withheld runs a case",
    "gyrocal study paper --backend dask": "needs a scheduler",
    "gyrocal study psi": "a grid of minutes; tests/studies/calibration",
    "gyrocal compare": "tests/studies/cli/test_compare.py",
    "gyrocal diagnose /tmp/months": "tests/diagnosis/test_sensor_tables.py",
    "gyrocal diagnose /tmp/four": "tests/diagnosis/test_gyros.py",
    "gyrocal diagnose --without": "a diagnosis more; tests/studies/cli/test_diagnose.py",
    "gyrocal allan --interval --json": "that with a figure is run",
    "gyrocal diagnose --plan": "a plan of all effects takes a minute; tests/studies/report/test_next_flight.py",
}
NEEDS_DATA = {"real"}  # studies whose settings name files that are not part of the project
SET_UP = {  # lines that make an environment, and what of them can be looked at
    "python -m venv .venv": None,
    ".venv/bin/pip install --constraint constraints.txt --editable .": "constraints.txt",
    "pre-commit install": ".pre-commit-config.yaml",
}


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A folder with all that the names in the docs stand for."""
    folder = tmp_path_factory.mktemp("world")
    world.make(folder)
    return folder


@pytest.fixture(autouse=True)
def _one_diagnosis_of_each_recording(monkeypatch):
    """Several pages diagnose one recording: it is diagnosed once."""
    monkeypatch.setattr("diagnosis.diagnose.diagnose", diagnosed)


DIAGNOSES = {}
DIAGNOSE = diagnose


def diagnosed(recording, **options):
    gyro, attitudes = recording.gyro, recording.attitudes
    tables = (gyro.t_s, gyro.rates, attitudes.t_s, attitudes.quaternions)
    key = (*(one.tobytes() for one in tables), options["seed"], str(options["library"]))
    if key not in DIAGNOSES:
        DIAGNOSES[key] = DIAGNOSE(recording, **options)
    return DIAGNOSES[key]


FIRST_PLACES = {line: place for place in reversed(SHOWN) for line in SHOWN[place]}
PAGES_DRAWN_AT = {
    line.split()[1]: place for place in (*reversed(SHOWN), TUTORIAL) for line in SHOWN[place] if "--report" in line
}


def in_small(line, place):
    """What is typed for a line; a command makes its page and its pictures once."""
    for shown, typed in SMALL:
        line = re.sub(shown, typed, line)
    if PAGES_DRAWN_AT.get(line.split()[1], place) != place:
        return re.sub(r" --(report|figure) \S+", "", line)
    return line


def is_needed(place, number):
    """Whether the line of a place with this number runs there first, or writes what later lines there read."""
    lines = SHOWN[place]
    before, own, after = (
        set(re.findall(r"/tmp/[\w.]+", "\n".join(some)))
        for some in (lines[:number], lines[number : number + 1], lines[number + 1 :])
    )
    before.add("/tmp/adopted.toml")  # `world` has one
    if not re.search(r"gyrocal (simulate|import) ", lines[number]):
        before.add("/tmp/rec")  # it is there if no line makes it
    return FIRST_PLACES[lines[number]] == place or bool((own - before) & after)


def belongs(key, line):
    return all(word in line.split() for word in key.split())


@cache
def extras():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


@pytest.mark.parametrize("place", [place for place in SHOWN if place != TUTORIAL])  # which has a test of its own
def test_what_is_shown_runs(place, made, tmp_path, monkeypatch):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    lines = [line.removeprefix(".venv/bin/") if "gyrocal" in line.split()[0] else line for line in SHOWN[place]]
    before_first = [line for line in lines if "/tmp/rec" in line][:1]
    if not any(re.match(r"gyrocal (simulate|import) ", line) and "/tmp/rec" in line for line in before_first):
        shutil.copytree(tmp_path / "RECORDING", tmp_path / "rec")
    if not any("import" in line for line in lines):
        shutil.copy(tmp_path / "scenario.toml", tmp_path / "mine.toml")
    else:
        shutil.copy(tmp_path / "mapping.toml", tmp_path / "mine.toml")
    for number, line in enumerate(lines):
        if is_needed(place, number):
            run(line, place, tmp_path)
        elif line.startswith("gyrocal "):
            parsed(main, shlex.split(line)[1:])
    sys.modules.pop("mystudy", None)


def run(line, place, folder):
    """One line, or as much of it as can be run here."""
    words = shlex.split(line)
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), flags=re.MULTILINE), line
    elif line in SET_UP:
        assert SET_UP[line] is None or (ROOT / SET_UP[line]).is_file()
    elif words[:2] == ["pip", "install"]:
        assert set(re.findall(r"\[(.*?)\]", line)) <= set(extras()), line
    elif words[0] == "python":
        script_runs(words[1:], folder)
    elif any(belongs(key, line) for key in ONLY_PARSED):
        parsed(main, words[1:])
    else:
        assert words[0] == "gyrocal", line
        words = shlex.split(in_small(line.replace("/tmp/", "").partition(" > ")[0], place))
        done = CliRunner().invoke(main, words[1:])
        assert done.exit_code == 0, f"{line}\n{done.output}"


def script_runs(words, folder):
    arguments = sys.argv
    sys.argv = [words[0], *(word.replace("/tmp/", f"{folder}/") for word in words[1:])]
    try:
        runpy.run_path(str(ROOT / words[0]), run_name="__main__")
    finally:
        sys.argv = arguments


def parsed(command, words, parent=None, name="gyrocal"):
    """The options of a line, as click reads them; a wrong one raises."""
    context = command.make_context(name, list(words), parent=parent)
    if parent is None:
        below = command.get_command(context, words[0])
        assert below is not None, words
        parsed(below, words[1:], context, words[0])
    elif name == "study" and words[0] not in NEEDS_DATA:
        changes = dict(parse_assignment(change) for change in context.params["changes"])
        load_config(catalogue.find_entry(words[0]).study, None, changes)


def test_the_names_that_stand_for_something_are_used():
    """No list keeps a name that no page has any more."""
    text = "\n".join(line for lines in SHOWN.values() for line in lines)
    assert [name for name in world.PLACEHOLDERS if name not in text] == []
    assert [key for key in ONLY_PARSED if not any(belongs(key, line) for line in text.splitlines())] == []
    assert [shown for shown, _ in SMALL if not re.search(shown, text.replace("/tmp/", ""), flags=re.MULTILINE)] == []
    assert [line for line in SET_UP if line not in text] == []


def test_every_command_has_an_example():
    groups = {name.removesuffix(" --help").removeprefix("gyrocal ").split()[0] for name in HELP}
    assert groups == set(main.list_commands(None))


def test_the_tutorial_ends_where_it_says(made, tmp_path, monkeypatch, capsys):
    """The parameters that its page promises are those of the script that wrote the log, and nothing is left at rest."""
    monkeypatch.chdir(tmp_path)
    answers = []
    for line in shell("docs/tutorial.md"):
        if not line.startswith("gyrocal"):
            run(line, TUTORIAL, tmp_path)
        else:
            answers.append(CliRunner().invoke(main, shlex.split(line.replace("/tmp/", ""))[1:]))
            assert answers[-1].exit_code == 0, answers[-1].output
    first, last = (" ".join(answers[k].stdout.split()) for k in (1, 4))
    page = " ".join((ROOT / "docs" / "tutorial.md").read_text().replace("> ", "").split())
    assert re.search(r"χ² = \d+\.\d with \d+ degrees of freedom, p = \d\.\d+e-\d+\.", first)[0] in page
    found = json.loads((tmp_path / "desk" / "diagnosis.json").read_text())
    (cause,) = found["causes"]
    assert set(cause["group"]) == {"rate_lag", "time_offset"}
    assert f"{cause['size']:.4f} ± {cause['sigma']:.4f} s" in page
    assert "do not trust" not in last
    assert json.loads((tmp_path / "desk" / "result.json").read_text())["p_value"] > 1e-3
    G, b = world.truth(tmp_path / "desk" / "result.json")
    np.testing.assert_allclose(G, np.eye(3) / 1.01, atol=1e-3)
    np.testing.assert_allclose(b, np.array([-0.3, 0.2, -0.1]) / 1.01, atol=3e-3)
    assert "No gap" in answers[-1].stdout
    left = world.namespace("docs/tutorial.md", tmp_path)["rates"][:100].mean(axis=0)
    assert np.abs(left).max() < 0.02
    capsys.readouterr()
