"""Stretches of True in a mask."""

import numpy as np

from gyrocal.arrays import Mask


def find_mask_runs(mask: Mask) -> list[tuple[int, int]]:
    """Find the first and one past the last index of each stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(first), int(stop)) for first, stop in zip(edges[::2], edges[1::2], strict=True)]
