"""The three steps, each to be run in a process of its own. What a folder holds:

- ``sealed/``: ``spec.json`` and ``answers.json`` (answers and salts); the second step never opens it
- ``recordings/case-000017/``: what the diagnosis sees
- ``seals.json``: a seal for each case, and the effects its diagnosis may name; written before any diagnosis
- ``results/case-000017.json``: a diagnosis, with the SHA-256 of the seals it came after
- ``scores.json``: what the third step counted from

Every file is written atomically, and what is there already is not made again, so that a step that was stopped goes on.
"""

import hashlib
import json
import os
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from diagnosis.diagnose import diagnose
from diagnosis.model.prepare import prepare
from gyrocal.errors import InputError
from gyrocal.recording import load, save
from simulator.effects import EFFECTS
from studies.validation.blind_check import seal
from studies.validation.blind_check.cases import Spec, draw
from studies.validation.blind_check.reach import true_closed
from studies.validation.blind_check.score import Scores, case_row, scored

Told = Callable[[int], None]

SHOWN_FINDINGS = 3  # kept of a diagnosis, which may have hundreds
REACH_SNR = 12.0  # closure is compared with what the truth reaches from here on
DIAGNOSIS_SEED = 0  # the diagnosis' own draws must not depend on the cases'


def make(folder: Path, spec: Spec, jobs: int = 1, told: Told = lambda done: None) -> Path:
    """Step one: draw the cases, write the recordings, seal the answers.

    Parameters
    ----------
    folder : to write
    spec : what to draw
    jobs : worker processes
    told : called with the number of cases done

    Returns
    -------
    The published seals.

    Raises
    ------
    InputError
        The folder holds other cases, or a case cannot be drawn.
    """
    sealed = folder / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    text = json.dumps(spec.model_dump(mode="json"), sort_keys=True)
    place = sealed / "spec.json"
    if place.exists() and place.read_text() != text:
        raise InputError(f"{folder}: holds a blind check with other settings; choose another folder")
    _write(place, text)
    _each(make_case, folder, [case for case in range(spec.cases) if not _sealed(folder, case).exists()], spec.cases, jobs, told)
    if (folder / "seals.json").exists():
        return folder / "seals.json"
    answers = {str(case): json.loads(_sealed(folder, case).read_text()) for case in range(spec.cases)}
    _write(sealed / "answers.json", json.dumps(answers))
    published = {
        "format": 1,
        "seal": "SHA-256 of salt, line feed, answer as JSON with sorted keys and without blanks",
        "seals": {case: seal.seal(one["answer"], one["salt"]) for case, one in answers.items()},
        "nameable": {case: one["nameable"] for case, one in answers.items()},
    }
    _write(folder / "seals.json", json.dumps(published, indent=1))
    return folder / "seals.json"


def make_case(folder: Path, case: int) -> None:
    """Write one recording and its answer with a salt."""
    spec = Spec.model_validate_json((folder / "sealed" / "spec.json").read_text())
    drawn = draw(spec, case)
    save(drawn.recording(), _recording(folder, case))
    one = {"answer": drawn.answer, "salt": seal.new_salt(), "nameable": drawn.nameable}
    _sealed(folder, case).parent.mkdir(parents=True, exist_ok=True)
    _write(_sealed(folder, case), json.dumps(one))


def diagnose_all(folder: Path, jobs: int = 1, told: Told = lambda done: None) -> None:
    """Step two: diagnose every recording whose seal is published.

    Parameters
    ----------
    folder : made by `make`; its sealed part may be gone
    jobs, told : as for `make`

    Raises
    ------
    InputError
        The seals are not published yet.
    """
    if not (folder / "seals.json").exists():
        raise InputError(f"{folder}: there are no published seals, and nothing may be diagnosed before")
    (folder / "results").mkdir(exist_ok=True)
    cases = sorted(map(int, json.loads((folder / "seals.json").read_text())["seals"]))
    _each(diagnose_case, folder, [case for case in cases if not _result(folder, case).exists()], len(cases), jobs, told)


def diagnose_case(folder: Path, case: int) -> None:
    """Diagnose one recording; a failure is a result too."""
    published = (folder / "seals.json").read_bytes()
    nameable = json.loads(published)["nameable"][str(case)]
    result: dict[str, Any] = {"case": case, "seals_sha256": hashlib.sha256(published).hexdigest(), "error": ""}
    try:
        found = diagnose(load(_recording(folder, case)), seed=DIAGNOSIS_SEED, library=nameable).to_json()
        found["where"] = found["where"][:SHOWN_FINDINGS]
        result["diagnosis"] = found
    except Exception as error:
        result["error"] = f"{type(error).__name__}: {error}"
        result["traceback"] = traceback.format_exc()
    _write(_result(folder, case), json.dumps(_plain(result)))


