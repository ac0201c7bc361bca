"""Further families of fibre-optic and ring-laser gyros: resets, reversals, sources and cavities."""

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import gauss_markov
from studies.validation.wide.families.base import families, random_rate, rate, samples
from studies.validation.wide.families.look import Look, changed


def _crossings(look: Look, values: Array) -> Array:
    """(n,) how many steps of one a value has gone since the sample before, within an interval."""
    return look.each(lambda p: np.diff(np.floor(values[p]), prepend=np.floor(values[p.start])))


@rate("ppm", "turns")
def reset_glitch(look: Look) -> Array:
    """A fixed angle is lost or won at each reset of the phase ramp. The ramp's height is not a whole fringe (Lefèvre, The
    Fiber-Optic Gyroscope, serrodyne modulation)."""
    angle = look.turned[:, look.k]
    step = max(float(np.ptp(angle)), 1e-9) / look.scaled(8.0, 80.0)
    return _crossings(look, angle / step + look.share) * step / look.sample_s


@random_rate("deg", "turns")
def reversal_kick(look: Look) -> Array:
    """A random angle is left at each reversal of the rate. The beat stands still for a moment, and locks in an unknown phase
    (Aronowitz, Fundamentals of the Ring Laser Gyro, 1999)."""
    side = (look.own > np.median(look.own)).astype(float)
    return _crossings(look, side) * look.rng.standard_normal(len(look.t)) / look.sample_s


@rate("deg/h", "temperature")
def cavity_steps(look: Look) -> Array:
    """Bias has a value of its own in each band of the temperature. The control of the cavity's length jumps to the next mode
    when its actuator is at its end (IEEE Std 647, mode shifts)."""
    step = max(float(np.ptp(look.temperature)), 1e-9) / look.scaled(2.5, 10.0)
    band = np.floor(look.temperature / step + look.share).astype(int)
    return look.rng.standard_normal(int(np.ptp(band)) + 1)[band - band.min()]


@random_rate("ppm", "turns")
def source_wander(look: Look) -> Array:
    """Scale factors of all axes wander together. They share one light source, whose wavelength is not steady (Lefèvre, The
    Fiber-Optic Gyroscope, source)."""
    return look.w * gauss_markov(look.rng, look.t, look.between(0.05, 0.5))[:, None]


@samples("pickup", "deg/s", sign="positive")
def breathing_noise(look: Look, values: Array, size: float) -> Array:
    """White noise swells and falls at random. Optical power fades as polarisation wanders in the fibre (Lefèvre, The
    Fiber-Optic Gyroscope, polarisation fading)."""
    fading = np.exp(gauss_markov(look.rng, look.t, look.between(0.02, 0.3)))
    noise = fading * look.rng.standard_normal(len(values))
    return changed(values, look.k, values[:, look.k] + size * noise)


EFFECTS = families(globals())
