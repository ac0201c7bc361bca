"""Families of fibre-optic, ring-laser and hemispherical resonator gyros."""

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import gauss_markov
from studies.validation.world.families.base import families, rate, samples
from studies.validation.world.families.look import Look, changed


@samples("threshold", "deg/s", "turns", sign="positive")
def lock_in(look: Look, values: Array, size: float) -> Array:
    """Rates below a limit lock, and above it read sign · √(rate² − limit²). Backscatter couples the two beams of a ring laser
    (Aronowitz, Fundamentals of the Ring Laser Gyro, 1999)."""
    own = values[:, look.k]
    return changed(values, look.k, np.sign(own) * np.sqrt(np.maximum(own**2 - size**2, 0.0)))


@rate("deg/s", "turns")
def backscatter(look: Look) -> Array:
    """Rate error swings with the angle turned. Backscatter adds the sine of the beat's phase (Aronowitz, Fundamentals of the
    Ring Laser Gyro, 1999)."""
    return np.sin(look.scaled(0.7, 15.0) * look.turned[:, look.k] + look.phase)


@samples("pickup", "deg/s", sign="positive")
def dither_spill(look: Look, values: Array, size: float) -> Array:
    """A narrow band of noise stays of the dither. It is stripped imperfectly and its amplitude is randomised (IEEE Std 647)."""
    coherent = look.sample_s * look.scaled(20.0, 300.0)
    sine, cosine = (gauss_markov(look.rng, look.t, coherent) for _ in range(2))
    angle = 2 * np.pi * (0.28 + 0.18 * look.share) * look.t / look.sample_s
    return changed(values, look.k, values[:, look.k] + size * (sine * np.sin(angle) + cosine * np.cos(angle)))


@samples("range", "share", "turns", sign="positive")
def fringe_jump(look: Look, values: Array, size: float) -> Array:
    """Fast rates read low by a constant. The closed loop locks to the next fringe (Lefèvre, The Fiber-Optic Gyroscope)."""
    limit = look.fastest * (0.3 + 0.5 * look.share)
    own = values[:, look.k]
    return changed(values, look.k, own - np.where(np.abs(own) > limit, np.sign(own) * size * limit, 0.0))


@rate("deg/h", "turns")
def pattern_angle(look: Look) -> Array:
    """Bias depends on where the vibration pattern stands. It turns by 0.28 of the body's angle, and damping differs around the
    shell (Lynch, whole-angle resonator gyros, IEEE Std 1431)."""
    angle = 0.28 * look.turned[:, look.k]
    return np.sin(4 * angle + look.phase) + 0.4 * np.sin(2 * angle - look.phase)


@rate("deg/h")
def quadrature_chop(look: Look) -> Array:
    """Bias changes its sign at intervals that grow. A chopper that exchanges drive and sense runs out of step (IEEE Std
    1431)."""
    return np.sign(np.sin(look.cycle(0.05, 0.25) * (1 + 0.3 * look.elapsed)))


@rate("deg/h", "turns", "orbit")
def faraday(look: Look) -> Array:
    """Bias follows the Earth's magnetic field along the coil. It turns polarisation, and a dipole field turns twice an orbit
    (Lefèvre, The Fiber-Optic Gyroscope, Faraday effect)."""
    angle = 2 * np.pi * look.t / look.stream.orbit_period_s + look.phase
    field = np.stack([np.cos(angle), 0.4 + 0 * angle, 2 * np.sin(angle)], axis=1)
    return np.einsum("nj,nj->n", look.attitude[:, look.k], field) * np.sqrt(1 + 3 * np.sin(angle) ** 2)


@rate("deg/h")
def kerr(look: Look) -> Array:
    """Bias follows the optical power, which decays in strokes. The index depends on intensity, and the source is re-tuned now
    and then (Lefèvre, The Fiber-Optic Gyroscope, Kerr effect)."""
    return np.exp(-3 * np.mod(look.cycle(0.2, 1.0) / (2 * np.pi), 1.0)) ** (1 + look.share)


@samples("pickup", "deg/s", sign="positive")
def mode_hop(look: Look, values: Array, size: float) -> Array:
    """Readings are off for a few samples around random instants. The laser hops to another mode (IEEE Std 647)."""
    chance = look.scaled(2e-4, 2e-3)
    hops = np.flatnonzero(look.rng.random(len(values)) < chance)
    shape = np.zeros(len(values))
    for hop in hops.tolist():
        last = min(hop + 12, len(values))
        shape[hop:last] += look.rng.choice([-1.0, 1.0]) * np.exp(-np.arange(last - hop) / 4)
    return changed(values, look.k, values[:, look.k] + size * shape)


@rate("ppm", "turns")
def loop_gain(look: Look) -> Array:
    """Scale factor sags under sustained rate. Gain of a closed loop falls with its slow mean (IEEE Std 952)."""
    return -look.own * look.smooth(np.abs(look.own), look.between(0.01, 0.1)) / look.fastest


EFFECTS = families(globals())