def score(folder: Path, jobs: int = 1, told: Told = lambda done: None) -> Scores:
    """Step three: open the answers, check every seal, count.

    Parameters
    ----------
    folder : with the first two steps done
    jobs, told : as for `make`

    Raises
    ------
    InputError
        A seal does not fit its answer, a result came before the seals, or one is missing.
    """
    opened = open_answers(folder)
    results = _results(folder, list(opened))
    reaching = [case for case in opened if _worth_reaching(opened[case], results[case])]
    run = joblib.Parallel(n_jobs=jobs, return_as="generator")
    reached: dict[int, float] = {}
    for case, value in run(joblib.delayed(_reach)(folder, opened[case]) for case in reaching):
        reached[case] = value
        told(len(reached))
    rows = [case_row(opened[case], results[case], reached.get(case)) for case in opened]
    made = scored(pd.DataFrame(rows))
    _write(folder / "scores.json", json.dumps({"rows": _plain(rows)}))
    return made


def open_answers(folder: Path) -> dict[int, dict[str, Any]]:
    """The answers by case, every one checked against its published seal first."""
    sealed = json.loads((folder / "sealed" / "answers.json").read_text())
    seal.check(json.loads((folder / "seals.json").read_text())["seals"], sealed)
    return {int(case): one["answer"] for case, one in sealed.items()}


def _results(folder: Path, cases: Iterable[int]) -> dict[int, dict[str, Any]]:
    sha256 = hashlib.sha256((folder / "seals.json").read_bytes()).hexdigest()
    out = {}
    for case in cases:
        if not _result(folder, case).exists():
            raise InputError(f"case {case}: has no diagnosis yet")
        out[case] = json.loads(_result(folder, case).read_text())
        if out[case]["seals_sha256"] != sha256:
            raise InputError(f"case {case}: was not diagnosed under the published seals")
    return out


def _worth_reaching(answer: dict[str, Any], result: dict[str, Any]) -> bool:
    """Whether the closure of this case is compared with what the truth reaches: a single effect with columns, named."""
    effects = answer["effects"]
    if len(effects) != 1 or answer["kind"] != "one" or result["error"]:
        return False
    one, found = effects[0], result["diagnosis"]
    named = found["closure"] is not None and [cause["effect"] for cause in found["causes"]] == [one["effect"]]
    return bool(named and EFFECTS[one["effect"]].has_columns and one["snr"] and one["snr"] >= REACH_SNR)


def _reach(folder: Path, answer: dict[str, Any]) -> tuple[int, float]:
    """What the truth reaches in a case, for which its simulation is repeated."""
    case = int(answer["case"])
    with threadpool_limits(1):
        drawn = draw(Spec.model_validate_json((folder / "sealed" / "spec.json").read_text()), case)
        if json.loads(seal.canonical(drawn.answer)) != answer:
            raise InputError(
                f"case {case}: the program has changed since it was drawn, and its truth cannot be simulated again"
            )
        model = prepare(drawn.recording()).model
        response = drawn.world.response(drawn.settings)
        return case, true_closed(model, response) if response.size == model.size else float("nan")


def _each(work: Callable[[Path, int], None], folder: Path, cases: list[int], total: int, jobs: int, told: Told) -> None:
    """Work on cases in processes of their own, one BLAS thread each."""
    told(total - len(cases))
    run = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)
    for done, _ in enumerate(run(joblib.delayed(_calm)(work, folder, case) for case in cases), start=1):
        told(total - len(cases) + done)


def _calm(work: Callable[[Path, int], None], folder: Path, case: int) -> None:
    with threadpool_limits(1):
        work(folder, case)


def _sealed(folder: Path, case: int) -> Path:
    return folder / "sealed" / "cases" / f"case-{case:06d}.json"


def _recording(folder: Path, case: int) -> Path:
    return folder / "recordings" / f"case-{case:06d}"


def _result(folder: Path, case: int) -> Path:
    return folder / "results" / f"case-{case:06d}.json"


def _write(path: Path, text: str) -> None:
    part = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def _plain(value: Any) -> Any:
    """Plain JSON: numpy scalars as numbers, what is not finite as null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value
