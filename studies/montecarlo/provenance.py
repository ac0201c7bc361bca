"""What a study's rows are made with: the source code, and what decides the last digits of the same arithmetic elsewhere.

BLAS picks kernels by the processor, numpy its vector code, compiled code (numba) the fused multiply-add, and the C library its
functions. Rows for which the source code and all of this are the same are the same, bit for bit; a study does not mix others
with them unless it is told to.
"""

import hashlib
import platform
import re
import sys
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

import gyrocal
from studies.montecarlo.study import Study, find_study_folder

PROJECT = Path(gyrocal.__file__).resolve().parents[1]
SOURCE_PACKAGES = ("gyrocal", "simulator", "diagnosis", "studies")
SOURCE_SUFFIXES = (".py", ".csv", ".json", ".toml")
DECISIVE = ("numpy", "scipy", "numba", "pandas")
SHOWN_DIFFERENCES = 4  # differences that a message names


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
    return {"source_sha256": hash_files(files), "machine": describe_machine()}


def hash_files(paths: Iterable[Path]) -> str:
    """Hash the sources among some files, with their paths in our project or their names elsewhere."""
    hashed = hashlib.sha256()
    for path in sorted(path for path in paths if path.suffix in SOURCE_SUFFIXES):
        name = path.relative_to(PROJECT).as_posix() if path.is_relative_to(PROJECT) else path.name
        hashed.update(name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return hashed.hexdigest()


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
    """The single values of nested dictionaries and lists by dotted path; empty ones are none."""
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else None
    if items is None:
        return {path: value}
    return {
        key: one for name, item in items for key, one in _flatten_values(item, f"{path}.{name}" if path else str(name)).items()
    }
