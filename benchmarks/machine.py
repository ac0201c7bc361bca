"""What the benchmark ran on, without names or paths of the machine."""

import platform
from importlib import metadata
from os import cpu_count
from pathlib import Path
from typing import Any

from benchmarks.c_kernel import compiler_version
from studies.montecarlo.manifest import REPORTED_PACKAGES

OPTIONAL = ("gtsam",)


def machine() -> dict[str, Any]:
    """CPU, cores, versions."""
    return {
        "cpu": _cpu_model(),
        "cores": cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "compiler": compiler_version(),
        "packages": {name: _version(name) for name in (*REPORTED_PACKAGES, *OPTIONAL)},
    }


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
