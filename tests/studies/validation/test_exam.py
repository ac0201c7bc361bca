"""An exam holds only if its seal was committed before its answers, and its answers were made by a clean commit after that."""

import json
import shutil
import subprocess

import pytest

from gyrocal.errors import InputError
from studies.montecarlo.manifest import hash_bytes
from studies.validation.exam import steps
from tests import ROOT

EXAM = ROOT / "studies" / "validation" / "exam" / "001"


def git(folder, *arguments):
    identity = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    done = subprocess.run(["git", *identity, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def commit(folder, *files):
    git(folder, "add", *files)
    git(folder, "commit", "-q", "-m", "one")
    return git(folder, "rev-parse", "HEAD")


@pytest.fixture
def taken(tmp_path):
    """A repository with a seal, and the answers made by that commit in a later one; files of exam 001."""
    root = tmp_path / "exam"
    shutil.copytree(EXAM, root / "001", ignore=shutil.ignore_patterns("__pycache__"))
    git(tmp_path, "init", "-q")
    answers = json.loads((root / "001" / "answers.json").read_text())
    sealed_at = commit(tmp_path, *[f"exam/001/{file}" for file in (*steps.GENERATOR, "seal.json")])
    save_answers(root, answers | {"commit": sealed_at})
    commit(tmp_path, *[f"exam/001/{file}" for file in ("keys.json", "answers.json", "score.json")])
    return root


def save_answers(root, answers):
    (root / "001" / "answers.json").write_text(json.dumps(answers))
    (root / "001" / "score.json").write_text(json.dumps(steps.score_exam(root / "001")))


def faults(root):
    return " ".join(steps.verify("001", root))


def test_an_exam_that_was_sealed_before_it_was_taken_holds(taken):
    assert steps.verify("001", taken) == []


def test_seal_and_answers_in_one_commit_do_not_hold(tmp_path):
    shutil.copytree(EXAM, tmp_path / "exam" / "001", ignore=shutil.ignore_patterns("__pycache__"))
    git(tmp_path, "init", "-q")
    commit(tmp_path, ".")
    assert "share a commit" in faults(tmp_path / "exam")


def test_answers_of_a_commit_before_the_seal_do_not_hold(tmp_path):
    root = tmp_path / "exam"
    shutil.copytree(EXAM, root / "001", ignore=shutil.ignore_patterns("__pycache__"))
    git(tmp_path, "init", "-q")
    (tmp_path / "code.py").write_text("x = 1\n")
    before = commit(tmp_path, "code.py")
    commit(tmp_path, *[f"exam/001/{file}" for file in (*steps.GENERATOR, "seal.json")])
    save_answers(root, json.loads((root / "001" / "answers.json").read_text()) | {"commit": before})
    commit(tmp_path, ".")
    assert "older than the seal" in faults(root)


def test_answers_of_a_checkout_with_changes_do_not_hold(taken):
    answers = json.loads((taken / "001" / "answers.json").read_text())
    save_answers(taken, answers | {"commit": answers["commit"] + "+changes"})
    assert "with changes" in faults(taken)


def test_other_keys_and_another_score_do_not_hold(taken):
    score = json.loads((taken / "001" / "score.json").read_text())
    (taken / "001" / "score.json").write_text(json.dumps(score | {"recordings": 1}))
    assert "the score is not" in faults(taken)
    keys = (taken / "001" / "keys.json").read_text()
    (taken / "001" / "keys.json").write_text(keys + " ")
    assert "not those whose hash" in faults(taken)


def test_a_generator_that_was_changed_before_the_answers_does_not_hold(tmp_path):
    root = tmp_path / "exam"
    shutil.copytree(EXAM, root / "001", ignore=shutil.ignore_patterns("__pycache__"))
    git(tmp_path, "init", "-q")
    sealed_at = commit(tmp_path, *[f"exam/001/{file}" for file in (*steps.GENERATOR, "seal.json")])
    (root / "001" / "plans.py").write_text("KINDS = {}\n")
    save_answers(root, json.loads((root / "001" / "answers.json").read_text()) | {"commit": sealed_at})
    commit(tmp_path, ".")
    assert "plans.py was changed" in faults(root)


def test_what_is_no_exam_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such exam"):
        steps.verify("999", tmp_path)
    with pytest.raises(InputError, match="sealed already"):
        steps.seal("001", 1, 1, 1)
    with pytest.raises(InputError, match="taken already"):
        steps.take("001", 1, tmp_path)


@pytest.mark.usefixtures("small_plans_only")
def test_keys_of_a_small_exam_are_the_same_again(tmp_path):
    folder = tmp_path / "001"
    folder.mkdir()
    for file in steps.GENERATOR:
        shutil.copy(EXAM / file, folder / file)
    path = steps.seal("001", 3, 2, 1, tmp_path)
    sealed = json.loads(path.read_text())
    assert sealed["drawn"] == 2
    assert sealed["keys_sha256"] == hash_bytes(steps.format_keys(steps.draw_exam_keys("001", 3, 2, 1)).encode())
    assert sealed["generator_sha256"]["plans.py"] == hash_bytes((folder / "plans.py").read_bytes())
