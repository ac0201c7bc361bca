"""Families of on-board processing: filters, compensation, fixed-point arithmetic."""

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import lfilter

from simulator.effects.base import Array
from simulator.effects.common import DEG_H
from studies.validation.world.families.base import families, rate, samples, timing
from studies.validation.world.families.look import Look, changed


@timing("filter", "share", "turns")
def peaking(look: Look, raw: Array, size: float) -> Array:
    """The output overshoots changes of rate. A digital filter peaks before its cut-off (Savage, Strapdown Analytics)."""
    slow = look.smooth(raw[:, look.k], look.between(0.002, 0.02))
    return changed(raw, look.k, raw[:, look.k] + size * (raw[:, look.k] - slow))


@samples("telemetry", "share", sign="positive")
def smoothed_output(look: Look, values: Array, size: float) -> Array:
    """Each sample holds a part of the one before. The processor smooths what it sends (Savage, Strapdown Analytics)."""
    own = values[:, look.k]
    before = look.each(lambda p: np.append(own[p.start], own[p][:-1]))
    return changed(values, look.k, (1 - size) * own + size * before)


@samples("telemetry", "share", sign="positive")
def median_blend(look: Look, values: Array, size: float) -> Array:
    """Samples lean to the median of their neighbours. A median filter against outliers is on (Savage, Strapdown Analytics)."""
    own = values[:, look.k]
    width = int(3 + 2 * np.floor(3 * look.share))
    return changed(values, look.k, own + size * (look.each(lambda p: median_filter(own[p], width, mode="nearest")) - own))


@samples("telemetry", "share", sign="positive")
def auto_zero(look: Look, values: Array, size: float) -> Array:
    """Slow rates are taken for bias and drained. The processor re-zeros itself whenever it believes to be at rest (IEEE Std
    1431, application notes of MEMS gyros)."""
    own, out = values[:, look.k], values[:, look.k].copy()
    slow = look.smooth(own, look.between(0.05, 0.3))
    rest = np.abs(slow - np.median(slow)) < max(0.1 * look.fastest, 1.0 * DEG_H)
    out -= size * np.where(rest, slow - np.median(slow), 0.0)
    return changed(values, look.k, out)


@samples("range", "share", "turns", sign="positive")
def slope_limit(look: Look, values: Array, size: float) -> Array:
    """The output changes no faster than a limit. A loop's integrator has a bound (Savage, Strapdown Analytics)."""
    own = values[:, look.k].copy()
    limit = (1 - size) * max(float(np.abs(np.diff(own[p])).max()) for p in look.stream.intervals)
    for p in look.stream.intervals:
        at = own[p.start]
        for row in range(p.start, p.stop):
            at = min(max(own[row], at - limit), at + limit)
            own[row] = at
    return changed(values, look.k, own)


@rate("s", "turns")
def coning_sign(look: Look) -> Array:
    """The product of rate and angular acceleration is added about all axes. The coning correction has a wrong sign or
    interval (Savage, Strapdown Analytics)."""
    return np.cross(look.w, look.acceleration) / max(look.fastest, 1e-12)


@rate("deg/h", "temperature")
def compensation_stairs(look: Look) -> Array:
    """Bias errs in teeth over the temperature. Its compensation is a table that is not interpolated (IEEE Std 1431)."""
    step = float(np.ptp(look.temperature)) / look.scaled(2.0, 8.0)
    share = (look.temperature + look.share * step) / max(step, 1e-30)
    return share - np.round(share)


@samples("resolution", "share", sign="positive")
def short_mantissa(look: Look, values: Array, size: float) -> Array:
    """Readings are rounded in proportion to themselves. They are sent as short floats (IEEE Std 754, half precision)."""
    step = size * 2.0 ** np.floor(np.log2(np.maximum(np.abs(values), 1e-15)))
    return np.asarray(step * np.round(values / step))


@rate("deg/h")
def register_ramp(look: Look) -> Array:
    """Bias is a saw tooth. An accumulator of the compensation overflows regularly (Savage, Strapdown Analytics)."""
    return np.mod(look.cycle(0.1, 0.9) / (2 * np.pi), 1.0) - 0.5


@rate("ppm", "turns")
def range_switch(look: Look) -> Array:
    """Scale factor is another one above a rate. The amplifier switches its range (IEEE Std 1431)."""
    return np.where(np.abs(look.own) > look.fastest * (0.2 + 0.6 * look.share), look.own, 0.0)


@samples("telemetry", "share", sign="positive")
def residual_carry(look: Look, values: Array, size: float) -> Array:
    """Noise of successive samples is anticorrelated over a few. Remainders of a conversion are carried over (IEEE Std 1241,
    noise shaping)."""
    noise = values[:, look.k] - look.stream.raw[:, look.k]
    shaped = lfilter([1.0, 0.0, -1.0], [1.0], noise) - noise
    return changed(values, look.k, values[:, look.k] + size * shaped)


EFFECTS = families(globals())
