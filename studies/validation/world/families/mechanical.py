"""Families with mechanical causes: masses, bearings, mounts and gravity."""

import numpy as np
from scipy.signal import lfilter

from simulator.effects.base import Array
from studies.validation.world.families.base import families, random_rate, rate, samples
from studies.validation.world.families.look import Look


@rate("deg/h", "turns")
def mass_unbalance(look: Look) -> Array:
    """Bias follows gravity's component along an axis of the case. A mass is off its support's centre, on the ground or in a
    centrifuge (IEEE Std 528, g-sensitive drift)."""
    return look.attitude[:, look.other] @ look.direction()


@rate("deg/h", "turns")
def anisoelasticity(look: Look) -> Array:
    """Bias follows the product of gravity along two axes. The support yields differently along them (IEEE Std 528, g-squared
    drift)."""
    down = look.attitude @ look.direction()
    return down[:, look.k] * down[:, look.other]


@rate("ppm", "turns")
def anisoinertia(look: Look) -> Array:
    """Reading errs with the product of the rates about the other two axes. Moments of inertia of a gimbal differ (Titterton and
    Weston, Strapdown Inertial Navigation Technology)."""
    return look.w[:, (look.k + 1) % 3] * look.w[:, (look.k + 2) % 3] / look.fastest


@rate("s", "turns")
def cross_acceleration(look: Look) -> Array:
    """An axis reads the angular acceleration about another. A float or proof mass lags behind its case (Titterton and Weston,
    Strapdown Inertial Navigation Technology)."""
    return look.acceleration[:, look.other]


@random_rate("deg/h")
def retainer_hop(look: Look) -> Array:
    """Bias hops at random and creeps back. The retainer of a ball bearing changes its mode (IEEE Std 528, spin-bearing
    instability)."""
    tau = look.between(0.05, 0.3)
    chance = min(look.sample_s / look.between(0.1, 0.4), 0.5)
    hops = (look.rng.random(len(look.t)) < chance) * look.rng.standard_normal(len(look.t))
    return np.asarray(lfilter([1.0], [1.0, -np.exp(-look.sample_s / tau)], hops))


@samples("pickup", "deg/s", sign="positive")
def wheel_tone(look: Look, values: Array, size: float) -> Array:
    """A tone wanders with the speed of a wheel. The wheel takes up the turning, and its unbalance shakes the gyro (Wertz,
    Spacecraft Attitude Determination and Control)."""
    speed = 0.3 + 0.15 * look.w[:, look.other] / max(look.fastest, 1e-12)
    tone = np.sin(2 * np.pi * np.cumsum(speed) + look.phase)
    out = values.copy()
    out[:, look.k] += size * tone
    return out


@rate("deg/h")
def log_creep(look: Look) -> Array:
    """Bias creeps with the logarithm of time. A flexure under load relaxes (IEEE Std 813)."""
    return np.log1p(look.since_start / look.between(0.005, 0.05))


@rate("deg/h", "turns")
def pivot_friction(look: Look) -> Array:
    """Bias keeps the sign of the last fast turn. Friction of a pivot lets a gimbal stick where it was turned to (IEEE Std
    813)."""
    enough = look.fastest * (0.05 + 0.3 * look.share)
    out, side = np.empty(len(look.t)), 1.0
    for k, value in enumerate(look.w[:, look.other]):
        side = float(np.sign(value)) if abs(value) > enough else side
        out[k] = side
    return out


@rate("s", "turns")
def ringing(look: Look) -> Array:
    """Reading rings after each change of rate. The bracket of the gyro is excited at its resonance (Titterton and Weston,
    Strapdown Inertial Navigation Technology)."""
    turn, decay = 2 * np.pi * (0.05 + 0.15 * look.share), np.exp(-look.scaled(0.01, 0.1))
    drive = look.acceleration[:, look.other]
    shaken = look.each(lambda p: lfilter([0.0, decay * np.sin(turn)], [1, -2 * decay * np.cos(turn), decay**2], drive[p]))
    return np.asarray(shaken)


@rate("ppm", "turns")
def mount_creep(look: Look) -> Array:
    """Misalignment grows through the recording. The bracket creeps after launch loads (Wertz, Spacecraft Attitude Determination
    and Control)."""
    return look.w[:, look.other] * look.elapsed


@rate("ppm", "turns")
def pickoff_harmonic(look: Look) -> Array:
    """Scale factor has waves over the angle turned. An encoder or resolver is eccentric (IEEE Std 1554, rate-table
    harmonics)."""
    return look.own * np.sin(look.scaled(1.0, 6.0) * look.turned[:, look.k] + look.phase)


@random_rate("deg/h")
def microslip(look: Look) -> Array:
    """Bias slips by random steps while it turns, and stays at rest. Joints slip under changing load (IEEE Std 1431)."""
    moving = np.linalg.norm(look.w, axis=1)
    chance = 40.0 * moving / max(float(moving.sum()), 1e-30)
    slips = (look.rng.random(len(look.t)) < chance) * look.rng.standard_normal(len(look.t))
    return np.cumsum(slips)


EFFECTS = families(globals())
