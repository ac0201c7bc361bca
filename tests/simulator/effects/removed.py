"""Run by test_registry in a copy of the packages: take out the effects of some files one by one, and load everything else.

Each effect is taken out in a process forked from one that has loaded the other libraries, which is most of the time.
"""

import importlib
import json
import os
import pkgutil
import re
import sys
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


def without(path: Path) -> dict[str, list[str]]:
    """The same with one effect's file and its lines in the list taken out."""
    listing = Path("simulator/effects/builtin.py")
    text, name, reading, writing = listing.read_text(), path.stem, *os.pipe()
    listing.write_text(re.sub(rf"(?m)^\s+{name},\n|(?<=import ){name}, |, {name}\b|(?<=import ){name}$", "", text))
    hidden = path.rename(path.with_suffix(".gone"))
    if os.fork() == 0:
        sys.dont_write_bytecode = True
        try:
            os.write(writing, json.dumps(loaded()).encode())
        finally:
            os._exit(0)
    os.close(writing)
    os.wait()
    listing.write_text(text)
    hidden.rename(path)
    with os.fdopen(reading) as file:
        return json.loads(file.read())


if __name__ == "__main__":
    sys.path.insert(0, os.getcwd())
    for library in LIBRARIES:
        importlib.import_module(library)
    print(json.dumps({path: without(Path(path)) for path in sys.argv[1:]}))
