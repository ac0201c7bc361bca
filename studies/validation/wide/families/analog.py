"""Families of analog electronics: converters, holds, amplifiers and supplies."""

import numpy as np
from scipy.signal import lfilter

from simulator.effects.base import Array
from studies.validation.wide.families.base import families, samples
from studies.validation.wide.families.look import Look, changed


def _place(look: Look) -> Array:
    """(n,) number of the sample in its interval."""
    return look.each(lambda p: np.arange(float(p.stop - p.start)))


@samples("resolution", "deg/s", sign="positive")
def carry_glitch(look: Look, values: Array, size: float) -> Array:
    """A sample jumps whenever the reading passes one value. All bits of a converter change there, and not at once (IEEE Std
    1241, glitches)."""
    own = values[:, look.k]
    above = (own > np.quantile(own, 0.1 + 0.8 * look.share)).astype(float)
    passed = look.each(lambda p: np.diff(above[p], prepend=above[p.start]))
    return changed(values, look.k, own + size * np.abs(passed))


@samples("telemetry", "share", "turns", sign="positive")
def hold_droop(look: Look, values: Array, size: float) -> Array:
    """Readings sink toward zero until they are refreshed. A hold capacitor leaks between two refreshes (IEEE Std 1241, droop of
    sample and hold)."""
    count = int(look.scaled(4, 60))
    return changed(values, look.k, values[:, look.k] * (1 - size * np.mod(_place(look), count) / count))


@samples("range", "share", "turns", sign="positive")
def brownout(look: Look, values: Array, size: float) -> Array:
    """Readings shrink at random instants and grow back. The supply of the read-out dips and recovers (IEEE Std 952, supply
    interruptions)."""
    hits = (look.rng.random(len(values)) < look.scaled(5e-4, 5e-3)).astype(float)
    shape = np.minimum(lfilter([1.0], [1.0, -np.exp(-1 / look.scaled(3.0, 40.0))], hits), 1.0)
    return changed(values, look.k, values[:, look.k] * (1 - size * shape))


@samples("resolution", "share", "turns", sign="positive")
def interleaved_gain(look: Look, values: Array, size: float) -> Array:
    """Every other reading is too large, those between too small. Two converters take turns, and their gains differ (IEEE Std
    1241, interleaved converters)."""
    side = 1 - 2 * np.mod(_place(look), 2)
    return changed(values, look.k, values[:, look.k] * (1 + size * side))


EFFECTS = families(globals())
