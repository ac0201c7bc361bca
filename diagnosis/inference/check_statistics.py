"""Statistics of what should be white noise, of one set of data and of many draws at once; see `diagnosis.inference.checks`.

The data are the first of all, and the draws come after them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LAGS = 6
PERIODS = 48  # of the scan for a line
TINY = 1e-300
LEAST_POWER = 1e-6  # of the largest that a wave has in the draws, below which nothing is left of it
SIZE, JUMPS = "size", "jumps"  # less size than expected is as odd as more
SETTLED = (SIZE, "correlation in time")  # by the evidence of a process
LINE = "line of any period"
LARGEST = (LINE,)  # statistics that are a largest value


@dataclass(frozen=True)
class Layout:
    """What each observation of a linear model stands for.

    Attributes
    ----------
    axes : (r, 3, 3) rotation of each observation's three rows to body axes
    t_s : (r,) time, s
    since_s : (r,) time since the interval's start, s
    interval : (r,) its number
    regressors : (r, q) what the innovations may depend on, such as rates, accelerations and temperatures
    activity : (r,) what their variance may depend on, the size of the rate
    """

    axes: Array
    t_s: Array
    since_s: Array
    interval: Indices
    regressors: Array
    activity: Array


def of_innovations(e: Array, layout: Layout) -> dict[str, Array]:
    """(d,) each statistic of e (r, 3, d)."""
    out = {
        SIZE: np.sum(e**2, axis=(0, 1)),
        "shape": np.sum(e**4, axis=(0, 1)),
        "correlation in time": _autocorrelation(e, layout.interval),
        "variance over the intervals": _spread_over(e, layout.interval),
        "variance with the rate": _along(np.sum(e**2, axis=1, keepdims=True) - 3, layout.activity[:, None]),
        "dependence on what is known": _along(e, layout.regressors),
    }
    lines = _lines(e, layout)
    if lines is not None:
        out[LINE] = lines
    return out


def of_process(e: Array, layout: Layout) -> dict[str, Array]:
    """(d,) each statistic of the estimates e (r, 3, d) of a process, but those that its evidence has settled."""
    out = {name: values for name, values in of_innovations(e, layout).items() if name not in SETTLED}
    changes = _geary(np.diff(e, axis=0)[np.diff(layout.interval) == 0])
    out[JUMPS] = 1 / np.maximum(changes, TINY)
    return out


def _geary(e: Array) -> Array:
    """(d,) mean size of e (r, 3, d), over its RMS: near one if it is flat, small if it is peaked (Geary 1935)."""
    size = np.linalg.norm(e, axis=1)
    return np.asarray(np.mean(size, axis=0) / np.maximum(np.sqrt(np.mean(size**2, axis=0)), TINY))


def _autocorrelation(e: Array, interval: Indices) -> Array:
    total = np.zeros(e.shape[2])
    for lag in range(1, LAGS + 1):
        if lag >= len(e):
            break
        alike = interval[lag:] == interval[:-lag]
        products = np.sum(e[lag:][alike] * e[:-lag][alike], axis=0)  # (3, d)
        total += np.sum(products**2, axis=0) / max(int(alike.sum()), 1)
    return total


def _spread_over(e: Array, interval: Indices) -> Array:
    total = np.zeros(e.shape[2])
    for number in np.unique(interval):
        own = np.sum(e[interval == number] ** 2 - 1, axis=0)  # (3, d)
        total += np.sum(own**2, axis=0) / (2 * np.sum(interval == number))
    return total


def _along(values: Array, regressors: Array) -> Array:
    """Square sum of the components of values (r, 3, d) along the regressors (r, q)."""
    centred = regressors - regressors.mean(axis=0)
    size = np.linalg.norm(centred, axis=0)
    if not np.any(size > 0):
        return np.ones(values.shape[2])
    unit = scipy.linalg.orth(centred[:, size > 0] / size[size > 0])
    return np.asarray(np.sum(np.einsum("rq,rad->qad", unit, values) ** 2, axis=(0, 1)))


def _lines(e: Array, layout: Layout) -> Array | None:
    """Strongest line of any period, its phase another in each interval; None if the arcs are too short."""
    longest = float(layout.since_s.max())
    gaps = np.diff(layout.t_s)[(np.diff(layout.interval) == 0) & (np.diff(layout.t_s) > 0)]
    if not gaps.size or longest < 8 * float(np.median(gaps)):
        return None
    # Nearer to half the rate of the observations a wave has no phase of its own, and its power another distribution.
    frequencies = np.linspace(1 / longest, 0.5 / float(np.median(gaps)) - 1 / longest, PERIODS)
    return _strongest(e, layout.interval, 2 * np.pi * np.outer(frequencies, layout.since_s))


def _strongest(e: Array, interval: Indices, angle: Array) -> Array | None:
    """Strongest wave of some phases (f, r) but for one in each interval; None if no interval is long enough.

    The power at one frequency about one axis has a gamma distribution under the named model. Its shape would be one for each
    interval, but where a body hardly turns the wave has no phase of its own, and the parameters that are fitted take a part of
    its power: shape and scale are those that give the mean and the variance of the draws. The strongest is the one whose cube
    root is the most sigmas too large (Wilson & Hilferty 1931), and is told by the natural logarithm of the chance of so much
    power, with the sign turned.
    """
    power = np.zeros((len(angle), 3, e.shape[2]))
    long_enough = False
    for number in np.unique(interval):
        own = interval == number
        if own.sum() < 4:
            continue
        power += np.abs(np.einsum("fr,rad->fad", np.exp(-1j * angle[:, own]), e[own])) ** 2 / own.sum()
        long_enough = True
    if not long_enough:
        return None
    usual = power[:, :, 1:].mean(axis=2)
    if not usual.any():
        return np.zeros(e.shape[2])
    power = power[usual > LEAST_POWER * usual.max()]
    mean, variance = power[:, 1:].mean(axis=1), power[:, 1:].var(axis=1)
    shape, scale = mean**2 / variance, variance / mean
    away = np.sqrt(9 * shape)[:, None] * (np.cbrt(power / mean[:, None]) - 1 + 1 / (9 * shape)[:, None])
    one = np.argmax(away, axis=0)
    return np.asarray(-scipy.stats.gamma.logsf(power[one, np.arange(one.size)], shape[one], scale=scale[one]))
