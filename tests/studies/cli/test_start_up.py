"""The commands start light: their modules load nothing that compiles, computes or draws, and a refused file no numba."""

import subprocess
import sys
from typing import get_args

from simulator.mission_mode.config import DAY
from simulator.mission_mode.effects import MISSION_EFFECTS
from simulator.mission_mode.mounting import Mounting
from studies.cli import compare, mission, reproduce
from studies.cli.main import COMMAND_NAMES
from studies.compare import compare as comparison
from studies.natanson.reproduce import REPRODUCTION_FOLDER
from studies.robertson.calendar import PERIODS
from studies.robertson.reproduce import MISSION_FOLDER
from studies.robertson.runs import DAYS
from tests import ROOT

HEAVY = "numba", "scipy", "pandas", "matplotlib", "pyarrow"
LOADED = """
import sys, click
from studies.cli.main import main
for arguments in {calls!r}:
    if len(arguments) == 1:
        main.get_command(click.Context(main), arguments[0])
    else:
        try: main(arguments, 'gyrocal')
        except SystemExit as end: assert end.code == 2, arguments
    print(arguments[0], [name for name in {names!r} if name in sys.modules])
"""


def run_fresh(calls, names):
    """Modules of the names that are loaded after each call, and the errors; a call of one word only loads its command."""
    arguments = [sys.executable, "-c", LOADED.format(calls=calls, names=names)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, cwd=ROOT)
    return done.stdout.splitlines(), done.stderr.splitlines()


def test_no_command_module_loads_what_is_heavy():
    """Of what is looked for, only click is there, which shows that the look finds what is loaded."""
    loaded = [f"{name} ['click']" for name in COMMAND_NAMES]
    assert run_fresh([[name] for name in COMMAND_NAMES], (*HEAVY, "click")) == (loaded, [])


def test_what_the_options_list_is_what_there_is():
    assert (tuple(MISSION_EFFECTS), get_args(Mounting), PERIODS) == (
        mission.EFFECT_NAMES,
        mission.MOUNTING_NAMES,
        mission.PERIODS,
    )
    assert (mission.DAY, reproduce.DAYS) == (DAY, DAYS)
    assert (compare.BASELINE, compare.FEWEST_FLIGHTS) == (comparison.BASELINE, comparison.FEWEST_FLIGHTS)
    assert reproduce.PAPER_FOLDERS == {"natanson": REPRODUCTION_FOLDER, "robertson": MISSION_FOLDER}
