"""The bench: a fixed set and a paired comparison."""

import pandas as pd
import pytest

from gyrocal.errors import InputError
from studies import catalogue
from studies.montecarlo.study import load_config
from studies.validation.world import bench


def test_the_set_is_fixed_and_a_hundred_of_it_are_fresh():
    config = load_config(bench.STUDY)
    parts = [config.part(number) for number in range(config.cases)]
    assert len(parts) >= 240
    assert len(set(parts)) == len(parts)
    assert sum(source == bench.FRESH for source, *_ in parts) == 100


def row(case, kind, outcome, source="known", **more):
    values = {
        "case": case, "source": source, "kind": kind, "effects": "e", "outcome": outcome, "said": outcome, "diagnose_s": 10.0,
        "peak_mb": 500.0,
    }  # fmt: skip
    return values | more


def test_two_runs_are_compared_case_by_case():
    before = [row(k, "single", "right" if k < 12 else "unknown") for k in range(20)] + [row(20, "none", "right", "fresh")]
    after = [row(k, "single", "right" if 2 <= k < 18 else "wrong name", diagnose_s=5.0) for k in range(20)]
    after += [row(20, "none", "alarm", "fresh", diagnose_s=5.0, peak_mb=250.0)]
    made = bench.compare(pd.DataFrame(before), pd.DataFrame(after))
    table = made.tables["paired"].data.set_index("kind")
    assert table.loc["single", ["gained", "lost", "good_before", "good_after"]].tolist() == [6, 2, 12, 16]
    assert table.loc["single", "p"] == pytest.approx(2 * (1 + 8 + 28) / 2**8)  # the binomial tail of 2 of 8, both sides
    assert table.loc["single", "wrong_after"] == 4
    assert table.loc["all", "cpu_ratio"] == pytest.approx(0.5)
    assert table.loc["all", "mb_ratio"] == 1.0
    assert table.loc["fresh, all", ["gained", "lost"]].tolist() == [0, 1]
    assert set(made.tables["moved"].data["source"]) == {"known"}  # of the fresh ones counts alone are shown


def test_runs_of_other_recordings_are_refused():
    one = pd.DataFrame([row(1, "none", "right")])
    with pytest.raises(InputError, match="share 0 of 1 and 1"):
        bench.compare(one, one.assign(effects="other"))


def test_a_folder_without_a_run_is_refused(tmp_path, run_cli):
    shown = run_cli("bench", "compare", str(tmp_path), str(tmp_path))
    assert shown.exit_code == 2
    assert "gyrocal bench run" in shown.stderr


def test_the_command_compares_two_runs(tmp_path, run_cli):
    one = pd.DataFrame([row(1, "none", "right")])
    one.assign(error="").to_parquet(tmp_path / "table.parquet")
    shown = run_cli("bench", "compare", str(tmp_path), str(tmp_path))
    assert shown.exit_code == 0, shown.output
    assert "gained" in shown.stdout


def test_an_installed_package_says_where_the_test_world_is(monkeypatch):
    monkeypatch.setitem(catalogue.CHECKOUT_MODULES, "bench", "studies.validation.world.not_there")
    with pytest.raises(InputError, match="run it from a checkout"):
        catalogue.load_module("bench")
