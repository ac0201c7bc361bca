"""CI regression of recovered parameters: ``gyrocal baseline`` shows what moved, ``gyrocal baseline --write`` accepts it."""

from dataclasses import replace

import pandas as pd
import pytest

from gyrocal import GyroParameters, RecursiveCalibrator, calibrate
from gyrocal.calibration.problem import Problem
from studies import baseline
from studies.montecarlo.study import Streams
from studies.validation import recovered
from tests import ROOT

STORED = ROOT / "results" / "baseline" / "expected" / "recovered.csv"


def run_way(way):
    """Rows of a way as the stored ones."""
    config = recovered.RecoveredConfig(ways=(way,))
    return pd.DataFrame(recovered.run_way(config, 0, Streams(config.entropy, 0)))


def read_way(way):
    rows = baseline.read_rows(STORED)
    return rows[rows["way"] == way].drop(columns=["case", "error"]).reset_index(drop=True)


@pytest.mark.parametrize("way", [recovered.COMPILED, *recovered.WAYS])
def test_recovered_parameters_are_those_of_the_baseline(way):
    old, new = read_way(way), run_way(way)
    assert baseline.find_changed_values(old, new).empty
    values = [column for column in new.columns if column not in recovered.KEYS]
    pd.testing.assert_frame_equal(old[values], new[values], rtol=baseline.RTOL, atol=0)


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

    patch.setattr(recovered, "calibrate", slipped)


@pytest.mark.parametrize(("slip", "way"), [(function, "calibrate()"), (recursive, "RecursiveCalibrator")])
def test_a_step_longer_by_a_millionth_is_seen_in_any_way(slip, way, monkeypatch):
    slip(monkeypatch)
    table = baseline.find_changed_values(read_way(way), run_way(way))
    assert set(table["parametrisation"]) == {"gain", "gyro"}
    assert table["quantity"].str.startswith("first_").sum() > 12


def test_a_step_of_the_compiled_iterations_longer_by_a_millionth_is_seen(monkeypatch):
    iterate = Problem.iterate

    def slipped(self, *arguments, **options):
        found = iterate(self, *arguments, **options)
        return replace(found, x=found.x + 1e-6 * (found.x - found.x[0]))

    monkeypatch.setattr(Problem, "iterate", slipped)
    assert len(baseline.find_changed_values(read_way(recovered.COMPILED), run_way(recovered.COMPILED))) > 100
