"""What a result was made with: configuration and its hash, versions, commit, and the hash of every file written."""

import hashlib
import json
import platform
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

PACKAGES = ("gyrocal", "numpy", "scipy", "pandas", "numba", "matplotlib", "joblib", "pydantic", "pyarrow")


def digest(data: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def commit() -> str | None:
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


def manifest(command: str, config: Mapping[str, Any], folder: Path, wall_s: float) -> dict[str, Any]:
    """Manifest of a folder of results.

    Parameters
    ----------
    command : what was run
    config : everything the results depend on, as plain values
    folder : where the results are; every file in it but the manifest is hashed
    wall_s : how long it took
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "manifest.json")
    return {
        "command": command,
        "config": dict(config),
        "config_sha256": digest(json.dumps(config, sort_keys=True).encode()),
        "commit": commit(),
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in PACKAGES},
        "wall_s": round(wall_s, 2),
        "files": {str(path.relative_to(folder)): digest(path.read_bytes()) for path in files},
    }
