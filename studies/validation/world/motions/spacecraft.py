"""Laws of spacecraft: spin, free motion, stepped pointing, yaw steering, wheel ramps and roll steps about the Sun's line."""

from itertools import pairwise

import numpy as np
import scipy.special

from gyrocal.errors import InputError
from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import Slew, smoothstep, smoothstep_integral
from studies.validation.world.motions.base import Lot, Moved, Rate, waves


def draw_spinner_motion(lot: Lot) -> Moved:
    """A spinning craft of two equal moments of inertia: ω = s e + Re(c e^{iλ}) u + Im(c e^{iλ}) v with λ' = (I_s/I_t − 1) s.

    A damper lets the nutation c decay, thruster pulses kick it, and the spin s changes once in some intervals.
    """
    ratio = lot.craft.choice([lot.craft.uniform(0.3, 0.8), lot.craft.uniform(1.2, 1.9)])
    spin, way = np.deg2rad(log_uniform(lot.craft, *lot.kind.turn_deg_s)), lot.craft.choice([-1.0, 1.0])
    cone = np.deg2rad(log_uniform(lot.craft, 2.0, 15.0))
    damping = lot.length_s * log_uniform(lot.rng, 0.3, 5.0)
    edges = lot.places(2, 5)
    kicks = [(float(at), float(lot.rng.uniform(0.3, 1.0)), float(lot.rng.uniform(0, 2 * np.pi))) for at in edges[:-1]]
    press = 0.25 * 2 * np.pi / spin  # a pulse takes a quarter of a turn
    change = float(lot.rng.uniform(-0.5, 0.5)) * (lot.rng.random() < 0.5)
    first, duration = 0.3 * lot.length_s, 0.3 * lot.length_s
    e, u, v = lot.frame.T

    def rate(tau: Array) -> Array:
        share = (tau - first) / duration
        after = np.maximum(tau - first - duration, 0.0)
        s = way * spin * (1 + change * smoothstep(share))
        turned = way * spin * (tau + change * (duration * smoothstep_integral(np.clip(share, 0.0, 1.0)) + after))
        c = np.zeros(len(tau), complex)
        for number, (at, size, phase) in enumerate(kicks):
            begun = smoothstep((tau - at) / press) if number else 1.0
            c += size * begun * np.exp(1j * phase - np.maximum(tau - at, 0.0) / damping)
        c *= spin * ratio * np.tan(cone) * np.exp(1j * (ratio - 1) * turned)
        return np.asarray(s[:, None] * e + c.real[:, None] * u + c.imag[:, None] * v)

    return Moved(rate, breaks=(*edges[1:-1], *(edges[1:-1] + press), first, first + duration))


def build_free_rotation(inertia: Array, a: float, c: float, decay: float, begin: float) -> Rate:
    """Free motion of a body of three moments of inertia that slows down, I ω' = I ω × ω − γ I ω.

    With ω = e^{−γt} u(s), s = (1 − e^{−γt})/γ, u is the motion without slowing down, which Jacobi's functions solve about the
    third axis (the largest or the smallest, the second between): u = (a cn, β sn, c dn) of p s (Landau and Lifshitz, Mechanics,
    § 37). Equating the derivatives gives p = ±c √((I₃ − I₂)(I₃ − I₁)/(I₁I₂)) with the sign of I₃ − I₁,
    β = a p I₁/(c (I₃ − I₂)) and m = (I₂ − I₁) a β/(I₃ p c), which must lie below one.
    """
    i1, i2, i3 = inertia
    p = np.sign(i3 - i1) * c * np.sqrt((i3 - i2) * (i3 - i1) / (i1 * i2))
    b = a * p * i1 / (c * (i3 - i2))
    m = (i2 - i1) * a * b / (i3 * p * c)
    if not 0 <= m < 1:
        raise InputError(f"a free body's modulus {m:.3g}: must be in [0, 1); take a smaller amplitude across")

    def rate(tau: Array) -> Array:
        slow = np.exp(-decay * tau)
        sn, cn, dn, _ = scipy.special.ellipj(p * (begin + (1 - slow) / decay), m)
        return np.asarray(slow[:, None] * np.stack([a * cn, b * sn, c * dn], axis=1))

    return rate


def draw_detumble_motion(lot: Lot) -> Moved:
    """A body of three moments of inertia tumbles freely, and magnetic torquers take its rate away."""
    inertia = np.array([1.0, lot.craft.uniform(1.15, 1.5), lot.craft.uniform(1.6, 2.0)])
    if lot.craft.random() < 0.5:
        inertia = inertia[::-1]
    c = lot.peak()
    most = np.sqrt((inertia[2] - inertia[1]) * inertia[2] / ((inertia[1] - inertia[0]) * inertia[0]))
    a = float(lot.rng.uniform(0.3, 0.95)) * most * c
    decay = log_uniform(lot.rng, 0.3, 3.0) / lot.length_s
    own = build_free_rotation(inertia, a, lot.side() * c, decay, float(lot.rng.uniform(0, 30 / c)))
    return Moved(lambda tau: own(tau) @ lot.frame.T)


