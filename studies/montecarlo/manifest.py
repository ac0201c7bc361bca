"""The manifest of a folder, and the provenance of rows: source code, versions, and the machine.

BLAS selects kernels by the processor, numpy its vector code, compiled code (numba) the fused multiply-add, and the C library
its functions. Rows are equal bit for bit if the source code and all of this are the same; a study mixes them with no others.
"""

import hashlib
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from functools import cache, lru_cache
from importlib import import_module, metadata
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

import numpy as np

import gyrocal
from studies.montecarlo.files import write_json
from studies.montecarlo.study import Study

MANIFEST = "manifest.json"
REPORTED_PACKAGES = ("gyrocal", "numpy", "scipy", "pandas", "numba", "matplotlib", "joblib", "pydantic", "pyarrow")
WORK = "work"
AT_WORK = ("parts", "failures", "cases", WORK)  # folders of a study that hold no result
PROJECT = Path(gyrocal.__file__).resolve().parents[1]
SOURCE_PACKAGES = ("gyrocal", "simulator", "diagnosis", "studies")
TABLE_SUFFIXES = (".csv", ".json", ".toml")
IMPORT = re.compile(  # one that begins a line, or follows ; or :, and one by a constant name
    r"(?:^|[;:])[ \t]*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n;]+)|import\s+([^\n;]+))"
    r"""|import_module\(\s*["']([\w.]+)["']""",
    flags=re.MULTILINE,
)
DECISIVE = ("numpy", "scipy", "numba", "pandas")
SHOWN_DIFFERENCES = 4  # differences that a message names


def hash_bytes(data: bytes) -> str:
    """Compute the SHA-256 in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def read_commit() -> str | None:
    """Read the commit of this source, with "+changes" if it is not clean; None outside a repository."""
    folder = Path(__file__).parent
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=folder, capture_output=True, text=True, check=True)
        # Results, which a run writes, do not make the source unclean.
        sources = ["status", "--porcelain", "--", ":/", ":(top,exclude)results"]
        status = subprocess.run(["git", *sources], cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+changes" if status.stdout.strip() else "")


def collect_versions(further: Iterable[str] = ()) -> dict[str, Any]:
    """Collect commit, Python, and versions of `REPORTED_PACKAGES` and further packages."""
    packages = {name: metadata.version(name) for name in (*REPORTED_PACKAGES, *further)}
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
    """Describe the provenance of a study's rows in this process: the hash of each source file, and the machine.

    The sources are read once a process for the same functions, since the process keeps what it has loaded. They are the tables
    of our packages, and the modules that the study and the running of its cases import, also within functions, without those of
    installed packages.
    """
    files = {path.relative_to(PROJECT).as_posix(): path for name in SOURCE_PACKAGES for path in (PROJECT / name).rglob("*")}
    files = {name: path for name, path in files.items() if path.suffix in TABLE_SUFFIXES}
    files |= find_imported_files((study.name.partition(":")[0], "studies.montecarlo.cases"))
    sources = {name: hash_bytes(path.read_bytes()) for name, path in sorted(files.items())}
    return {"sources": sources, "machine": describe_machine()}


def find_imported_files(modules: Iterable[str]) -> dict[str, Path]:
    """Find the files of modules and of all their imports, by their path in the packages, without importing them."""
    files: dict[str, Path] = {}
    names, specs = list(modules), dict[str, ModuleSpec | None]()
    while names:
        parts = names.pop().split(".")
        locations: Any = None
        for name in (".".join(parts[:count]) for count in range(1, len(parts) + 1)):
            if name not in specs:
                spec = getattr(sys.modules.get(name), "__spec__", None) or PathFinder.find_spec(name, locations)
                specs[name] = spec if spec and (locations or not _is_installed(name, spec)) else None
                if spec and specs[name] and spec.has_location:
                    path, is_package = Path(str(spec.origin)).resolve(), spec.submodule_search_locations is not None
                    files[name.replace(".", "/") + ("/__init__.py" if is_package else path.suffix)] = path
                    names += _read_imports(name, path, is_package)
            locations = getattr(specs[name], "submodule_search_locations", None)
            if locations is None:
                break
    return files


def _is_installed(name: str, spec: ModuleSpec) -> bool:
    """Check whether a top-level module is of the standard library or an installed package, not of this project."""
    folders = [Path(folder).resolve() for folder in spec.submodule_search_locations or [str(spec.origin)]]
    installed = any({"site-packages", "dist-packages"} & {*folder.parts} for folder in folders)
    return name not in SOURCE_PACKAGES and (installed or name in sys.stdlib_module_names)


def _read_imports(module: str, path: Path, is_package: bool) -> list[str]:
    """Read the names that a module's source may import; a package that computes names may import all of its modules."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.suffix == ".py" else ""
    names = []
    for source, imported, plain, computed in IMPORT.findall(re.sub(r"\\\n|#.*", " ", text)):
        dots = len(source) - len(source.lstrip("."))
        # Parents of a relative import: one dot is the package itself, each further one the package above.
        above = module.split(".")[: len(module.split(".")) - dots + is_package] if dots else []
        base = ".".join([*above, *filter(None, [source.lstrip(".")])])
        attributes = [part.split()[0] for part in imported.strip("() \n").split(",") if source and part.strip()]
        names += [base, *(f"{base}.{attribute}" for attribute in attributes)]
        names += [part.split()[0] for part in plain.split(",") if part.strip()] + [computed]
    if is_package and "import_module(f" in text:
        files = [file.relative_to(path.parent).with_suffix("") for file in path.parent.rglob("*.py")]
        names += [".".join([module, *file.parts]) for file in files]
    return [name for name in names if name]


