"""The three steps, each to be run in a process of its own. What a folder holds:

- ``sealed/``: the first step's study, whose rows are answers and salts, and ``answers.json``; the second step never opens it
- ``recordings/case-000017/``: what the diagnosis sees
- ``seals.json``: a seal for each case, and the effects its diagnosis may name; written before any diagnosis
- ``results/``: the second step's study, whose rows are the diagnoses; its settings hold the SHA-256 of the seals
- ``reached/``: the third step's study, whose rows are what the truth reaches
- ``scores.json``: what the third step counted from

Being studies of the Monte Carlo engine, the steps go on where they were stopped.
"""

import json
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd

from diagnosis.diagnose import diagnose
from diagnosis.model.prepare import prepare
from gyrocal.errors import InputError
from gyrocal.recording import load, save
from simulator.effects import EFFECTS
from studies.montecarlo import engine
from studies.montecarlo.files import plain, write_json, write_text
from studies.montecarlo.manifest import MANIFEST, digest
from studies.montecarlo.study import GridConfig, Streams, Study, StudyConfig
from studies.validation.blind_check import seal
from studies.validation.blind_check.cases import Spec, draw
from studies.validation.blind_check.reach import true_closed
from studies.validation.blind_check.score import Scores, case_row, scored

SHOWN_FINDINGS = 3  # kept of a diagnosis, which may have hundreds
REACH_SNR = 12.0  # closure is compared with what the truth reaches from here on
DIAGNOSIS_SEED = 0  # the diagnosis' own draws must not depend on the cases'


class MakeConfig(StudyConfig):
    """Settings of the first step: the folder, and what to draw."""

    folder: str
    spec: Spec


class DiagnoseConfig(StudyConfig):
    """Settings of the second step: the folder, and the hash of the seals that were published before."""

    folder: str
    seals_sha256: str


class ReachConfig(GridConfig):
    """Settings of the third step: the folder, what was drawn, and which cases' closure is compared with the truth's."""

    axes: ClassVar = ("wanted",)
    folder: str
    spec: Spec
    wanted: tuple[int, ...]


def make(folder: Path, spec: Spec, jobs: int = 1, shown: engine.Display = engine.silent) -> Path:
    """Step one: draw the cases, write the recordings, seal the answers.

    Parameters
    ----------
    folder : to write
    spec : what to draw
    jobs : worker processes
    shown : progress, as of `engine.run`

    Returns
    -------
    The published seals.

    Raises
    ------
    InputError
        The folder holds other cases.
    GyrocalError
        A case cannot be drawn.
    """
    config = MakeConfig(cases=spec.cases, entropy=spec.entropy, scenario=spec.base, folder=_absolute(folder), spec=spec)
    rows = _run(MAKE, config, folder / "sealed", jobs, shown)
    published = folder / "seals.json"
    if not published.exists():
        answers = {str(case): json.loads(one) for case, one in zip(rows["case"], rows["sealed"], strict=True)}
        write_text(folder / "sealed" / "answers.json", json.dumps(answers))
        document = {
            "format": 1,
            "seal": "SHA-256 of salt, line feed, answer as JSON with sorted keys and without blanks",
            "seals": {case: seal.seal(one["answer"], one["salt"]) for case, one in answers.items()},
            "nameable": {case: one["nameable"] for case, one in answers.items()},
        }
        write_text(published, json.dumps(document, indent=1))
    return published


def make_case(config: MakeConfig, case: int, streams: Streams) -> dict[str, str]:
    """Write one recording; its answer with a salt, which nobody can foresee."""
    drawn = draw(config.spec, case)
    save(drawn.recording(), _recording(Path(config.folder), case))
    return {"sealed": json.dumps({"answer": drawn.answer, "salt": seal.new_salt(), "nameable": drawn.nameable})}


def diagnose_all(folder: Path, jobs: int = 1, shown: engine.Display = engine.silent) -> None:
    """Step two: diagnose every recording whose seal is published; a diagnosis that fails is a result too.

    Parameters
    ----------
    folder : made by `make`; its sealed part may be gone
    jobs, shown : as for `make`

    Raises
    ------
    InputError
        The seals are not published yet.
    """
    if not (folder / "seals.json").exists():
        raise InputError(f"{folder}: there are no published seals, and nothing may be diagnosed before")
    published = (folder / "seals.json").read_bytes()
    cases = len(json.loads(published)["seals"])
    config = DiagnoseConfig(cases=cases, folder=_absolute(folder), seals_sha256=digest(published))
    _run(DIAGNOSE, config, folder / "results", jobs, shown, failures=True)


