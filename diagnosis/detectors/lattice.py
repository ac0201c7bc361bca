"""Readings on a lattice: its step, and slow rates with the lattice undone.

A reading x + n of noise n ~ N(0, σ²) on a lattice of step q has the mean

    rounded  f(x) = q Σ_k Φ((x − (k + ½) q)/σ) over k ≥ 0, less q Σ_k Φ((−x − (k + ½) q)/σ)
    cut      f(x) = q Σ_k Φ((x − k q)/σ) over k ≥ 1, less q Σ_k Φ((−x − k q)/σ)

With noise above q/3 rounding hardly matters; below it f is a staircase. Cutting takes half a step off every rate that is
larger than one, whatever the noise. Means over a minute are inverted through f; where the rate moves, half a step is given
back to every reading but zero, and so it is where the noise spans many steps. What remains is the lattice's own noise, q²/12 a
sample where the noise spreads it, and worse on a stair, or where a swing turns round inside a step.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from scipy.special import ndtr

Array = NDArray[np.float64]
Kind = Literal["rounded", "cut"]

MEAN_S = 60.0  # s, of the means that are inverted
FEW = 20  # readings at least, of those
REACH = 10  # steps on either side of zero in which f is tabulated
LEAST_SLOPE = 0.15  # of f, below which nothing more can be said of the rate
HIDDEN = 0.3  # slope of f below which a reading hides the rate
SPREAD = 0.45  # noise over step, above which rounding does nothing to a mean
EXACT = 0.02  # steps, by which a value may be off the lattice
PRINTED = 5e-5  # relative error of a number printed with five digits, by which it may be off as well
UNTOLD = 0.2  # steps, of what may be off, beyond which a value says nothing of the lattice
FEWEST_TOLD = 50  # other values, by which the chance of a lattice is less than 1e-19
FINE = 5.0  # noise over step, above which the stairs of cut readings are lost in it


def find_lattice_step(x: Array) -> float:
    """Find the step of the lattice that all values (n,) lie on; 0 if there is none."""
    values = np.unique(x)
    if values.size < 3:
        return 0.0
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * max(float(np.abs(values).max()), 1e-30)]
    if not gaps.size:
        return 0.0
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    order = np.argsort(np.abs(values))
    for share in (0.01, 0.1, 1.0):
        chosen = values[order[: max(3, int(share * values.size))]]
        counts = np.round(chosen / step)
        if np.any(counts):
            step = float(counts @ chosen / (counts @ counts))
    off = np.abs(values / step - np.round(values / step))
    allowed = EXACT + PRINTED * np.abs(values / step)
    told = allowed < UNTOLD
    exact = off.max() < EXACT or (told.sum() >= FEWEST_TOLD and bool((off < allowed)[told].all()))
    return step if exact else 0.0


def compute_mean_reading(x: Array, step: float, sigma: float, kind: Kind) -> Array:
    """f(x): mean reading at true readings x with noise sigma, within `REACH` steps of zero."""
    shift = 0.5 if kind == "rounded" else 1.0
    out = np.zeros_like(x)
    for k in range(REACH + 8):
        edge = (k + shift) * step
        out += ndtr((x - edge) / sigma) - ndtr((-x - edge) / sigma)
    return out * step


def undo_lattice(x: Array, sample_s: float, step: float, sigma: float, kind: Kind) -> tuple[Array, Array, Array]:
    """Undo a lattice as far as the slow part of the readings goes.

    Parameters
    ----------
    x : (n,) readings of one interval, rad/s
    sample_s : s
    step, sigma : of the lattice and of the noise before it, rad/s
    kind : how readings were put on it

    Returns
    -------
    The readings, what to multiply their noise density with, and what to add to it, rad²/s; (n,) each.
    """
    counts = np.round(x / step)
    half = 0.5 * step * np.sign(counts) if kind == "cut" else np.zeros_like(x)
    if (kind == "rounded" and sigma > SPREAD * step) or sigma > FINE * step:
        return x + half, np.ones_like(x), np.zeros_like(x)
    count = min(max(FEW, round(MEAN_S / sample_s)), x.size)
    mean = scipy.ndimage.uniform_filter1d(x, count, mode="nearest")
    few = scipy.ndimage.uniform_filter1d(x, min(FEW, x.size), mode="nearest")
    # A long mean of a fast swing stands still; that of few readings does not.
    moving = (np.abs(np.gradient(mean)) * count > step) | (np.abs(few - mean) > step + 4 * sigma / np.sqrt(FEW))
    # Away from zero the stairs are all alike, and cut readings are rounded ones half a step nearer to zero.
    stair = np.linspace(-0.5, 0.5, 401) * step
    level = np.round(mean / step) * step
    true, slope = _invert_mean_reading(
        mean - level, stair, compute_mean_reading(stair, step, max(sigma, 1e-3 * step), "rounded")
    )
    true = true + level
    if kind == "cut":
        near = np.abs(mean) < (REACH - 2) * step
        grid = np.linspace(-REACH, REACH, 4001) * step
        low, low_slope = _invert_mean_reading(mean, grid, compute_mean_reading(grid, step, max(sigma, 1e-3 * step), "cut"))
        true = np.where(near, low, true + 0.5 * step * np.sign(mean))
        slope = np.where(near, low_slope, slope)
    factor = np.where(moving, 1.0, 1.0 / np.clip(slope, LEAST_SLOPE, 1.0) ** 2)
    # On a flat stair the rate may be anywhere in between, and stay there for a while.
    hidden = np.where(~moving & (slope < HIDDEN), step**2 / 12 * MEAN_S, 0.0)
    width = step * np.where((kind == "cut") & (counts == 0), 2.0, 1.0)
    turning = np.where(moving, width**2 / 12 * (measure_hold_times(counts, sample_s) - sample_s), 0.0)
    return x + np.where(moving, half, true - mean), factor, hidden + turning


def measure_hold_times(counts: Array, sample_s: float) -> Array:
    """Measure the time for which each reading's error keeps its sign, s; one sample if the rate passes through its step.

    A rate that turns round inside a step is in error by up to half of it, on one side, for as long as it stays there.
    """
    first = np.flatnonzero(np.append(True, np.diff(counts) != 0))
    length = np.diff(np.append(first, counts.size))
    way = np.sign(np.diff(counts[first]))
    passes = np.append(0, way) * np.append(way, 0) > 0
    return np.repeat(np.where(passes, 1, length), length) * sample_s


def _invert_mean_reading(mean: Array, grid: Array, curve: Array) -> tuple[Array, Array]:
    """True readings whose mean is given, and the slope of the mean there."""
    # The grid is symmetric about zero: on a flat stair its middle is taken, not an edge.
    rising = np.maximum.accumulate(curve + 1e-9 * grid)
    true = np.interp(mean, rising, grid)
    return true, np.interp(true, grid, np.gradient(curve, grid))
