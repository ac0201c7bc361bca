"""Families with electrical causes: supplies, converters, detectors and what is picked up."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.wide.families.base import families, random_rate, rate, samples
from studies.validation.wide.families.look import Look, changed


@rate("deg/h")
def supply_beat(look: Look) -> Array:
    """Bias beats. Two converters of nearly the same clock intermodulate, and the beat is modulated in turn (IEEE Std 952,
    supply ripple)."""
    return np.sin(look.cycle(0.02, 0.1)) * (1 + np.sin(2 * np.pi * look.t / look.between(0.2, 0.7)))


@random_rate("deg/h")
def telegraph(look: Look) -> Array:
    """Bias jumps between two values at random. A trap in a transistor is filled and emptied (IEEE Std 1431, burst or popcorn
    noise)."""
    dwell, now = look.between(0.03, 0.3), look.rng.random() < 0.5
    out = np.empty(len(look.t))
    for p in look.stream.intervals:
        seconds = look.t[p] - look.t[p.start]
        jumps = np.cumsum(look.rng.exponential(dwell, int(10 + 4 * seconds[-1] / dwell)))
        out[p] = (np.searchsorted(jumps, seconds) + now) % 2
    return out


@rate("deg/h", "turns")
def supply_droop(look: Look) -> Array:
    """Bias follows what the actuators draw. The bus sags with the torque, whichever its sign (IEEE Std 952, supply
    sensitivity)."""
    load = np.linalg.norm(look.acceleration, axis=1)
    slow = look.smooth(load, look.between(0.002, 0.02))
    return slow / max(float(slow.max()), 1e-30)


@rate("ppm", "turns")
def rectified_crosstalk(look: Look) -> Array:
    """An axis picks up the amount of the rate about another. Leakage of the other channel is rectified (IEEE Std 1431,
    cross-axis sensitivity)."""
    return np.abs(look.w[:, look.other])


@rate("deg/s", "turns")
def converter_waves(look: Look) -> Array:
    """Reading errs in waves over its range. A converter's integral nonlinearity (IEEE Std 1241)."""
    return np.sin(2 * np.pi * look.own / (look.fastest * look.scaled(0.15, 1.5)) + look.phase)


@rate("ppm", "turns")
def bridge_cubic(look: Look) -> Array:
    """Reading errs with the cube of the rate. A pick-off bridge saturates softly (IEEE Std 1431, scale factor
    nonlinearity)."""
    return look.own**3 / look.fastest**2


@samples("resolution", "deg/s", sign="positive")
def missing_codes(look: Look, values: Array, size: float) -> Array:
    """Readings in a band are those at its edge. A converter misses codes (IEEE Std 1241)."""
    middle = np.quantile(values[:, look.k], 0.1 + 0.8 * look.share)
    inside = np.abs(values[:, look.k] - middle) < 0.5 * size
    return changed(values, look.k, np.where(inside, middle + 0.5 * size, values[:, look.k]))


@samples("pickup", "deg/s", "turns", sign="positive")
def noise_with_rate(look: Look, values: Array, size: float) -> Array:
    """White noise grows with the rate. Noise of a reference multiplies the signal (Lefèvre, The Fiber-Optic Gyroscope, relative
    intensity noise)."""
    noise = look.rng.standard_normal(len(values)) * np.abs(look.own) / look.fastest
    return changed(values, look.k, values[:, look.k] + size * noise)


@samples("pickup", "deg/s", sign="positive")
def noise_bursts(look: Look, values: Array, size: float) -> Array:
    """White noise comes in bursts. A transmitter is keyed now and then (IEEE Std 952, electromagnetic interference)."""
    on = np.mod(look.cycle(0.1, 0.6) / (2 * np.pi), 1.0) < 0.1 + 0.25 * look.share
    return values + size * on[:, None] * look.rng.standard_normal(values.shape)


@samples("pickup", "deg/s", sign="positive")
def common_noise(look: Look, values: Array, size: float) -> Array:
    """Two axes share a part of their noise. They have one voltage reference (IEEE Std 1431)."""
    shared = look.rng.standard_normal(len(values))
    out = changed(values, look.k, values[:, look.k] + size * shared)
    return changed(out, look.other, out[:, look.other] + size * shared)


@samples("pickup", "deg/s", sign="positive")
def chirp(look: Look, values: Array, size: float) -> Array:
    """A tone sweeps through the band. A free-running oscillator drifts against the sampling (IEEE Std 952, interference)."""
    high = 0.5 / look.sample_s
    sweep = (0.25 + 0.7 * look.elapsed) * high
    tone = np.sin(2 * np.pi * np.cumsum(sweep * look.stream.duration_s) + look.phase)
    return changed(values, look.k, values[:, look.k] + size * tone)


@random_rate("deg/h")
def torque_rods(look: Look) -> Array:
    """Bias takes one of three values, slot by slot. Magnetic torquers are driven forward, backward or not (Wertz, Spacecraft
    Attitude Determination and Control)."""
    slot = np.floor((look.t - look.t[0]) / look.between(0.005, 0.04)).astype(int)
    return look.rng.choice([-1.0, 0.0, 1.0], int(slot.max()) + 1)[slot]


@samples("pickup", "ppm", "turns", sign="positive")
def carrier_leak(look: Look, values: Array, size: float) -> Array:
    """A tone appears whose height goes with the rate. The carrier leaks through the demodulator while there is signal (IEEE Std
    1431)."""
    tone = np.sin(2 * np.pi * look.scaled(0.27, 0.45) * look.t / look.sample_s + look.phase)
    return changed(values, look.k, values[:, look.k] + size * tone * look.own)


EFFECTS = families(globals())
