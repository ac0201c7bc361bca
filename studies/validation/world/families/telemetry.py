"""Families of timing, packets and telemetry."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.world.families.base import families, samples, timing
from studies.validation.world.families.look import Look, changed, delayed


def _draw_hit_packets(look: Look, size: float) -> tuple[int, Array]:
    """Samples in a packet, and where the packets begin that are hit, such a share of them; never at an interval's ends."""
    length = int(look.scaled(2, 16))
    starts = np.concatenate([np.arange(p.start + length, p.stop - 2 * length, length) for p in look.stream.intervals])
    return length, starts[look.rng.random(len(starts)) < size]


@timing("clock", "ppm", "turns")
def clock_drift(look: Look, raw: Array, size: float) -> Array:
    """The tags run away from the references' clock. The oscillator is off its frequency (IEEE Std 1139)."""
    return delayed(look, raw, size * (look.t - look.t[0]))


@timing("clock", "s", "turns")
def clock_resets(look: Look, raw: Array, size: float) -> Array:
    """The tags drift and are set right again and again. The clock is synchronised at intervals (CCSDS 301.0, time codes)."""
    return delayed(look, raw, size * np.mod(look.cycle(0.1, 0.6) / (2 * np.pi), 1.0))


@timing("clock", "s", "turns", sign="positive")
def clock_jitter(look: Look, raw: Array, size: float) -> Array:
    """Each packet is late by a time of its own. The bus is shared (MIL-STD-1553)."""
    packet = np.arange(len(look.t)) // int(look.scaled(2, 20))
    return delayed(look, raw, size * look.rng.random(int(packet[-1]) + 1)[packet])


@timing("clock", "s", "turns", sign="positive")
def load_delay(look: Look, raw: Array, size: float) -> Array:
    """Samples are late while it turns. The processor has more to do then, and tags what it sends (MIL-STD-1553)."""
    load = look.smooth(np.linalg.norm(look.w, axis=1), look.between(0.005, 0.05))
    return delayed(look, raw, size * load / max(float(load.max()), 1e-30))


@timing("filter", "s", "turns")
def axis_skew(look: Look, raw: Array, size: float) -> Array:
    """Axes are sampled one after another. A multiplexer has one converter for the three (IEEE Std 1241)."""
    skew = np.zeros((len(raw), 3))
    skew[:, look.k], skew[:, look.other] = size, -size
    return delayed(look, raw, skew)


@samples("telemetry", "share", "turns", sign="positive")
def packets_swapped(look: Look, values: Array, size: float) -> Array:
    """Some packets come in the wrong order. The ground joins them as they arrive (CCSDS 133.0, space packets)."""
    length, starts = _draw_hit_packets(look, size)
    out = values.copy()
    for start in starts[::2]:
        first, second = slice(start - length, start), slice(start, start + length)
        out[first], out[second] = values[second], values[first]
    return out


@samples("telemetry", "share", sign="positive")
def packets_interpolated(look: Look, values: Array, size: float) -> Array:
    """Lost packets are filled by straight lines. The ground repairs gaps (CCSDS 133.0, space packets)."""
    length, starts = _draw_hit_packets(look, size)
    out = values.copy()
    for start in starts:
        share = np.arange(1, length + 1)[:, None] / (length + 1)
        out[start : start + length] = (1 - share) * values[start - 1] + share * values[start + length]
    return out


@samples("telemetry", "share", sign="positive")
def packets_averaged(look: Look, values: Array, size: float) -> Array:
    """Some packets hold their mean throughout. The link changes to a lower rate now and then (CCSDS 121.0, compression)."""
    length, starts = _draw_hit_packets(look, size)
    out = values.copy()
    for start in starts:
        out[start : start + length] = values[start : start + length].mean(axis=0)
    return out


@samples("telemetry", "share", sign="positive")
def packets_slipped(look: Look, values: Array, size: float) -> Array:
    """Samples of some packets stand one place late. One word at their head is read twice (CCSDS 133.0, space packets)."""
    length, starts = _draw_hit_packets(look, size)
    out = values.copy()
    for start in starts:
        out[start + 1 : start + length] = values[start : start + length - 1]
    return out


@samples("telemetry", "share", sign="positive")
def bit_errors(look: Look, values: Array, size: float) -> Array:
    """Single bits of words are turned. The link has errors that no code mends (CCSDS 131.0, synchronisation and coding)."""
    own = values[:, look.k]
    full = max(float(np.abs(own).max()), 1e-12)
    weights = full * 2.0 ** -np.arange(1.0, 12.0)
    hit = look.rng.random(len(own)) < 0.02 * size
    return changed(values, look.k, own + hit * look.rng.choice([-1.0, 1.0], len(own)) * look.rng.choice(weights, len(own)))


@samples("telemetry", "share", "turns", sign="positive")
def axes_exchanged(look: Look, values: Array, size: float) -> Array:
    """Two axes are exchanged in some packets. Words stand in another order after a restart (CCSDS 133.0, space packets)."""
    length, starts = _draw_hit_packets(look, size)
    out = values.copy()
    for start in starts:
        rows = slice(start, start + length)
        out[rows, look.k], out[rows, look.other] = values[rows, look.other], values[rows, look.k]
    return out


EFFECTS = families(globals())
