"""The soak with few cases; a million with ``python -m tests.soak``."""

from studies.montecarlo.engine import run
from studies.montecarlo.study import load_config
from tests.soak.run import Runs, disturbed, joined
from tests.soak.study import STUDY

CASES = 1200


def test_a_study_killed_at_random_and_two_halves_are_the_undisturbed_one(tmp_path):
    whole = Runs(tmp_path / "whole")
    run(STUDY, load_config(STUDY, changes={"cases": CASES}), whole.folder, backend="serial")
    killed = disturbed(tmp_path / "killed", CASES, 20.0, 55)  # after two seconds, and then not within a minute
    assert killed.kills >= 1
    halves = joined(tmp_path / "joined", killed, whole, CASES)
    assert whole.sha256 == killed.sha256 == halves.sha256
    assert killed.memory_of_the_longest()[1] > 0
