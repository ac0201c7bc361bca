"""The commands start light: their modules load nothing that compiles, computes or draws, and a refused file no numba."""

import subprocess
import sys
from typing import get_args

import pytest

from gyrocal import save
from simulator.mission_mode.config import DAY
from simulator.mission_mode.effects import MISSION_EFFECTS
from simulator.mission_mode.mounting import Mounting
from studies.cli import compare, mission, reproduce
from studies.cli.main import COMMAND_NAMES
from studies.compare import compare as comparison
from studies.natanson.reproduce import REPRODUCTION_FOLDER
from studies.robertson.calendar import PERIODS
from studies.robertson.report import MISSION_FOLDER
from studies.robertson.runs import DAYS
from tests import ROOT
from tests.gyrocal.recording.test_parquet import recording

HEAVY = "numba", "scipy", "pandas", "matplotlib", "pyarrow"
LISTED = "import sys; loaded = [name for name in sys.argv[1].split(',') if name in sys.modules]; print(loaded, file=sys.stderr)"


def run_fresh(code, *names):
    """Standard error of a fresh process, which ends with the list of the modules it has loaded of the names."""
    arguments = [sys.executable, "-c", f"{code}\n{LISTED}", ",".join(names)]
    return subprocess.run(arguments, capture_output=True, text=True, check=True, cwd=ROOT).stderr.splitlines()


@pytest.mark.parametrize("name", COMMAND_NAMES)
def test_a_command_module_loads_nothing_heavy(name):
    code = f"import click; from studies.cli.main import main; main.get_command(click.Context(main), {name!r})"
    assert run_fresh(code, *HEAVY) == ["[]"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("allan", "REC"),
        ("calibrate", "REC"),
        ("compare", "REC"),
        ("diagnose", "REC"),
        ("export", "csv", "REC", "OUT"),
        (
            "import",
            "csv",
            "REC/gyro.csv",
            "OUT",
            "--time",
            "t:s",
            "--gyro",
            "x,y,z:deg/s",
            "--quat",
            "a,b,c,d:body-to-inertial",
        ),
        ("next", "REC"),
        ("predict", "REC", "--from", "1"),
        ("study", "nothing"),
        ("trend", "REC"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_refused_file_loads_no_numba(arguments, tmp_path):
    rec = tmp_path / "rec"
    save(recording(), rec)
    (rec / "gyro.parquet").unlink()
    (rec / "gyro.csv").write_text("t_s,rate\n0,1\n")
    places = {"REC": str(rec), "OUT": str(tmp_path / "out"), "REC/gyro.csv": str(rec / "gyro.csv")}
    typed = [places.get(word, word) for word in arguments]
    code = f"from studies.cli.main import main\ntry: main({typed!r}, 'gyrocal')\nexcept SystemExit as end: assert end.code == 2"
    said, loaded = run_fresh(code, "numba", "matplotlib")
    assert said.startswith("gyrocal")
    assert loaded == "[]"


def test_what_the_options_list_is_what_there_is():
    assert (tuple(MISSION_EFFECTS), get_args(Mounting), PERIODS) == (
        mission.EFFECT_NAMES,
        mission.MOUNTING_NAMES,
        mission.PERIODS,
    )
    assert (mission.DAY, reproduce.DAYS) == (DAY, DAYS)
    assert (compare.BASELINE, compare.FEWEST_FLIGHTS) == (comparison.BASELINE, comparison.FEWEST_FLIGHTS)
    assert reproduce.PAPER_FOLDERS == {"natanson": REPRODUCTION_FOLDER, "robertson": MISSION_FOLDER}
