"""Sealing, taking, scoring and verifying an exam."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from gyrocal.errors import InputError
from studies.montecarlo import engine
from studies.montecarlo.files import convert_to_plain, write_csv, write_json
from studies.montecarlo.manifest import collect_versions, hash_bytes, read_commit
from studies.validation.world import score
from studies.validation.world.answers import compute_calibration_errors, label_effect
from studies.validation.world.cases import draw_world_case
from studies.validation.world.report import count_outcomes
from studies.validation.world.study import STUDY, WorldConfig, describe_answer
from studies.validation.world.world import Spec

EXAM_FOLDER = Path(__file__).parent
RELIABILITY = EXAM_FOLDER.parents[1] / "data" / "reliability.csv"  # what the page of a diagnosis quotes
GENERATOR = ("families.py", "plans.py")
SEAL, KEYS, ANSWERS, SCORE = "seal.json", "keys.json", "answers.json", "score.json"
KEY_DIGITS = 9  # of a number in the keys, so that another machine's last bits do not change their hash
ANSWER_FIELDS = ("verdict", "gap", "causes", "unknown_probability", "posterior", "closure", "calibration")


def find_exam_folder(name: str, root: Path = EXAM_FOLDER) -> Path:
    """Find the folder of an exam.

    Raises
    ------
    InputError
        There is none of that name, or it has no generator.
    """
    folder = root / name
    if not all((folder / file).exists() for file in GENERATOR):
        there = sorted(path.parent.name for path in root.glob("*/plans.py"))
        raise InputError(f"exam {name}: no such exam; there are {', '.join(there) or 'none'}")
    return folder


def draw_exam_keys(name: str, entropy: int, cases: int, jobs: int) -> list[dict[str, Any]]:
    """Draw what is in each recording of an exam; a case that cannot be drawn says why."""
    return list(Parallel(n_jobs=jobs)(delayed(_draw_key)(name, entropy, case) for case in range(cases)))


def _draw_key(name: str, entropy: int, case: int) -> dict[str, Any]:
    try:
        drawn = draw_world_case(Spec(f"exam/{name}", entropy), case)
    except InputError as error:
        return {"case": case, "error": str(error)}
    outside = drawn.settings[-1] if drawn.kind in ("unlisted", "mixed") else None
    key = {
        "case": case,
        "kind": drawn.kind,
        "plan": drawn.world.kind,
        "grade": drawn.world.grade,
        "snr": min(drawn.snr, default=np.nan),
        "attitude_snr": np.nan if outside is None else drawn.world.compute_attitude_evidence(outside),
        "novelty": drawn.novelty,
        "truth": drawn.truth(),
        "G": drawn.world.plan.G,
        "bias_deg_s": np.rad2deg(drawn.world.plan.bias),
    }
    return dict(_round_numbers(convert_to_plain(key)))


def _round_numbers(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _round_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_round_numbers(item) for item in value]
    return float(f"{value:.{KEY_DIGITS}g}") if isinstance(value, float) else value


def format_keys(keys: Sequence[dict[str, Any]]) -> str:
    """Write keys as the text whose hash is sealed."""
    return json.dumps(keys, separators=(",", ":"), sort_keys=True) + "\n"


def seal(name: str, entropy: int, cases: int, jobs: int, root: Path = EXAM_FOLDER) -> Path:
    """Draw the cases of an exam and write its seal; returns its path.

    Raises
    ------
    InputError
        There is no such exam, or it is sealed already.
    """
    folder = find_exam_folder(name, root)
    path = folder / SEAL
    if path.exists():
        raise InputError(f"{path}: the exam is sealed already")
    keys = draw_exam_keys(name, entropy, cases, jobs)
    about = {
        "exam": name,
        "entropy": entropy,
        "cases": cases,
        "drawn": sum("error" not in one for one in keys),
        "keys_sha256": hash_bytes(format_keys(keys).encode()),
        "generator_sha256": {file: hash_bytes((folder / file).read_bytes()) for file in GENERATOR},
    }
    write_json(path, about)
    return path


def take(
    name: str, jobs: int, work: Path, progress: engine.Display = engine.show_no_progress, root: Path = EXAM_FOLDER
) -> Path:
    """Diagnose every recording of a sealed exam once, and write keys, answers and score; returns the path of the score.

    Parameters
    ----------
    name : of the exam
    jobs : worker processes
    work : folder of the rows, where a run that was stopped goes on
    progress : shown while it runs

    Raises
    ------
    InputError
        The exam is not sealed, was taken already, the checkout has changes, or the keys are not those that were sealed.
    """
    folder = find_exam_folder(name, root)
    if not (folder / SEAL).exists():
        raise InputError(f"exam {name}: has no seal; make one with 'gyrocal exam seal {name}' and commit it")
    if (folder / ANSWERS).exists():
        raise InputError(f"exam {name}: was taken already; an exam is taken once")
    made_by = read_commit()
    if made_by is None or "+" in made_by:
        raise InputError("an exam is taken from a clean checkout of a commit; commit or stash what has changed")
    sealed = json.loads((folder / SEAL).read_text())
    keys = draw_exam_keys(name, sealed["entropy"], sealed["cases"], jobs)
    if hash_bytes(format_keys(keys).encode()) != sealed["keys_sha256"]:
        raise InputError(f"exam {name}: the cases drawn are not those that were sealed; the program or the libraries differ")
    config = WorldConfig(cases=sealed["cases"], entropy=sealed["entropy"], source=f"exam/{name}", keep_answer=True)
    outcome = engine.run(STUDY, config, work, jobs=jobs, progress=progress)
    rows = outcome.load()
    good = rows[rows["error"] == ""]
    found = {int(row["case"]): json.loads(row["answer"]) for row in good.to_dict("records")}
    answers = {
        "exam": name,
        "commit": made_by,
        "versions": collect_versions(),
        "answers": [{"case": case, **{key: answer[key] for key in ANSWER_FIELDS}} for case, answer in sorted(found.items())],
        "failed": {int(case): error for case, error in outcome.failures.items()},
        "cpu_s": round(float(good["diagnose_s"].sum()), 1),
    }
    (folder / KEYS).write_text(format_keys(keys))
    (folder / ANSWERS).write_text(json.dumps(_round_numbers(convert_to_plain(answers)), separators=(",", ":")) + "\n")
    write_json(folder / SCORE, score_exam(folder))
    write_csv(RELIABILITY, pool_reliability(root))
    return folder / SCORE


def build_exam_rows(folder: Path) -> pd.DataFrame:
    """Make the rows of an exam's cases from its keys and answers."""
    keys = {one["case"]: one for one in json.loads((folder / KEYS).read_text())}
    answers = json.loads((folder / ANSWERS).read_text())["answers"]
    rows = []
    for answer in answers:
        key = keys[answer["case"]]
        row = {name: key[name] for name in ("case", "kind", "plan", "grade", "snr", "attitude_snr", "novelty")}
        row |= {
            "truth": json.dumps(key["truth"]),
            "calibration_sigmas": json.dumps(compute_calibration_errors(answer, key["G"], key["bias_deg_s"])),
        }
        row["effects"] = " + ".join(label_effect(one["effect"], one["axis"]) for one in key["truth"])
        rows.append(row | describe_answer(key["kind"], key["truth"], answer))
    numbers = ["snr", "attitude_snr", "novelty", "closed", "closed_low", "closed_high", "probability"]
    return pd.DataFrame(rows).astype(dict.fromkeys(numbers, float))


