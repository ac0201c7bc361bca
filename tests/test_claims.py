"""README, docs and changelog claim what committed results say; each mutant that once stood there is caught."""

import json
import shutil
import subprocess

import pytest

from studies.validation.exam.steps import exams, verify
from tests import ROOT
from tests.claims import check, freshness, text
from tests.claims.registry import CLAIMS

AT = "It implements the Davenport"  # a place in README


@pytest.fixture(scope="module")
def values():
    return check.values_of(ROOT)


def test_every_claim_is_what_its_result_says_and_every_result_is_of_the_present_code():
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


def found(root, fresh=False):
    return [str(one) for one in check.problems(root, fresh)]


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
    spoil(copy, "CHANGELOG.md", "and effects outside the library; rates,", "and 86 unlisted effects; rates,")
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


def test_a_result_of_older_code_is_caught(copy):
    manifest = copy / "results" / "studies" / "psi" / "manifest.json"
    document = json.loads(manifest.read_text())
    assert freshness.changed_sources(manifest.parent) == []
    name = next(name for name in document["sources"] if name.startswith("gyrocal/calibration/"))
    document["sources"][name] = "0" * 16
    manifest.write_text(json.dumps(document))
    assert freshness.changed_sources(manifest.parent) == [name]
    assert any("results/studies/psi" in one and "stale" in one for one in found(copy, fresh=True))
    manifest.write_text(json.dumps({key: value for key, value in document.items() if key != "sources"}))
    assert any("no record" in one for one in freshness.changed_sources(manifest.parent))


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
    for name in exams():
        assert verify(name) == []
