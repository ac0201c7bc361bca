"""Families of floated and tuned gyros, of their gimbals, leads and isolators, and of wheels and tables beside them."""

import numpy as np

from simulator.effects.base import Array
from studies.validation.wide.families.base import families, rate, samples
from studies.validation.wide.families.look import Look, changed


@rate("deg/s", "turns")
def backlash(look: Look) -> Array:
    """Reading lags the rate by a play, up and down. The gear of a pick-off has one (IEEE Std 517, hysteresis)."""
    play = look.fastest * (0.05 + 0.3 * look.share)
    out = np.empty(len(look.t))
    for p in look.stream.intervals:
        at = float(look.own[p.start])
        for row, value in enumerate(look.own[p].tolist(), p.start):
            at = min(max(at, value - play), value + play)
            out[row] = (at - value) / play
    return out


@rate("ppm", "turns")
def float_hang_off(look: Look) -> Array:
    """Reading errs with the rate about the spin axis times the recent rate. The float hangs off while it is turned, and its
    input axis leans by that angle (IEEE Std 517, cross-coupling)."""
    return look.smooth(look.own, look.between(0.001, 0.02)) * look.w[:, look.other] / look.fastest


@rate("deg/h", "turns")
def flex_lead(look: Look) -> Array:
    """Bias follows the angle turned and saturates. Leads to a gimbal wind up as springs until they touch (IEEE Std 813, lead
    torques)."""
    return np.tanh(look.turned[:, look.other] / look.scaled(0.1, 2.0))


@rate("deg/h", "turns")
def bubble(look: Look) -> Array:
    """Bias changes some time after the case is tipped over. A bubble in the fluid wanders to the upper end and loads the float
    there (IEEE Std 517, flotation)."""
    up = np.sign(look.attitude[:, look.other] @ look.direction())
    return look.smooth(up, look.between(0.02, 0.2))


@rate("ppm", "turns")
def isolator_tilt(look: Look) -> Array:
    """Axes tilt while the rate changes. Vibration isolators yield to the block's inertia (Titterton and Weston, Strapdown
    Inertial Navigation Technology)."""
    third = 3 - look.k - look.other
    tilt = look.smooth(look.acceleration[:, third], look.between(0.001, 0.01))
    return look.w[:, look.other] * tilt / max(float(np.abs(tilt).max()), 1e-30)


@samples("pickup", "deg/s", "turns", sign="positive")
def dented_track(look: Look, values: Array, size: float) -> Array:
    """White noise appears at some angles only. Balls of a bearing or a table run over dents in its track (IEEE Std 517,
    bearing noise)."""
    rough = np.sin(look.scaled(2.0, 20.0) * look.turned[:, look.k] + look.phase) > 0.5
    noise = size * rough[:, None] * look.rng.standard_normal((len(values), 2))
    out = changed(values, look.k, values[:, look.k] + noise[:, 0])
    return changed(out, look.other, out[:, look.other] + noise[:, 1])


@rate("deg/h", "turns")
def wheel_stiction(look: Look) -> Array:
    """A pair of bumps comes where another rate passes a value. A reaction wheel stands there, sticks, and tears itself loose
    (Wertz, Spacecraft Attitude Determination and Control, wheel friction)."""
    rates = look.w[:, look.other]
    level = np.quantile(rates, 0.2 + 0.6 * look.share)
    x = (rates - level) / max(float(np.ptp(rates)) * look.scaled(0.03, 0.2), 1e-12)
    return x * np.exp(-0.5 * x * x)


EFFECTS = families(globals())
