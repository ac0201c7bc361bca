"""Run by test_registry in a copy of the packages: take out groups of effects, and load everything else.

What needs an effect fails without the group that the effect is in, whatever else is in it. Each effect is in another half of
the groups, so that of any two effects each is once taken out while the other is there: also an effect that needs another one
is seen. Each group is taken out in a process forked from one that has loaded the other libraries.
"""

import importlib
import json
import os
import pkgutil
import re
import sys
from itertools import combinations
from pathlib import Path

from click.testing import CliRunner

LIBRARIES = (
    "joblib",
    "matplotlib.pyplot",
    "numba",
    "pandas",
    "pydantic",
    "rich.table",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
)
PACKAGES = ("gyrocal", "simulator", "diagnosis", "studies")


def loaded() -> dict[str, list[str]]:
    """Modules that cannot be imported, and commands that fail to list or to show their help."""
    modules, commands = [], []
    for package in PACKAGES:
        for found in pkgutil.walk_packages([package], f"{package}.", onerror=lambda name: None):
            try:
                if not found.name.endswith("__main__"):
                    importlib.import_module(found.name)
            except ImportError:
                modules.append(found.name)
    from studies.cli.main import COMMANDS, main

    for arguments in (["effects"], ["study"], ["scenarios"], *([name, "--help"] for name in COMMANDS)):
        if CliRunner().invoke(main, arguments).exit_code:
            commands.append(" ".join(arguments))
    return {"modules": modules, "commands": commands}


def grouped(files: list[str]) -> list[list[str]]:
    """The files in eight groups, each file in four: no two in the same four."""
    halves = list(combinations(range(8), 4))
    assert len(files) <= len(halves)
    own = [halves[37 * number % len(halves)] for number in range(len(files))]  # neighbours in the list are not in the same
    return [[file for file, half in zip(files, own, strict=True) if group in half] for group in range(8)]


def without(files: list[str]) -> dict[str, list[str]]:
    """What cannot be loaded with the files of some effects and their lines in the list taken out."""
    listing = Path("simulator/effects/builtin.py")
    text, (reading, writing) = listing.read_text(), os.pipe()
    listing.write_text(re.sub(rf"(?m)^\w+\.({'|'.join(Path(file).stem for file in files)})\n", "", text))
    hidden = {file: Path(file).rename(f"{file}.gone") for file in files}
    if os.fork() == 0:
        sys.dont_write_bytecode = True
        try:
            os.write(writing, json.dumps(loaded()).encode())
        finally:
            os._exit(0)
    os.close(writing)
    os.wait()
    listing.write_text(text)
    for file, gone in hidden.items():
        gone.rename(file)
    with os.fdopen(reading) as answer:
        return json.loads(answer.read())


if __name__ == "__main__":
    sys.path.insert(0, os.getcwd())
    for library in LIBRARIES:
        importlib.import_module(library)
    print(json.dumps([{"files": group, **without(group)} for group in grouped(sys.argv[1:])]))