def diagnose_case(config: DiagnoseConfig, case: int, streams: Streams) -> dict[str, str]:
    """Diagnose one recording."""
    folder = Path(config.folder)
    nameable = json.loads((folder / "seals.json").read_bytes())["nameable"][str(case)]
    found = diagnose(load(_recording(folder, case)), seed=DIAGNOSIS_SEED, library=nameable).to_json()
    found["where"] = found["where"][:SHOWN_FINDINGS]
    return {"diagnosis": json.dumps(plain(found))}


def score(folder: Path, jobs: int = 1, shown: engine.Display = engine.silent) -> Scores:
    """Step three: open the answers, check every seal, count.

    Parameters
    ----------
    folder : with the first two steps done
    jobs, shown : as for `make`

    Raises
    ------
    InputError
        A seal does not fit its answer, the results came before the seals, or there are none.
    """
    opened, results = open_answers(folder), _results(folder)
    wanted = tuple(case for case in opened if _worth_reaching(opened[case], results[case]))
    reached: dict[int, float] = {}
    if wanted:
        spec = Spec.model_validate_json(json.dumps(settings(folder / "sealed")["spec"]))
        config = ReachConfig(folder=_absolute(folder), spec=spec, wanted=wanted)
        reached = dict(zip(wanted, _run(REACH, config, folder / "reached", jobs, shown)["closed_true"], strict=True))
    rows = [case_row(opened[case], results[case], reached.get(case)) for case in opened]
    made = scored(pd.DataFrame(rows))
    write_json(folder / "scores.json", {"rows": rows})
    return made


def reach_case(config: ReachConfig, number: int, streams: Streams) -> dict[str, float]:
    """What the truth reaches in a case, for which its simulation is repeated; NaN if the data have not its size."""
    case = config.wanted[number]
    drawn = draw(config.spec, case)
    if json.loads(seal.canonical(drawn.answer)) != open_answers(Path(config.folder))[case]:
        raise InputError(f"case {case}: the program has changed since it was drawn, and its truth cannot be simulated again")
    model = prepare(drawn.recording()).model
    response = drawn.world.response(drawn.settings)
    return {"closed_true": true_closed(model, response) if response.size == model.size else float("nan")}


MAKE = Study("studies.validation.blind_check.steps:MAKE", MakeConfig, make_case)
DIAGNOSE = Study("studies.validation.blind_check.steps:DIAGNOSE", DiagnoseConfig, diagnose_case)
REACH = Study("studies.validation.blind_check.steps:REACH", ReachConfig, reach_case)


def open_answers(folder: Path) -> dict[int, dict[str, Any]]:
    """The answers by case, every one checked against its published seal first."""
    sealed = json.loads((folder / "sealed" / "answers.json").read_text())
    seal.check(json.loads((folder / "seals.json").read_text())["seals"], sealed)
    return {int(case): one["answer"] for case, one in sealed.items()}


def settings(place: Path) -> dict[str, Any]:
    """Settings of the study in a folder."""
    found: dict[str, Any] = json.loads((place / MANIFEST).read_text())["config"]
    return found


def _run(
    study: Study, config: StudyConfig, place: Path, jobs: int, shown: engine.Display, failures: bool = False
) -> pd.DataFrame:
    """Rows of a step's study; cases that failed are run again the next time, unless failures are results."""
    backend: engine.Name = "loky" if jobs > 1 else "serial"
    outcome = engine.run(study, config, place, backend=backend, jobs=jobs, progress=shown, retry_failed=not failures)
    if not failures:
        outcome.check()
    return outcome.load()


def _results(folder: Path) -> dict[int, dict[str, Any]]:
    table = folder / "results" / "table.parquet"
    if not table.exists():
        raise InputError(f"{folder}: not every case has a diagnosis yet")
    if settings(table.parent)["seals_sha256"] != digest((folder / "seals.json").read_bytes()):
        raise InputError(f"{folder}: the cases were not diagnosed under the published seals")
    rows = pd.read_parquet(table).to_dict("records")
    found = [{"error": row["error"], "diagnosis": None if row["error"] else json.loads(row["diagnosis"])} for row in rows]
    return {int(row["case"]): one for row, one in zip(rows, found, strict=True)}


def _worth_reaching(answer: dict[str, Any], result: dict[str, Any]) -> bool:
    """Whether the closure of this case is compared with what the truth reaches: a single effect with columns, named."""
    effects = answer["effects"]
    if len(effects) != 1 or answer["kind"] != "one" or result["error"]:
        return False
    one, found = effects[0], result["diagnosis"]
    named = found["closure"] is not None and [cause["effect"] for cause in found["causes"]] == [one["effect"]]
    return bool(named and EFFECTS[one["effect"]].has_columns and one["snr"] and one["snr"] >= REACH_SNR)


def _absolute(folder: Path) -> str:
    """A folder as a worker finds it, wherever that was started."""
    return str(folder.resolve())


def _recording(folder: Path, case: int) -> Path:
    return folder / "recordings" / f"case-{case:06d}"