def score_exam(folder: Path) -> dict[str, Any]:
    """Score an exam from its keys and answers."""
    rows, answers = build_exam_rows(folder), json.loads((folder / ANSWERS).read_text())
    stated = score.compute_reliability(score.collect_cause_statements(rows))
    rates = score.compute_outcome_rates(rows)
    found = {
        "exam": folder.name,
        "commit": answers["commit"],
        "recordings": len(rows),
        "failed": len(answers["failed"]),
        "cpu_s": answers["cpu_s"],
        "rates": rates[rates["cases"] > 0].to_dict("records"),
        "outcomes": count_outcomes(rows).to_dict("records"),
        "calibration_error": score.compute_calibration_error(stated),
        "reliability": stated.to_dict("records"),
    }
    return dict(_round_numbers(convert_to_plain(found)))


def pool_reliability(root: Path = EXAM_FOLDER) -> pd.DataFrame:
    """Pool all exams' stated probabilities: how often the cause was there, as the page of a diagnosis quotes it."""
    stated = [score.collect_cause_statements(build_exam_rows(root / name)) for name in list_taken_exams(root)]
    return score.compute_reliability(pd.concat(stated, ignore_index=True))


def verify(name: str, root: Path = EXAM_FOLDER) -> list[str]:
    """Check an exam's files against one another and against the history of the repository; returns what is wrong.

    Raises
    ------
    InputError
        There is no such exam, or no history to check it against.
    """
    folder = find_exam_folder(name, root)
    missing = [file for file in (SEAL, KEYS, ANSWERS, SCORE) if not (folder / file).exists()]
    if missing:
        return [f"{folder.name}: {', '.join(missing)} missing"]
    sealed, answers = (json.loads((folder / file).read_text()) for file in (SEAL, ANSWERS))
    faults = []
    if hash_bytes((folder / KEYS).read_bytes()) != sealed["keys_sha256"]:
        faults.append("the keys are not those whose hash was sealed")
    if json.loads((folder / SCORE).read_text()) != score_exam(folder):
        faults.append("the score is not what keys and answers give")
    if _run_git(folder, "rev-parse", "--is-shallow-repository") != "false":
        raise InputError(f"exam {name}: the history of the repository is needed to verify it; fetch all of it")
    seal_commit, answer_commit = (_find_adding_commit(folder, file) for file in (SEAL, ANSWERS))
    if not seal_commit or not answer_commit:
        return [f"{name}: {text}" for text in [*faults, "seal and answers are not both committed"]]
    made_by = answers["commit"]
    if seal_commit == answer_commit:
        faults.append("seal and answers share a commit")
    elif not _is_before(folder, seal_commit, answer_commit):
        faults.append("the answers were committed before the seal")
    if "+" in made_by:
        faults.append("the answers were made by a checkout with changes")
    elif not _is_before(folder, seal_commit, made_by):
        faults.append("the answers were made by a commit older than the seal")
    elif not _is_before(folder, made_by, answer_commit):
        faults.append("the commit that made the answers is not in their history")
    for file in GENERATOR:
        text = _run_git(folder, "show", f"{answer_commit}:./{file}", strip=False)
        if text is None or hash_bytes(text.encode()) != sealed["generator_sha256"][file]:
            faults.append(f"{file} was changed between seal and answers")
    if _run_git(folder, "diff", "--name-only", seal_commit, "HEAD", "--", SEAL, strip=True):
        faults.append("the seal was changed after its commit")
    return [f"{name}: {text}" for text in faults]


def _find_adding_commit(folder: Path, file: str) -> str:
    """Find the commit that added a file; empty if it is not committed."""
    found = _run_git(folder, "log", "--diff-filter=A", "--format=%H", "--", file) or ""
    return found.splitlines()[-1] if found else ""


def _is_before(folder: Path, first: str, then: str) -> bool:
    """Tell whether a commit is an ancestor of another one, or that one."""
    return _run_git(folder, "merge-base", "--is-ancestor", first, then) is not None


def _run_git(folder: Path, *arguments: str, strip: bool = True) -> str | None:
    """Ask git in a folder; None if it fails."""
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, check=True)
    except OSError as error:
        raise InputError(f"exams are verified against the history that git keeps: {error}") from None
    except subprocess.CalledProcessError:
        return None
    text = done.stdout.decode("utf-8", "replace")
    return text.strip() if strip else text


def list_taken_exams(root: Path = EXAM_FOLDER) -> list[str]:
    """List the exams that were taken, in their order."""
    return sorted(path.parent.name for path in root.glob(f"*/{SCORE}"))
