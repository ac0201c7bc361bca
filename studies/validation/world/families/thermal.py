"""Families with thermal and environmental causes."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.world.families.base import families, rate
from studies.validation.world.families.look import Look


@rate("deg/h")
def thermal_shock(look: Look) -> Array:
    """Bias is shocked at regular instants and relaxes. Sunlight on the housing, or a pump, heats the mount in a moment and
    conduction spreads it (IEEE Std 952, thermal sensitivities)."""
    period = look.between(0.15, 1.2)
    since = np.mod(look.t - look.share * period, period)
    return np.exp(-since / (0.12 * period))


@rate("deg/h")
def warm_up(look: Look) -> Array:
    """Bias relaxes after each switching on. The electronics come to their temperature within minutes (IEEE Std 1431, turn-on
    transient)."""
    return np.exp(-look.since_start / look.between(0.03, 0.4))


@rate("deg/h")
def heater_duty(look: Look) -> Array:
    """Bias has two values, those of a heater on and off. Its duty cycle is constant (IEEE Std 952, supply sensitivity)."""
    return (np.mod(look.cycle(0.04, 0.5) / (2 * np.pi), 1.0) < 0.15 + 0.6 * look.share).astype(float)


@rate("deg/h")
def thermostat_saw(look: Look) -> Array:
    """Bias rises steadily and falls back quickly. A thermostat lets a housing cool slowly and heats it fast (IEEE Std 952)."""
    share = np.mod(look.cycle(0.04, 0.5) / (2 * np.pi), 1.0)
    return np.where(share < 0.9, share / 0.9, (1 - share) / 0.1) - 0.5


@rate("deg/h", "temperature")
def shupe(look: Look) -> Array:
    """Bias follows the rate of change of the temperature. A coil that warms unevenly is not reciprocal (Shupe, Applied Optics
    19, 1980)."""
    slow = look.smooth(look.temperature, max(60.0, look.between(0.02, 0.05)))
    change = look.each(lambda p: np.gradient(slow[p], look.t[p]) if p.stop - p.start > 1 else 0 * slow[p])
    return change / max(float(np.abs(change).max()), 1e-30)


@rate("deg/h", "temperature")
def thermal_hysteresis(look: Look) -> Array:
    """Bias depends on the way to a temperature. Glue and mount follow it with a play (IEEE Std 1431, thermal hysteresis)."""
    play = (0.2 + 0.6 * look.share) * float(np.std(look.temperature))
    out, at = np.empty(len(look.t)), 0.0
    for k, value in enumerate(look.temperature):
        at = min(max(at, value - play), value + play)
        out[k] = at - value
    return out / max(play, 1e-30)


@rate("deg/h", "turns")
def slew_heating(look: Look) -> Array:
    """Bias follows the recent turning. What is dissipated in torquers and drives while it turns warms the sensor (IEEE Std
    813, torquer heating)."""
    return look.smooth(np.abs(look.w[:, look.other]), look.between(0.05, 0.5)) / look.fastest


@rate("ppm", "turns")
def scale_warm_up(look: Look) -> Array:
    """Scale factor relaxes after each switching on. The wavelength of the source settles with its temperature (Lefèvre, The
    Fiber-Optic Gyroscope, source)."""
    return look.own * np.exp(-look.since_start / look.between(0.1, 0.6))


@rate("ppm", "turns", "temperature")
def scale_temperature(look: Look) -> Array:
    """Scale factor follows the temperature. Stiffness and wavelength depend on it (IEEE Std 1431)."""
    return look.own * look.temperature


@rate("deg/h", "temperature")
def birefringence(look: Look) -> Array:
    """Bias swings as the temperature changes. Polarisations interfere with a phase that runs with the temperature (Lefèvre, The
    Fiber-Optic Gyroscope, polarisation)."""
    swings = 2 * np.pi * look.scaled(0.7, 4.0) * look.temperature / max(float(np.ptp(look.temperature)), 1e-30)
    return np.sin(swings + look.phase)


@rate("deg/h", "turns")
def sun_incidence(look: Look) -> Array:
    """Bias depends on the Sun's incidence on one side of the housing. It heats that side while it is lit (Wertz, Spacecraft
    Attitude Determination and Control)."""
    return np.maximum(look.attitude[:, look.other] @ look.direction(), 0.0)


@rate("deg/h")
def radiation_belt(look: Look) -> Array:
    """Bias has bumps at regular passages. Particles load the detector while the orbit crosses a belt (IEEE Std 952,
    radiation)."""
    half = np.angle(np.exp(1j * look.cycle(0.3, 1.5))) / np.pi
    return np.exp(-0.5 * (half / 0.12) ** 2)


@rate("ppm", "turns")
def scale_ageing(look: Look) -> Array:
    """Scale factor drifts through the recording. Radiation darkens the fibre and moves the mean wavelength (Lefèvre, The
    Fiber-Optic Gyroscope)."""
    return look.own * look.elapsed ** (0.5 + 2 * look.share)


EFFECTS = families(globals())
