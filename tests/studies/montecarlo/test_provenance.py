"""Rows of two sources or machines never stand beside each other."""

import importlib
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from gyrocal.errors import InputError
from studies.montecarlo.engine import run
from studies.montecarlo.manifest import describe_machine, describe_provenance
from studies.montecarlo.study import Study
from tests import ROOT
from tests.engine_studies import DRAWS, DrawsConfig

STUDY = '''
    """A study in a file."""
    from helping_hand import factor
    from studies.montecarlo.study import Study, StudyConfig


    class MyConfig(StudyConfig):
        cases: int = 8


    def case(config, number, streams):
        """One row."""
        return {"x": factor(2.0) * streams.generator("x").standard_normal()}


    def report(rows):
        return rows.mean()


    STUDY = Study("my_own_study:STUDY", MyConfig, case)
'''
HELPER = "def factor(x):\n    return x\n"


@pytest.fixture
def my_study(tmp_path, monkeypatch):
    """Writes a study and what it imports, edited as told, and imports it anew."""
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def write(old: str = "", new: str = "", helper: str = HELPER) -> Study:
        (tmp_path / "helping_hand.py").write_text(helper)
        (tmp_path / "my_own_study.py").write_text(textwrap.dedent(STUDY).replace(old, new))
        importlib.invalidate_caches()
        for name in ("my_own_study", "helping_hand"):
            sys.modules.pop(name, None)
        return importlib.import_module("my_own_study").STUDY

    yield write
    for name in ("my_own_study", "helping_hand"):
        sys.modules.pop(name, None)


def serial(study, folder, cases=8, **options):
    return run(study, study.config(cases=cases), folder, backend="serial", **options)


@pytest.mark.parametrize(
    ("edit", "name"),
    [
        ({"old": "factor(2.0)", "new": "factor(3.0)"}, "my_own_study.py"),
        ({"helper": HELPER.replace("return x", "return 2 * x")}, "helping_hand.py"),
    ],
)
def test_an_edited_study_is_refused(edit, name, my_study, tmp_path):
    folder = tmp_path / "out"
    table = serial(my_study(), folder).load()
    edited = my_study(**edit)
    before = (folder / "manifest.json").read_bytes()
    told = f"8 finished cases were computed before {name} changed; choose another --out, or delete the folder"
    with pytest.raises(InputError, match=told):
        serial(edited, folder)
    assert (folder / "manifest.json").read_bytes() == before
    other = serial(edited, tmp_path / "other").load()
    assert not np.allclose(other["x"], table["x"])
    # Edited back, it is the study of the folder again.
    assert serial(my_study(), folder).resumed == 8


def test_every_module_that_a_case_loads_is_a_source():
    """Python itself says what a process has loaded once a case has run; the search of the texts must find all of it."""
    code = (
        "import sys; from studies.montecarlo import cases, manifest; from tests.engine_studies import DRAWS as study;"
        "cases.run_cases(cases.Task(study.name, study.config(cases=1).model_dump_json(), range(1)));"
        "known = {str(path) for path in manifest.find_imported_files([study.name.partition(':')[0], cases.__name__]).values()};"
        "ours = ('gyrocal', 'simulator', 'diagnosis', 'studies', 'tests');"
        "loaded = {module.__file__ for name, module in sys.modules.items() if name.partition('.')[0] in ours};"
        "print(len(loaded), sorted(loaded - known), any(name.startswith('diagnosis') for name in known))"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert (int(found[0]) > 50, found[1:]) == (True, ["[]", "False"])


def test_rows_of_another_machine_or_worker_are_refused(tmp_path, monkeypatch):
    here = describe_provenance(DRAWS)
    elsewhere = here | {"machine": describe_machine() | {"blas": "openblas 0.3.30 Zen", "numpy": "2.0.0"}}
    other = here | {"sources": {"here.py": "0"}}
    config = DrawsConfig(cases=12, size=3)
    run(DRAWS, config, tmp_path, backend="serial")
    (tmp_path / "parts" / "part-000001.parquet").unlink()
    monkeypatch.setattr("studies.montecarlo.engine.describe_provenance", lambda study: elsewhere)
    with pytest.raises(InputError, match=r"computed elsewhere \(numpy: .* → 2.0.0, blas: .* → openblas 0.3.30 Zen\); choose"):
        run(DRAWS, config, tmp_path, backend="serial")
    monkeypatch.undo()
    monkeypatch.setattr("studies.montecarlo.cases.describe_provenance", lambda study: other)
    with pytest.raises(InputError, match=r"a worker differs \(.*here.py|.* more\); make them alike, or undo"):
        run(DRAWS, config, tmp_path / "other", backend="serial")
