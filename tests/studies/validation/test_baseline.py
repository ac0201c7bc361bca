"""CI regression of recovered parameters: ``gyrocal baseline`` shows what moved, ``gyrocal baseline --write`` accepts it."""

from dataclasses import replace

import pandas as pd
import pytest

from gyrocal import CalibrationResult, GyroParameters, RecursiveCalibrator, calibrate
from gyrocal.calibration.davenport import Accumulation
from gyrocal.calibration.problem import Problem
from studies.validation import baseline
from tests import ROOT

STORED = ROOT / "results" / "baseline" / "recovered.csv"


@pytest.fixture(scope="module")
def recovered():
    return baseline.estimate_baseline_parameters()


def test_recovered_parameters_are_those_of_the_baseline(recovered):
    stored = baseline.read_baseline(STORED)
    assert baseline.find_changed_values(stored, recovered).empty
    values = [column for column in recovered.columns if column not in baseline.BASELINE_KEYS]
    pd.testing.assert_frame_equal(stored[values], recovered[values], rtol=baseline.RTOL, atol=0)


def test_a_small_change_is_seen():
    stored = baseline.read_baseline(STORED)
    changed = stored.copy()
    changed.loc[2, "second_b_x_deg_h"] *= 1 + 2 * baseline.RTOL
    table = baseline.find_changed_values(stored, changed)
    assert table["quantity"].tolist() == ["second_b_x_deg_h"]
    assert baseline.find_changed_values(stored, stored).empty
    assert not baseline.find_changed_values(stored, stored.head(3)).empty


def longer(parameters, start):
    """Parameters whose step from the start is longer by 1e-6 of itself."""
    return GyroParameters.from_vector(parameters.vector + 1e-6 * (parameters.vector - start.vector))


def recursive(patch):
    solve = RecursiveCalibrator.solve

    def slipped(self):
        parameters, P = solve(self)
        return longer(parameters, self.parameters), P

    patch.setattr(RecursiveCalibrator, "solve", slipped)


def function(patch):
    def slipped(*arguments, **options):
        result = calibrate(*arguments, **options)
        return replace(result, parameters=longer(result.parameters, result.initial))

    patch.setattr(baseline, "calibrate", slipped)


def document(patch):
    to_json = CalibrationResult.to_json

    def slipped(self):
        return to_json(replace(self, parameters=longer(self.parameters, self.initial)))

    patch.setattr(CalibrationResult, "to_json", slipped)


def step(patch):
    """The step of `calibrate()` itself, and of what is built on its sums."""
    solve = Accumulation.solve
    patch.setattr(Accumulation, "solve", lambda self: ((1 + 1e-6) * solve(self)[0], solve(self)[1]))


@pytest.mark.parametrize(
    ("slip", "ways"),
    [
        (function, {"calibrate()"}),
        (document, {"gyrocal calibrate"}),
        (recursive, {"RecursiveCalibrator"}),
        (step, set(baseline.WAYS)),
    ],
)
def test_a_step_longer_by_a_millionth_is_seen_in_any_way(slip, ways, monkeypatch):
    stored = baseline.read_baseline(STORED)
    slip(monkeypatch)
    for way in ways:
        old = stored[stored["way"] == way].reset_index(drop=True)
        table = baseline.find_changed_values(old, baseline.run_estimator(way))
        assert set(table["parametrisation"]) == {"gain", "gyro"}
        assert table["quantity"].str.startswith("first_").sum() > 12


def test_a_step_of_the_compiled_iterations_longer_by_a_millionth_is_seen(monkeypatch):
    iterate = Problem.iterate

    def slipped(self, *arguments, **options):
        found = iterate(self, *arguments, **options)
        return replace(found, x=found.x + 1e-6 * (found.x - found.x[0]))

    monkeypatch.setattr(Problem, "iterate", slipped)
    stored = baseline.read_baseline(STORED)
    old = stored[stored["way"] == baseline.COMPILED].reset_index(drop=True)
    assert len(baseline.find_changed_values(old, baseline.run_compiled_iterations())) > 100


def test_command_shows_what_moved(run_cli, tmp_path, recovered, monkeypatch):
    monkeypatch.setattr(baseline, "estimate_baseline_parameters", lambda: recovered)
    path = tmp_path / "recovered.csv"
    missing = run_cli("baseline", "--file", str(path))
    assert missing.exit_code == 2
    stored = baseline.read_baseline(STORED)
    stored.loc[0, "nees"] *= 1.1
    baseline.write_baseline(stored, path)
    shown = run_cli("baseline", "--file", str(path))
    assert shown.exit_code == 1
    assert "nees" in shown.stdout
    assert run_cli("baseline", "--file", str(path), "--write").exit_code == 0
    assert baseline.find_changed_values(baseline.read_baseline(STORED), baseline.read_baseline(path)).empty
