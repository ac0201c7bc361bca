"""Whether a committed result was made by code of which the part that it measures has changed since.

A manifest holds the hash of each source that its rows depend on, without comments, docstrings and layout. What counts is the
code that is measured: not the engine that runs the cases, nor what renders a report.
"""

import json
from functools import cache
from pathlib import Path

from gyrocal.errors import InputError
from studies.montecarlo.sources import module_sources, sources
from studies.montecarlo.study import find

MANIFEST = "manifest.json"
BESIDE = ("studies/montecarlo/", "studies/report/", "studies/cli/", "tests/")  # run and show what is measured
IMPORTING = ("gyrocal/importing/", "gyrocal/allan/")  # what a calibration loads and does not use, but for these studies:
IMPORTED = ("import", "real", "sentinel2a")


def changed_sources(folder: Path) -> list[str]:
    """List the sources of a result that have changed since it was made; "no record" where none were kept."""
    path = folder / MANIFEST
    document = json.loads(path.read_text()) if path.exists() else {}
    before = document.get("sources")
    if not before:
        return ["no record of the sources"]
    try:
        now = _now(document.get("study"), tuple(document.get("modules", ())))
    except InputError as error:
        return [str(error)]
    beside = BESIDE if folder.name in IMPORTED else (*BESIDE, *IMPORTING)
    names = sorted({*before, *now})
    return [name for name in names if before.get(name) != now.get(name) and not name.startswith(beside)]


@cache
def _now(study: str | None, modules: tuple[str, ...]) -> dict[str, str]:
    found = {} if study is None else dict(sources(find(study)))
    for module in modules:
        found |= module_sources(module)
    return found