@cache
def describe_machine() -> dict[str, str]:
    """Describe the libraries and the processor, which decide the last digits in this process."""
    import numba
    import scipy.linalg  # its BLAS is one of those to be found  # noqa: F401
    from threadpoolctl import threadpool_info

    loaded = [library for library in threadpool_info() if library["user_api"] == "blas"]
    # Another package may have loaded its own BLAS, in this process and not in a worker.
    used = [library for library in loaded if re.search("numpy|scipy", library["filepath"])] or loaded
    keys = ("internal_api", "version", "architecture")
    kernels = {" ".join(str(library.get(key) or "?") for key in keys) for library in used}
    vectors = (np.show_config(mode="dicts") or {}).get("SIMD Extensions", {})
    return {
        "system": f"{platform.system()} {platform.machine()} {' '.join(platform.libc_ver())}".strip(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        **{name: metadata.version(name) for name in DECISIVE},
        "blas": ", ".join(sorted(kernels)),
        "simd": " ".join([*vectors.get("baseline", []), *vectors.get("found", [])]),
        "compiled for": getattr(numba.config, "CPU_NAME", None) or import_module("llvmlite.binding").get_host_cpu_name(),
    }


def list_changes(before: Mapping[str, Any], now: Mapping[str, Any], *, values: bool = True) -> str:
    """List the first values that differ as "key: old → new" (– is none), or only their keys, and how many more there are."""
    old, new = (_flatten_values(before), _flatten_values(now)) if values else (before, now)
    keys = [key for key in dict.fromkeys([*old, *new]) if old.get(key, "–") != new.get(key, "–")]
    further = f" and {len(keys) - SHOWN_DIFFERENCES} more" if len(keys) > SHOWN_DIFFERENCES else ""
    changes = (f"{key}: {old.get(key, '–')} → {new.get(key, '–')}" if values else key for key in keys[:SHOWN_DIFFERENCES])
    return ", ".join(changes) + further


def _flatten_values(value: Any, path: str = "") -> dict[str, Any]:
    """Return the leaves of nested dictionaries and lists by dotted path, without empty ones and None."""
    items = value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list | tuple) else None
    if items is None:
        return {} if value is None else {path: value}
    return {
        key: leaf
        for name, item in items
        for key, leaf in _flatten_values(item, f"{path}.{name}" if path else str(name)).items()
    }
