"""Arrays a process keeps from one case to the next.

A case's arrays are a megabyte or two, and depending on the heap's layout they go back to the system each time, at a page fault
for every 4 KiB when they return: more than the case's own work. An array from here is overwritten by the next case.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


@lru_cache(maxsize=16)
def get_workspace(name: object, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return this process' array of that name and shape, uninitialised when it is new."""
    return np.empty(shape)
