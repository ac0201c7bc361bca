"""Arrays a thread keeps from one case to the next.

A case's arrays are a megabyte or two, and depending on the heap's layout they go back to the system each time, at a page fault
for every 4 KiB when they return: more than the case's own work. An array from here is overwritten by the next case.
"""

import threading

import numpy as np
from numpy.typing import NDArray


class _Arrays(threading.local):
    def __init__(self) -> None:
        self.by_name: dict[object, NDArray[np.float64]] = {}


_arrays = _Arrays()


def workspace(name: object, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """This thread's array of that name, uninitialised when it is new or of another shape than before."""
    array = _arrays.by_name.get(name)
    if array is None or array.shape != shape:
        array = _arrays.by_name[name] = np.empty(shape)
    return array
