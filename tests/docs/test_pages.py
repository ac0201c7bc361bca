"""Every block and every command of README, docs and ``--help`` runs in the order of its page, coarsely where it takes minutes.

`world` makes what stands behind the names of a reader's own files. A line that stands in several places runs in the first of
them, and in others if later lines there need its files.
"""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from contextlib import contextmanager
from unittest.mock import patch

import pytest
from click.testing import CliRunner

import simulator
from diagnosis.diagnose import diagnose
from gyrocal import importing
from studies.cli.main import main
from studies.report import svg
from tests import ROOT
from tests.docs import world
from tests.docs.blocks import PAGES, blocks, list_examples, list_steps

HELP = list_examples()
SHOWN = {page: steps for page in PAGES if page != "docs/ci.md" and (steps := list(list_steps(page)))} | HELP  # see test_ci.py
SMALL = (  # what is typed in place of what is shown
    (r"\btrmm_series\b", "series.toml"),
    (r"(?<=scenario=)mine\.toml|(?<=--scenario )mine\.toml", "scenario.toml"),
    (r"--seed 1 --effect bias_orbital:\S+", "--effect bias_orbital:z=0.3"),
    (r"^gyrocal plan (?!.*--effect )\S+", "gyrocal plan series.toml --effect bias_orbital --no-extras"),
    (r"^(gyrocal plan )mine\.toml\b", r"\1series.toml --no-extras"),
    (r"^(gyrocal mission .*)--days \d+", r"\1--days 0.02"),
    (r"--runs \d+|(?<=^gyrocal compare) (?!.*--runs)", " --runs 20 "),
    (r"--cases \d+", "--cases 3"),
    (r"^gyrocal study (?!psi|real)(\S+) (?!.*--(cases|rerun))", r"gyrocal study \1 --cases 3 "),
    (r"^gyrocal study real(?!.*folder=)", "gyrocal study real --set folder=/data/broad"),
    (r"^gyrocal study psi", "gyrocal study psi --set slew_rates_deg_s=[0.2] --set slew_angles_deg=[30]"),
    (r"--rerun 17\b", "--rerun 1"),
    (r"^(gyrocal study (?!.*--(rerun|backend))\S+ .*)", r"\1 --backend serial"),
    (r"^gyrocal reproduce(?!.*natanson)", "gyrocal reproduce --days 1 --slews 2"),
    (r"^gyrocal reproduce(?!.*(robertson|--cases))", "gyrocal reproduce --cases 3"),
    (r"my_effect:z=0\.5", "bias_eclipse:z=2"),
)
MINUTES = r"gyrocal (reproduce|study (heads|real|withheld))"  # in make long
MAKES = r"gyrocal (simulate|import) "
SET_UP = ("python -m venv ", ".venv/bin/pip install ", "pre-commit install")  # lines that make an environment
FIRST_PLACES = {text: place for place in reversed(SHOWN) for _, text in SHOWN[place]}
ELSEWHERE = "import openturns"  # in a block that tests/studies/montecarlo/test_dispersions.py runs with hundreds of rows
DIAGNOSES = {}


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A folder with all that the names in the docs stand for."""
    folder = tmp_path_factory.mktemp("world")
    world.make(folder)
    return folder


def diagnose_once(recording, **options):
    """Several pages diagnose one recording: it is diagnosed once."""
    key = (recording.gyro.rates.tobytes(), recording.attitudes.quaternions.tobytes(), repr(options.get("library")))
    if key not in DIAGNOSES:
        DIAGNOSES[key] = diagnose(recording, **options)
    return DIAGNOSES[key]


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr(svg, "render_svg", lambda figure: b'<svg viewBox="0 0 1 1"></svg>')
    monkeypatch.setattr("diagnosis.diagnose.diagnose", diagnose_once)
    yield tmp_path
    sys.modules.pop("mystudy", None)


LENGTHY = (
    "docs/allan.md",
    "docs/formats.md",
    "docs/import.md",
    "docs/plan.md",
    "docs/studies.md",
    "docs/tutorial.md",
)  # of the pages; their commands have tests of their own


@pytest.mark.parametrize("shown", [pytest.param(page, marks=pytest.mark.long) if page in LENGTHY else page for page in SHOWN])
def test_what_is_shown_runs(shown, place):
    run_all(shown, place)


@pytest.mark.long
@pytest.mark.parametrize("shown", [name for name, steps in SHOWN.items() if any(re.match(MINUTES, text) for _, text in steps)])
def test_what_takes_minutes_runs(shown, place):
    run_all(shown, place, are_minutes_left_out=False)


def run_all(shown, folder, are_minutes_left_out=True):
    namespace = {"__name__": shown}
    if not re.match(MAKES, next((text for _, text in SHOWN[shown] if "/tmp/rec" in text), "")):
        shutil.copytree("RECORDING", "rec")
    for number, (language, text) in enumerate(SHOWN[shown]):
        if language == "python" and ELSEWHERE not in text:
            exec(compile(text.replace("/tmp/", f"{folder}/"), shown, "exec"), namespace)
        elif language == "sh" and not (are_minutes_left_out and re.match(MINUTES, text)) and is_needed(shown, number):
            run(text, folder)


def is_needed(shown, number):
    """Whether a line runs here first, or makes what later steps read."""
    text, later = SHOWN[shown][number][1], "\n".join(text for _, text in SHOWN[shown][number + 1 :])
    own = {name for name in re.findall(r"/tmp/[\w.]+", text) if re.match(MAKES, text) or name != "/tmp/rec"}
    return FIRST_PLACES[text] == shown or any(name in later for name in own)


def run(line, folder):
    words = shlex.split(line)
    if words[0] == "make":
        subprocess.run(["make", "--dry-run", words[1]], cwd=ROOT, check=True, capture_output=True)
    elif line.startswith(SET_UP):
        return
    elif words[:2] == ["pip", "install"]:
        extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
        assert set(re.findall(r"\[(.*?)\]", line)) <= set(extras)
    elif words[0] == "python":
        with patch.object(sys, "argv", [word.replace("/tmp/", f"{folder}/") for word in words[1:]]):
            runpy.run_path(str(ROOT / words[1]), run_name="__main__")
    else:
        line, _, output = line.partition(" > ")
        for shown, typed in SMALL:
            line = re.sub(shown, typed, line)
        with start_scheduler(line) as address:
            line = line.replace("/tmp/", "").replace("/data/broad", str(folder)).replace("tcp://host:8786", address)
            words = [str(ROOT / word) if (ROOT / word).is_file() else word for word in shlex.split(line)[1:]]
            done = CliRunner().invoke(main, words)
        assert done.exit_code == 0, f"{line}\n{done.output}"
        if output:
            (folder / output).write_text(done.stdout)


@contextmanager
def start_scheduler(line):
    """Start a Dask scheduler for a line that names one; its address."""
    if "tcp://" not in line:
        yield ""
        return
    distributed = pytest.importorskip("distributed", reason="dask is an optional extra")
    options = {"threads_per_worker": 1, "dashboard_address": "127.0.0.1:0", "silence_logs": 50}
    with distributed.LocalCluster(n_workers=1, **options) as cluster:
        yield cluster.scheduler_address


def test_blocks_of_toml_are_what_they_say(tmp_path):
    """Those of plan, compare and ci are files of `world`, those of studies.md are run with its study."""
    (block,) = blocks("docs/import.md", "toml")
    importing.validate_mapping(tomllib.loads(block), "the page")
    (block,) = blocks("docs/extending.md", "toml")
    (group,) = tomllib.loads(block)["project"]["entry-points"]
    assert f'"{group}"' in (ROOT / "simulator" / "effects" / "registry.py").read_text()
    (tmp_path / "mine.toml").write_text(blocks("docs/scenario.md", "toml")[0])
    simulator.motion(simulator.load(tmp_path / "mine.toml"))
