"""The manifest of a folder, and what rows are made with: source code, versions, and the machine.

BLAS picks kernels by the processor, numpy its vector code, compiled code (numba) the fused multiply-add, and the C library its
functions. Rows for which the source code and all of this are the same are the same, bit for bit; a study does not put others
beside them.
"""

import hashlib
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

import gyrocal
from studies.montecarlo.files import write_json
from studies.montecarlo.study import Study, find_study_folder

MANIFEST = "manifest.json"
REPORTED_PACKAGES = ("gyrocal", "numpy", "scipy", "pandas", "numba", "matplotlib", "joblib", "pydantic", "pyarrow")
WORK = "work"
AT_WORK = ("parts", "failures", "cases", WORK)  # folders of a study that hold no result
PROJECT = Path(gyrocal.__file__).resolve().parents[1]
SOURCE_PACKAGES = ("gyrocal", "simulator", "diagnosis", "studies")
SOURCE_SUFFIXES = (".py", ".csv", ".json", ".toml")
DECISIVE = ("numpy", "scipy", "numba", "pandas")
SHOWN_DIFFERENCES = 4  # differences that a message names


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


def write_manifest(folder: Path, about: Mapping[str, Any], complete: bool = True) -> None:
    """Write the manifest of a folder: plain values, and the hashes of all results once they are complete."""
    files = {}
    for path in sorted(folder.rglob("*")) if complete else ():
        parts = path.relative_to(folder).parts
        if path.is_file() and path.name != MANIFEST and parts[0] not in AT_WORK and not path.name.startswith("."):
            with path.open("rb") as file:
                files["/".join(parts)] = hashlib.file_digest(file, "sha256").hexdigest()
    write_json(folder / MANIFEST, dict(about) | {"files": files})


@lru_cache(maxsize=64)
def describe_provenance(study: Study) -> dict[str, Any]:
    """Describe what a study's rows are made with in this process: the hash of the source code, and the machine.

    The sources are read once a process for the same functions: what this process has loaded is as old as that. They are the
    files of our packages and of the study's own package, or the modules in the folder of a study that is a single file.
    """
    files = {path for name in SOURCE_PACKAGES for path in (PROJECT / name).rglob("*")}
    top = study.name.partition(":")[0].partition(".")[0]
    if find_study_folder(study):
        files |= set(Path(find_study_folder(study)).glob("*.py"))
    elif top not in SOURCE_PACKAGES:
        files |= {path for place in sys.modules[top].__path__ for path in Path(place).resolve().rglob("*.py")}
    hashed = hashlib.sha256()
    for path in sorted(path for path in files if path.suffix in SOURCE_SUFFIXES):
        name = path.relative_to(PROJECT).as_posix() if path.is_relative_to(PROJECT) else path.name
        hashed.update(name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return {"source_sha256": hashed.hexdigest(), "machine": describe_machine()}


@cache
def describe_machine() -> dict[str, str]:
    """Name what decides the last digits here, for this process."""
    import numba
    import scipy.linalg  # its BLAS is one of those to be found  # noqa: F401
    from threadpoolctl import threadpool_info

    loaded = [library for library in threadpool_info() if library["user_api"] == "blas"]
    # Another package may have brought a BLAS of its own, in this process and not in a worker.
    used = [library for library in loaded if re.search("numpy|scipy", library["filepath"])] or loaded
    kernels = {" ".join(str(one.get(key) or "?") for key in ("internal_api", "version", "architecture")) for one in used}
    vectors = (np.show_config(mode="dicts") or {}).get("SIMD Extensions", {})
    return {
        "system": f"{platform.system()} {platform.machine()} {' '.join(platform.libc_ver())}".strip(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: metadata.version(name) for name in DECISIVE},
        "blas": ", ".join(sorted(kernels)),
        "simd": " ".join([*vectors.get("baseline", []), *vectors.get("found", [])]),
        "compiled for": getattr(numba.config, "CPU_NAME", None) or import_module("llvmlite.binding").get_host_cpu_name(),
    }


def list_changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """List the first values that differ as "key: old → new", – where there is none, and how many more there are."""
    old, new = _flatten_values(before), _flatten_values(now)
    keys = [key for key in dict.fromkeys([*old, *new]) if old.get(key, "–") != new.get(key, "–")]
    more = f" and {len(keys) - SHOWN_DIFFERENCES} more" if len(keys) > SHOWN_DIFFERENCES else ""
    return ", ".join(f"{key}: {old.get(key, '–')} → {new.get(key, '–')}" for key in keys[:SHOWN_DIFFERENCES]) + more


def _flatten_values(value: Any, path: str = "") -> dict[str, Any]:
    """The single values of nested dictionaries and lists by dotted path, without empty ones and None."""
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else None
    if items is None:
        return {} if value is None else {path: value}
    return {
        key: one for name, item in items for key, one in _flatten_values(item, f"{path}.{name}" if path else str(name)).items()
    }
