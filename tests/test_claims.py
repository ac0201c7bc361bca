"""README, docs and changelog claim what committed results say; each mutant that once stood there is caught."""

import json
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest

from studies.validation.exam.steps import list_taken_exams, verify
from tests import ROOT
from tests.claims import check, rerun, text
from tests.claims.registry import CLAIMS

AT = "The code is in four packages"  # a place in README


@pytest.fixture(scope="module")
def values():
    return check.values_of(ROOT)


def test_every_claim_is_what_its_result_says():
    assert [str(one) for one in check.problems(ROOT)] == []


def test_every_claim_is_made_somewhere(values):
    said = "".join(path.read_text() for path in check.pages(ROOT))
    assert set(values) == set(CLAIMS)
    assert [name for name in CLAIMS if f"<!--={name}-->" not in said and f"<!--begin {name}-->" not in said] == []


@pytest.fixture
def copy(tmp_path):
    """The pages, the results and the exams of the checkout, to be spoiled."""
    for path in check.pages(ROOT):
        place = tmp_path / path.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, place)
    kept = shutil.ignore_patterns("*.svg", "*.parquet", "__pycache__")
    for folder in ("results", "tests/claims", "studies/validation/exam"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=kept)
    return tmp_path


def spoil(root, file, old, new):
    path = root / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))


def found(root):
    return [str(one) for one in check.problems(root)]


def test_a_copy_has_no_problem(copy):
    assert found(copy) == []


def test_a_ratio_of_an_older_benchmark_is_caught(copy, values):
    """The mission loop was 63 times in the docs and 46 in the result."""
    spoil(copy, "docs/validation.md", f"{values['mission_loop']}<!--=mission_loop-->", "63 times<!--=mission_loop-->")
    assert any("mission_loop" in one for one in found(copy))
    spoil(copy, "docs/validation.md", "63 times<!--=mission_loop-->", "63 times")
    assert any("'63 times' is bound to no result" in one for one in found(copy))


def test_a_number_of_cases_without_a_result_is_caught(copy):
    """The docs had 400 scored cases where the result had 750."""
    spoil(copy, "docs/studies.md", "| `bench` | ", "| `bench` | 400 scored cases: ")
    assert any("'400 scored cases' is bound to no result" in one for one in found(copy))


def test_a_number_of_effects_without_a_result_is_caught(copy):
    """The changelog had 86 unlisted effects where the docs had 131."""
    spoil(copy, "CHANGELOG.md", "of alternatives outside the library and", "of 86 unlisted effects and")
    assert any("'86 unlisted effects' is bound to no result" in one for one in found(copy))


def test_sealed_answers_without_a_seal_are_caught(copy):
    spoil(copy, "README.md", AT, f"The answers of the test world were sealed.\n\n{AT}")
    assert any("only an exam has sealed answers" in one for one in found(copy))


def test_the_best_of_several_runs_is_caught(copy):
    """README showed the latest of three runs; every exam that was taken has its column, and none can be left out."""
    first = copy / "studies" / "validation" / "exam" / "001" / "score.json"
    again = copy / "studies" / "validation" / "exam" / "000" / "score.json"
    again.parent.mkdir()
    again.write_text(json.dumps(json.loads(first.read_text()) | {"exam": "000"}))
    said = found(copy)
    assert any("README.md" in one and "exam_history" in one for one in said)
    spoil(copy, "README.md", AT, f"It was right in 244 of 256 (95.3 %).\n\n{AT}")
    assert any("'244 of 256' is bound to no result" in one for one in found(copy))


@pytest.mark.parametrize("study", rerun.QUICK)
def test_the_present_code_makes_the_committed_rows(study):
    """Those of `rerun.SLOW` take too long here: ``python -m tests.claims --rerun heads real``."""
    assert [str(one) for one in rerun.rerun_problems(ROOT, study)] == []


def test_every_committed_study_has_cases_that_are_run_again():
    folders = [path.parent for path in (ROOT / "results" / "studies").glob("*/manifest.json")]
    assert {folder.name for folder in folders} == {*rerun.QUICK, *rerun.SLOW}
    tables = {folder.name for folder in folders if not (folder / "table.parquet").exists()}
    assert tables <= set(rerun.TABLES)  # one that is not committed may be there all the same
    paper, first = (ROOT / "results" / name / "manifest.json" for name in ("studies/paper", "reproduction"))
    assert json.loads(paper.read_text())["config"] | {"cases": 200} == json.loads(first.read_text())["config"]


def test_a_row_of_older_code_is_caught():
    """Rounding is not: a millionth of a value, and a billionth of the largest of its column."""
    table = pd.DataFrame({"case": [0, 1, 1], "x": [1e3, 1.0, np.nan], "t": ["a", "b", None], "cost_s": [1.0, 2.0, 3.0]})
    made = pd.DataFrame({"case": [1, 1], "x": [1.0 + 1e-7, None], "t": ["b", None], "cost_s": [4.0, 5.0]})
    assert rerun.differences(table, 1, made) == []
    assert rerun.differences(table, 1, made.assign(x=[1.0 + 1e-5, None])) == ["x"]
    assert rerun.differences(table, 1, made.assign(x=[1.0, 2.0], t=["b", "c"])) == ["x", "t"]
    assert rerun.differences(table, 1, made.drop(columns="x").assign(y=1.0)) == ["x", "y"]
    assert rerun.differences(table, 0, made) == ["the number of rows (2, committed 1)"]


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("right in 244 of 256 cases", ["244 of 256"]),
        ("95.3 % of them", ["95.3 %"]),
        ("with its 95 % interval and 90 % binomial intervals", []),
        ("`63 times` in code and [2 of 3](x) in text", ["2 of 3"]),
        ("46<!--=loop--> and 47", []),
        ("46 times<!--=loop_times-->", []),
        ("over 200 seeds", ["200 seeds"]),
    ],
)
def test_numbers_that_look_like_a_results(words, numbers):
    assert [number for _, number in text.unmarked(words, {"loop": "46", "loop_times": "46 times"})] == numbers


def test_values_are_written_before_their_markers_and_into_their_blocks():
    words = "| 63 times<!--=a--> | x |\n<!--begin t-->\nold\n<!--end-->"
    assert (
        text.written(words, {"a": "46 times", "t": "| new |\n"})
        == "| 46 times<!--=a--> | x |\n<!--begin t-->\n| new |\n<!--end-->"
    )


def test_the_exams_that_were_taken_hold():
    """Hashes, order of the commits, code and score of every exam, against the history of this checkout."""
    shallow = subprocess.run(["git", "rev-parse", "--is-shallow-repository"], cwd=ROOT, capture_output=True, text=True)
    if shallow.stdout.strip() != "false":
        pytest.skip("needs the whole history of the repository")
    for name in list_taken_exams():
        assert verify(name) == []
