"""Covariance of a calibration by leaving out one block of data at a time, with no model of the noise.

With x_k the parameters without block k of n, and x̄ their mean, the delete-one jackknife (Efron and Stein, Annals of Statistics
9, 1981) estimates

    cov = (n − 1)/n Σ_k (x_k − x̄)(x_k − x̄)ᵀ.

Errors may correlate within a block, not between blocks. Blocks are whole intervals, or parts of intervals where these are few.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.davenport import calibrate
from gyrocal.errors import InputError
from gyrocal.recording import Interval, Recording, find_reference_rows

Array = NDArray[np.float64]

FEWEST_BLOCKS = 3
ENOUGH_BLOCKS = 8


def estimate_jackknife_covariance(recording: Recording, least_blocks: int = ENOUGH_BLOCKS) -> Array:
    """Estimate the covariance (12, 12) of G and b by leaving out one block at a time; b in rad/s.

    An `InputError` if there are fewer than `FEWEST_BLOCKS` blocks.

    Parameters
    ----------
    recording : the recording
    least_blocks : number of blocks that intervals are cut into, where there are fewer intervals and enough references
    """
    blocks = cut_into_blocks(recording, least_blocks)
    if len(blocks) < FEWEST_BLOCKS:
        raise InputError(f"a jackknife needs {FEWEST_BLOCKS} blocks or more, and the recording has {len(blocks)}")
    whole = calibrate(recording).parameters
    start = replace(recording, gyro=replace(recording.gyro, apriori_G=whole.G, apriori_bias=whole.bias))
    parts = [_keep_intervals(start, blocks[:k] + blocks[k + 1 :]) for k in range(len(blocks))]
    estimates = np.array([calibrate(part).parameters.vector for part in parts])
    off = estimates - estimates.mean(axis=0)
    return np.asarray((len(blocks) - 1) / len(blocks) * off.T @ off)


def cut_into_blocks(recording: Recording, least_blocks: int) -> tuple[Interval, ...]:
    """Cut intervals at reference attitudes into equal numbers of parts, until there are enough of them.

    Parameters
    ----------
    recording : the recording
    least_blocks : as many parts are made at least, if there are references to cut at
    """
    parts = -(-least_blocks // len(recording.intervals))
    blocks: list[Interval] = []
    for one in recording.intervals:
        times = recording.attitudes.t_s[find_reference_rows(recording.attitudes.t_s, one)]
        edges = np.unique(np.linspace(0, times.size - 1, parts + 1).round().astype(int))
        for k, (low, high) in enumerate(pairwise(edges)):
            name = one.name if edges.size == 2 else f"{one.name} part {k + 1}"
            blocks.append(replace(one, name=name, start_s=float(times[low]), stop_s=float(times[high])))
    return tuple(blocks)


def _keep_intervals(recording: Recording, intervals: tuple[Interval, ...]) -> Recording:
    """The recording with some intervals, and the references inside these."""
    times = recording.attitudes.t_s
    inside = np.zeros(times.size, dtype=bool)
    for one in intervals:
        inside[find_reference_rows(times, one)] = True
    attitudes = recording.attitudes.select_rows(inside)
    return replace(recording, attitudes=attitudes, intervals=intervals, tables={}, sensors=None)
