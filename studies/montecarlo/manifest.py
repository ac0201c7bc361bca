"""The manifest of a folder: what its files were made with, configuration, versions, commit, and the hash of each."""

import hashlib
import platform
import subprocess
from collections.abc import Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from studies.montecarlo.files import write_json

MANIFEST = "manifest.json"
REPORTED_PACKAGES = ("gyrocal", "numpy", "scipy", "pandas", "numba", "matplotlib", "joblib", "pydantic", "pyarrow")
WORK = "work"
AT_WORK = ("parts", "failures", "cases", WORK)  # folders of a study that hold no result


def hash_bytes(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def read_commit() -> str | None:
    """Commit of the source this runs from, with "+changes" if it is not clean; None outside a repository."""
    folder = Path(__file__).parent
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=folder, capture_output=True, text=True, check=True)
        # Results are what a run writes; they do not make the source unclean.
        sources = ["status", "--porcelain", "--", ":/", ":(top,exclude)results"]
        status = subprocess.run(["git", *sources], cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+changes" if status.stdout.strip() else "")


def collect_versions(more: Iterable[str] = ()) -> dict[str, Any]:
    """Commit, Python, and packages, some more than `REPORTED_PACKAGES` if asked for."""
    packages = {name: metadata.version(name) for name in (*REPORTED_PACKAGES, *more)}
    return {"commit": read_commit(), "python": platform.python_version(), "packages": packages}


def list_results(folder: Path) -> list[Path]:
    """The files of a folder that are results: all but the manifest, hidden ones, and what a study works with."""
    found = (path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    inside = ((path, path.relative_to(folder).parts) for path in found)
    return sorted(path for path, parts in inside if parts[0] not in AT_WORK and not parts[-1].startswith("."))


def write_manifest(folder: Path, about: Mapping[str, Any], complete: bool = True) -> None:
    """Write the manifest of a folder.

    Parameters
    ----------
    folder : of a study
    about : what the manifest says beside the hashes, as plain values
    complete : whether all results are there; only then are they hashed
    """
    files = {}
    for path in list_results(folder) if complete else ():
        with path.open("rb") as file:
            files[str(path.relative_to(folder))] = hashlib.file_digest(file, "sha256").hexdigest()
    write_json(folder / MANIFEST, dict(about) | {"files": files})
