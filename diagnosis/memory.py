"""Memory that is free, given back to the system."""

from __future__ import annotations

import ctypes
import sys


def give_back() -> bool:
    """Give back what is free between blocks of memory that are in use, where the C library can; whether it did.

    A search makes and drops thousands of matrices, and those that are kept lie among them: of a long recording two hundred
    megabytes are left that nobody uses. glibc gives them back when it is asked (malloc_trim(3)).
    """
    if not sys.platform.startswith("linux"):
        return False
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    return trim is not None and bool(trim(0))