def draw_telescope_motion(lot: Lot) -> Moved:
    """Visits of some fields: a large turn to each, then a pattern of small steps, after each of which the structure rings."""
    hz, damped = log_uniform(lot.craft, 0.02, 0.2) / min(lot.length_s / 600, 1.0), log_uniform(lot.craft, 0.05, 0.2)
    jitter = log_uniform(lot.craft, 1e-5, 1e-3)
    edges, turns = lot.places(1, 3), []
    for visit, (low, high) in enumerate(pairwise(edges)):
        axis = lot.frame[:, (lot.number + visit) % 3] + 0.2 * lot.rng.standard_normal(3)
        turns.append(lot.step(low, 0.6 * low + 0.4 * high, lot.angle(15, 120), axis))
        steps = np.linspace(turns[-1].stop, high, int(lot.rng.integers(3, 9)) + 1)
        for begin, end in pairwise(steps):
            axis = lot.frame @ np.array([0.0, *lot.rng.standard_normal(2)])
            turns.append(lot.step(begin, 0.5 * (begin + end), lot.angle(0.02, 1.0), axis, 3.0))
    rings = [(turn.stop, turn.axis, 0.03 * turn.angle / turn.duration) for turn in turns]
    shaken = [waves(lot.rng, np.deg2rad(jitter), (0.5 * hz, 2 * hz)) for _ in range(3)]

    def rate(tau: Array) -> Array:
        out = np.stack([shake(tau)[1] for shake in shaken], axis=1)
        for turn in turns:
            out += turn.rates(tau)[:, None] * turn.axis
        for stop, axis, size in rings:
            inner = 2 * np.pi * hz * np.maximum(tau - stop, 0.0)
            out += (size * np.exp(-damped * inner) * np.sin(inner))[:, None] * axis
        return out

    return Moved(rate, tuple(turns))


def draw_yaw_steering(lot: Lot) -> Moved:
    """Nadir pointing that turns about nadir to keep the panels to the Sun: ψ = atan2(−tan β, sin μ), μ from orbit midnight.

    ψ' = n tan β cos μ/(sin² μ + tan² β), and A = R_z(ψ) A_LVLH makes ω = (−n sin ψ, −n cos ψ, ψ').
    """
    assert lot.orbit
    n = lot.orbit.mean_motion
    beta = lot.craft.choice([-1.0, 1.0]) * np.deg2rad(log_uniform(lot.craft, 5.0, 40.0))
    midnight, lean = lot.craft.uniform(0, 2 * np.pi), np.deg2rad(log_uniform(lot.craft, 0.01, 0.5))
    shaken = [waves(lot.rng, lean, (2e-3, 2e-2)) for _ in range(3)]

    def rate(tau: Array) -> Array:
        mu = n * (lot.start_s + tau) + midnight
        yaw = np.arctan2(-np.tan(beta), np.sin(mu))
        turning = n * np.tan(beta) * np.cos(mu) / (np.sin(mu) ** 2 + np.tan(beta) ** 2)
        own = np.stack([-n * np.sin(yaw), -n * np.cos(yaw), turning], axis=1)
        return np.asarray((own + np.stack([shake(tau)[1] for shake in shaken], axis=1)) @ lot.frame.T)

    return Moved(rate)


def draw_wheel_ramps(lot: Lot) -> Moved:
    """Wheels are ramped to one speed after another, so that the rates are made of straight lines.

    In some intervals one wheel is ramped at a time, in others all together; between two ramps a speed may be held.
    """
    wheels = lot.frame + 0.15 * lot.craft.standard_normal((3, 3))
    wheels /= np.linalg.norm(wheels, axis=0)
    alone = lot.rng.random() < 0.5
    lines = []
    for wheel in range(3):
        if alone and wheel != lot.number % 3:
            continue
        at = lot.places(4, 9)
        speeds = lot.peak() * lot.rng.uniform(-1, 1, len(at))
        held = lot.rng.random(len(at) - 1) < 0.3
        for place in np.flatnonzero(held):
            speeds[place + 1] = speeds[place]
        lines.append((wheels[:, wheel], at, speeds * (np.arange(len(at)) > 0)))

    def rate(tau: Array) -> Array:
        return np.asarray(sum(np.interp(tau, at, speeds)[:, None] * axis for axis, at, speeds in lines))

    return Moved(rate, breaks=tuple(float(one) for _, at, _ in lines for one in at[1:-1]))


def draw_sun_rolls(lot: Lot) -> Moved:
    """Roll steps about the Sun's line, excursions off it and back, and a thruster's limit cycle within its dead band."""
    edges, turns = lot.places(3, 8), []
    sun, *across = lot.frame.T
    for low, high in pairwise(edges):
        if lot.rng.random() < 0.6:
            turns.append(lot.step(low, high, lot.angle(20, 90), sun))
            continue
        there = lot.step(low, 0.5 * (low + high), lot.angle(10, 40), across[int(lot.rng.integers(2))])
        turns += [there, Slew(there.axis, -there.angle, there.start + 0.5 * (high - low), there.duration, there.ramp_fraction)]
    period = [lot.length_s / log_uniform(lot.rng, 4.0, 40.0) for _ in range(3)]
    drift = [4 * np.deg2rad(log_uniform(lot.craft, 0.02, 0.5)) / one for one in period]
    phase = lot.rng.uniform(0, 2 * np.pi, 3)

    def rate(tau: Array) -> Array:
        out = np.tanh(5 * np.sin(2 * np.pi * tau[:, None] / period + phase)) * drift @ lot.frame.T
        return np.asarray(out + sum(turn.rates(tau)[:, None] * turn.axis for turn in turns))

    return Moved(rate, tuple(turns))
