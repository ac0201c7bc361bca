"""What decides the last digits of a result beside its sources: versions, kernels and vector units.

The same arithmetic done elsewhere differs in the last digits: BLAS picks kernels by the processor, numpy its vector code,
compiled code (numba) the fused multiply-add, and the C library its functions. Rows that are made with all of this the same are
the same, bit for bit; a study does not mix others with them unless it is told to.
"""

import platform
import re
from functools import cache
from importlib import import_module, metadata

import numpy as np

DECISIVE = ("numpy", "scipy", "numba", "pandas")


@cache
def machine() -> dict[str, str]:
    """What decides the last digits here, by name, for this process."""
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
