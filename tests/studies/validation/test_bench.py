"""The bench: a fixed set, stages that are taken over only from the same code, and a paired comparison."""

import json
import re

import pandas as pd
import pytest

from diagnosis.diagnose import diagnose
from gyrocal.errors import InputError
from studies import catalogue
from studies.montecarlo.study import load_config
from studies.validation.world import bench, stages
from studies.validation.world.cases import draw
from studies.validation.world.instruments import draw_instrument
from studies.validation.world.world import Spec
from tests import ROOT


def test_the_set_is_fixed_and_a_hundred_of_it_are_fresh():
    config = load_config(bench.STUDY)
    parts = [config.part(number) for number in range(config.cases)]
    assert len(parts) >= 240
    assert len(set(parts)) == len(parts)
    assert sum(source == bench.FRESH for source, *_ in parts) == 100


def row(case, kind, outcome, source="known", **more):
    values = {
        "case": case, "source": source, "kind": kind, "effects": "e", "outcome": outcome, "said": outcome, "diagnose_s": 10.0,
        "peak_mb": 500.0, "stored": "",
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


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="gyrocal bench run"):
        bench.load_run(tmp_path)


def answer_of(timed):
    return json.dumps({key: value for key, value in timed.answer.items() if key != "runtime_s"}, default=str)


def test_a_stored_stage_gives_the_same_answer_and_only_to_the_same_code(tmp_path, monkeypatch):
    recording = draw(Spec("known", 7), 5, "single", "slow_drift").recording()
    plain = diagnose(recording, seed=stages.SEED).to_json()
    first = stages.diagnose_in_stages(recording, tmp_path, "one")
    again = stages.diagnose_in_stages(recording, tmp_path, "one")
    assert (first.stored, again.stored) == ("", "attitude")
    assert answer_of(first) == answer_of(again) == json.dumps({k: v for k, v in plain.items() if k != "runtime_s"}, default=str)
    assert again.cpu_s < 0.5 * first.cpu_s
    assert first.peak_mb > 100
    real = stages.stage_hash
    monkeypatch.setattr(stages, "stage_hash", lambda stage: "changed" if stage == "attitude" else real(stage))
    assert stages.diagnose_in_stages(recording, tmp_path, "one").stored == "samples"
    monkeypatch.setattr(stages, "stage_hash", lambda stage: "new")
    assert stages.diagnose_in_stages(recording, tmp_path, "one").stored == ""


def test_other_instruments_are_diagnosed_as_a_whole(tmp_path):
    timed = stages.diagnose_in_stages(draw_instrument(5, 1).recording, tmp_path, "one")
    assert timed.stored == ""
    assert timed.answer["verdict"] in ("named", "group")
    assert not list(tmp_path.iterdir())


def test_no_stage_imports_what_it_does_not_hash():
    for stage, later in stages.LATER.items():
        names = "|".join(name.replace("/", r"\.") for name in later if name != "__init__")
        imported = re.compile(rf"^\s*from diagnosis(?:\.({names})\b| import)", re.MULTILINE)
        for path in (ROOT / "diagnosis").rglob("*.py"):
            name = path.relative_to(ROOT / "diagnosis").with_suffix("").as_posix()
            if not name.startswith(later) and not name.endswith("__init__"):
                assert not imported.search(path.read_text()), (stage, name)
    assert stages.stage_hash("samples") != stages.stage_hash("attitude")


def test_an_installed_package_says_where_the_test_world_is(monkeypatch):
    monkeypatch.setitem(catalogue.MODULES, "bench", "studies.validation.world.not_there")
    with pytest.raises(InputError, match="run it from a checkout"):
        catalogue.load_module("bench")
