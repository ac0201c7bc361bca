"""Families of vibrating gyros: quartz forks, silicon rings and wineglass shells."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.wide.families.base import families, rate, samples
from studies.validation.wide.families.look import Look, changed


@rate("ppm", "turns")
def amplitude_hunting(look: Look) -> Array:
    """Scale factor swings to and fro. The loop that holds the amplitude of the vibration hunts around it (IEEE Std 1431,
    amplitude control)."""
    return look.own * np.sin(look.cycle(0.03, 0.3))


@rate("ppm", "turns")
def spin_softening(look: Look) -> Array:
    """Scale factor falls with the square of the rate across the axis. Centrifugal force softens the suspension and detunes the
    two modes (IEEE Std 1431, mode frequencies)."""
    across = (look.w**2).sum(axis=1) - look.own**2
    return -look.own * across / look.fastest**2


@samples("pickup", "deg/s", sign="positive")
def ringdown_noise(look: Look, values: Array, size: float) -> Array:
    """White noise grows until the resonator is driven again. It rings down freely, and its signal sinks into the noise of the
    buffer (IEEE Std 1431, free ring-down of shells)."""
    share = np.mod(look.cycle(0.1, 0.7) / (2 * np.pi), 1.0)
    return values + size * np.exp(3 * (share - 1))[:, None] * look.rng.standard_normal(values.shape)


@rate("deg/h")
def dielectric_charging(look: Look) -> Array:
    """Bias creeps between two values whenever a polarity is reversed. Charge moves into and out of the oxide below the
    electrodes (IEEE Std 1431, electrostatic forcers)."""
    cycle = look.cycle(0.2, 1.0)
    turn = float(2 * np.pi * look.sample_s / max(np.median(np.diff(cycle)), 1e-12))
    return look.smooth(np.sign(np.sin(cycle)), max((0.05 + 0.3 * look.share) * turn, 2 * look.sample_s))


@samples("range", "share", "turns", sign="positive")
def overload_hold(look: Look, values: Array, size: float) -> Array:
    """Readings stand still for a while after each fast turn. An overloaded amplifier recovers slowly, and the processor holds
    what it had (IEEE Std 1431, overload recovery)."""
    own = values[:, look.k].copy()
    limit, wait = (1 - size) * look.fastest, int(look.scaled(4, 60))
    for p in look.stream.intervals:
        row = p.start + 1
        while row < p.stop:
            if abs(own[row]) > limit:
                last = min(row + wait, p.stop)
                own[row:last] = own[row - 1]
                row = last
            row += 1
    return changed(values, look.k, own)


@rate("deg/s")
def self_test(look: Look) -> Array:
    """Short pulses come at regular times. The built-in test is not masked out (IEEE Std 1431, self-test)."""
    period = look.between(0.04, 0.3)
    width = max(0.02 * period, 2 * look.sample_s)
    return (np.mod(look.t + look.share * period, period) < width).astype(float)


EFFECTS = families(globals())
