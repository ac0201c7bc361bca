"""Families of computers on board and on the ground: clocks, buffers, coding, units in redundancy and their tables."""

from itertools import pairwise

import numpy as np

from simulator.effects.base import Array
from studies.validation.world.families.base import families, random_rate, rate, samples, timing
from studies.validation.world.families.look import Look, changed, delayed


def _index_intervals(look: Look) -> Array:
    """(n,) number of the sample's interval."""
    return np.repeat(np.arange(len(look.stream.intervals)), [p.stop - p.start for p in look.stream.intervals])


@timing("clock", "s", "turns")
def interval_offsets(look: Look, raw: Array, size: float) -> Array:
    """The tags are off by another time in each interval. The clock is set by hand at each switching on (CCSDS 301.0, time
    codes)."""
    offsets = look.rng.standard_normal(len(look.stream.intervals))
    return delayed(look, raw, size * offsets[_index_intervals(look)])


@timing("clock", "s", "turns", "temperature")
def crystal_temperature(look: Look, raw: Array, size: float) -> Array:
    """The tags wander as the temperature adds up. The crystal's frequency follows it, and the clock sums that (IEEE Std
    1139)."""
    error = look.each(lambda p: np.cumsum(look.temperature[p] - look.temperature[p].mean()))
    return delayed(look, raw, size * error / max(float(np.abs(error).max()), 1e-30))


@samples("telemetry", "share", "turns", sign="positive")
def stale_start(look: Look, values: Array, size: float) -> Array:
    """An interval begins with samples of the one before. The buffer was not emptied (CCSDS 133.0, space packets)."""
    out, parts = values.copy(), look.stream.intervals
    for before, p in pairwise(parts):
        count = min(int(size * (p.stop - p.start)), before.stop - before.start)
        out[p.start : p.start + count] = values[before.stop - count : before.stop]
    return out


@samples("resolution", "deg/s", sign="positive")
def sign_lost(look: Look, values: Array, size: float) -> Array:
    """Small readings have lost their sign. They are coded by sign and magnitude, and the sign is decided too late (IEEE Std
    1241)."""
    own = values[:, look.k]
    return changed(values, look.k, np.where(np.abs(own) < size, np.abs(own), own))


@samples("telemetry", "deg/s", sign="positive")
def send_on_change(look: Look, values: Array, size: float) -> Array:
    """A reading stays until the next differs enough. Only changes are sent, to spare the link (CCSDS 121.0, compression)."""
    own = values[:, look.k].copy()
    for p in look.stream.intervals:
        at = own[p.start]
        for row in range(p.start, p.stop):
            if abs(own[row] - at) > size:
                at = own[row]
            own[row] = at
    return changed(values, look.k, own)


@samples("resolution", "share", sign="positive")
def block_exponent(look: Look, values: Array, size: float) -> Array:
    """Readings are rounded in proportion to the largest of their block. A block shares one exponent (block floating point)."""
    own = values[:, look.k]
    begin = np.concatenate([np.arange(p.start, p.stop, int(look.scaled(8, 128))) for p in look.stream.intervals])
    largest = np.repeat(np.maximum.reduceat(np.abs(own), begin), np.diff(np.append(begin, len(own))))
    step = size * 2.0 ** np.floor(np.log2(np.maximum(largest, 1e-15)))
    return changed(values, look.k, step * np.round(own / step))


@samples("telemetry", "share", "turns", sign="positive")
def gaps_closed(look: Look, values: Array, size: float) -> Array:
    """Samples get earlier and earlier through an interval. Lost ones are not marked, and the rest closes up (CCSDS 133.0, space
    packets)."""
    out = values.copy()
    for p in look.stream.intervals:
        lost = np.cumsum(look.rng.random(p.stop - p.start) < 0.02 * size)
        out[p] = values[np.minimum(np.arange(p.start, p.stop) + lost, p.stop - 1)]
    return out


@random_rate("ppm", "turns")
def unit_switch(look: Look) -> Array:
    """Scale factors and axes are those of another unit through random spells. A redundant unit is switched to and back (Wertz,
    Spacecraft Attitude Determination and Control, redundant gyros)."""
    dwell, other = look.between(0.1, 0.6), look.rng.standard_normal((3, 3))
    on = np.empty(len(look.t))
    for p in look.stream.intervals:
        seconds = look.since_start[p]
        jumps = np.cumsum(look.rng.exponential(dwell, int(10 + 4 * seconds[-1] / dwell)))
        on[p] = (np.searchsorted(jumps, seconds) + int(look.rng.integers(2))) % 2
    return on[:, None] * (look.w @ other.T)


@rate("ppm", "turns")
def table_mixup(look: Look) -> Array:
    """Some intervals have other scale factors and axes. They were compensated by an outdated table (Wertz, Spacecraft Attitude
    Determination and Control, calibration tables)."""
    outdated = look.rng.random(len(look.stream.intervals)) < 0.5
    return outdated[_index_intervals(look)][:, None] * (look.w @ look.rng.standard_normal((3, 3)).T)


@samples("telemetry", "share", "turns", sign="positive")
def read_jitter(look: Look, values: Array, size: float) -> Array:
    """A random part of each sample's angle counts for the next. A counter is read a little early or late (IEEE Std 647, pulse
    accumulation)."""
    own = values[:, look.k].copy()
    for p in look.stream.intervals:
        moved = size * look.rng.standard_normal(p.stop - p.start - 1) * own[p][:-1]
        own[p] += np.append(0.0, moved) - np.append(moved, 0.0)
    return changed(values, look.k, own)


EFFECTS = families(globals())
