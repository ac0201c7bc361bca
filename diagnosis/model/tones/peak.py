"""The frequency at which the innovations of all references have a tone that their averages do not show.

Under white noise the power of n innovations at a frequency is exponential, and its sum over some intervals has a gamma
distribution with a shape of one for each. An interval counts up to half the rate of its own references: beyond that it shows
its slow errors once more. Noise that is not white has another level at each frequency: a tone stands out of the median of those
around it as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.stats
from numpy.typing import NDArray

from diagnosis.model.misfit import innovations
from diagnosis.model.recording import RecordingModel

Array = NDArray[np.float64]

SHORTEST = 16  # innovations of an interval, from which on its spectrum counts
FEWEST = 2.0  # periods in the longest interval
SLOW = 2.5  # spacings of the averages, from which period on these show a tone themselves
AT_ONCE = 1000  # frequencies
AROUND = 40  # frequencies to either side of one, whose median is the level that it stands out of
TINY = 1e-300


@dataclass(frozen=True)
class Peak:
    """A frequency that stands out, the step between those that were tried, Hz, and the p-value of it under white noise."""

    frequency_hz: float
    step_hz: float
    p_value: float


def strongest(model: RecordingModel, p_least: float) -> Peak | None:
    """The tone that stands out most; None where it does not, or where the averages show it themselves."""
    e, later, _ = innovations(model)
    interval, t_s = model.interval_of_reference[later], model.references.t_s[later]
    parts = [own for own in (np.flatnonzero(interval == k) for k in np.unique(interval)) if own.size >= SHORTEST]
    if not parts:
        return None
    spacings = [float(np.median(np.diff(t_s[own]))) for own in parts]
    spacing = float(np.median(np.concatenate([np.diff(t_s[own]) for own in parts])))
    longest = max(float(np.ptp(t_s[own])) for own in parts)
    step = 0.5 / longest
    frequencies = np.arange(FEWEST / longest, 0.5 / spacing - step, step)
    averages = spacing * float(np.median(np.concatenate([block.counts for block in model.blocks])))
    fast = frequencies > 1 / (SLOW * averages)
    if not fast.any():
        return None
    power, count = np.zeros((frequencies.size, 3)), np.zeros((frequencies.size, 1))
    for own, its in zip(parts, spacings, strict=True):
        shown = int(np.searchsorted(frequencies, 0.5 / its + 0.5 * step))
        power[:shown] += powers(e[own], t_s[own], frequencies[:shown])
        count[:shown] += 1
    noise = scipy.stats.gamma(np.maximum(count, 1))  # of white noise of variance one
    around = scipy.ndimage.median_filter(power / noise.median(), size=(min(2 * AROUND + 1, len(power)), 1), mode="nearest")
    level = np.maximum(around, power.sum(axis=0) / count.sum())  # the noise around it, where it is not white
    log_p = noise.logsf(power / level) + np.log(power.size)
    log_p[~fast | (count[:, 0] == 0)] = 0.0
    place = int(np.argmin(log_p.min(axis=1)))
    p = float(np.exp(min(log_p[place].min(), 0.0)))
    return Peak(float(frequencies[place]), step, max(p, TINY)) if p < p_least else None


def powers(e: Array, t_s: Array, frequencies: Array) -> Array:
    """(f, 3) power of innovations (k, 3), one in the mean if they are white noise of variance one."""
    x, t = e - e.mean(axis=0), t_s - t_s.mean()
    some = (frequencies[k : k + AT_ONCE] for k in range(0, frequencies.size, AT_ONCE))
    return np.concatenate([np.abs(np.exp(-2j * np.pi * np.outer(f, t)) @ x) ** 2 for f in some]) / len(x)
