"""Laws of what carries gyros on the ground, at sea and in the air, and of tables and mounts in laboratories."""

from itertools import pairwise

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import smoothstep, smoothstep_integral
from simulator.truth.rotation import turned
from studies.validation.world.motions.base import Lot, Moved, headed, knots, stepped, together, waves

GRAVITY = 9.81  # m/s²
EARTH_RAD_S = 7.2921e-5


def draw_gondola_motion(lot: Lot) -> Moved:
    """A balloon's gondola: azimuth swings, the inner frame goes to elevations, and all hangs as a double pendulum."""
    long, short = log_uniform(lot.craft, 0.04, 0.1), log_uniform(lot.craft, 0.4, 1.0)
    swing = np.deg2rad(log_uniform(lot.craft, 0.3, 4.0))
    speed, period = lot.peak(), lot.length_s / float(lot.rng.uniform(3, 15))
    edges = lot.places(2, 5)
    steps = [lot.step(low, high, lot.angle(5, 30)) for low, high in pairwise(edges)]
    hung = [
        together(waves(lot.rng, swing, (0.95 * long, 1.05 * long), 2), waves(lot.rng, 0.05 * swing, (0.9 * short, 1.1 * short)))
        for _ in range(2)
    ]
    begin = float(np.deg2rad(lot.rng.uniform(10, 60)))

    def azimuth(tau: Array) -> Array:
        return np.asarray(speed * np.tanh(3 * np.sin(2 * np.pi * tau / period)))

    pitch = together(stepped(steps, begin), hung[0])
    return Moved(headed(azimuth, pitch, hung[1], lot.frame), breaks=knots(steps))


def draw_ship_motion(lot: Lot) -> Moved:
    """A ship rolls near its resonance and pitches with the waves that it meets, and changes its course now and then."""
    roll_hz, wave_hz = log_uniform(lot.craft, 0.06, 0.14), log_uniform(lot.craft, 0.08, 0.25)
    sea = np.deg2rad(log_uniform(lot.rng, 1.5, 8.0))
    edges = lot.places(1, 4)
    steps = [lot.step(low, high, lot.angle(20, 150)) for low, high in pairwise(edges)]
    course, yawing = stepped(steps), waves(lot.rng, 0.15 * sea, (0.5 * wave_hz, wave_hz))
    roll = waves(lot.rng, sea, (0.85 * roll_hz, 1.15 * roll_hz), 6)
    pitch = waves(lot.rng, 0.4 * sea, (0.7 * wave_hz, 1.4 * wave_hz), 6)
    return Moved(headed(lambda tau: course(tau)[1] + yawing(tau)[1], pitch, roll, lot.frame), breaks=knots(steps))


def draw_circuit_motion(lot: Lot) -> Moved:
    """An aircraft flies circuits of coordinated turns, ψ' = (g/V) tan φ, climbs and descends, with phugoid and gusts."""
    speed, phugoid = log_uniform(lot.craft, 40.0, 200.0), log_uniform(lot.craft, 0.01, 0.03)
    edges, banks, climbs = lot.places(2, 8), [], []
    for low, high in pairwise(edges):
        bank, climb, middle = lot.angle(12, 50), lot.angle(2, 12), 0.5 * (low + high)
        banks += [lot.step(low, 0.7 * low + 0.3 * high, bank), lot.step(middle, high, -bank)]
        climbs += [lot.step(low, middle, climb), lot.step(middle, high, -climb)]
    gust = np.deg2rad(log_uniform(lot.rng, 0.05, 0.5))
    roll = together(stepped(banks), waves(lot.rng, gust, (0.05, 0.5)))
    pitch = together(stepped(climbs), waves(lot.rng, gust, (phugoid, 1.2 * phugoid)), waves(lot.rng, 0.3 * gust, (0.1, 0.6)))
    yawing = waves(lot.rng, 0.5 * gust, (0.1, 0.4))
    return Moved(
        headed(lambda tau: GRAVITY / speed * np.tan(roll(tau)[0]) + yawing(tau)[1], pitch, roll, lot.frame),
        breaks=knots(banks + climbs),
    )


def draw_drone_motion(lot: Lot) -> Moved:
    """A drone hovers in gusts, dashes with its nose down and brakes, turns on the spot, and its rotors shake it."""
    shake_hz, shake = log_uniform(lot.craft, 3.0, 8.0), np.deg2rad(log_uniform(lot.craft, 5e-4, 5e-3))
    gust = np.deg2rad(log_uniform(lot.rng, 0.3, 2.0))
    edges, yaws = lot.places(3, 10), []
    leans = [stepped(()), stepped(())]
    breaks: tuple[float, ...] = ()
    for low, high in pairwise(edges):
        if lot.rng.random() < 0.5:
            yaws.append(lot.step(low, high, lot.angle(30, 180)))
            continue
        lean, side, third = lot.angle(8, 30), int(lot.rng.integers(2)), (high - low) / 3
        dash = [lot.step(low, low + third, lean), lot.step(low + third, low + 2 * third, -1.6 * lean)]
        dash.append(lot.step(low + 2 * third, high, 0.6 * lean))
        leans[side] = together(leans[side], stepped(dash))
        breaks += knots(dash)
    pitch, roll, yawing = (
        together(waves(lot.rng, gust, (0.1, 0.7), 8), waves(lot.rng, shake, (shake_hz, 1.1 * shake_hz))) for _ in range(3)
    )
    turning = together(stepped(yaws), yawing)
    return Moved(
        headed(lambda tau: turning(tau)[1], together(pitch, leans[0]), together(roll, leans[1]), lot.frame),
        breaks=breaks + knots(yaws),
    )


def draw_staircase_motion(lot: Lot) -> Moved:
    """A rate table goes up and down a stair of constant rates about one axis of the gyros, while the Earth turns below it."""
    axis = lot.frame[:, lot.number % 3] + 0.02 * lot.craft.standard_normal(3)
    axis /= np.linalg.norm(axis)
    earth = EARTH_RAD_S * lot.rng.standard_normal(3) / np.sqrt(3)
    count, top = int(lot.rng.integers(2, 6)), lot.side() * lot.peak()
    up = top * np.arange(1, count + 1) / count
    levels = np.concatenate([[0.0], up, up[-2::-1], [0.0]])
    if lot.rng.random() < 0.5:
        levels = np.concatenate([levels, -levels[1:]])
    at = np.linspace(0, lot.length_s, len(levels) + 1)[1:-1]
    ramp = float(lot.rng.uniform(0.1, 0.6)) * at[0]

    def rate(tau: Array) -> Array:
        spin, angle = np.zeros(len(tau)), np.zeros(len(tau))
        for time, step in zip(at, np.diff(levels), strict=True):
            share = (tau - time) / ramp
            spin += step * smoothstep(share)
            angle += step * (ramp * smoothstep_integral(np.clip(share, 0, 1)) + np.maximum(tau - time - ramp, 0))
        return np.asarray(spin[:, None] * axis + turned(axis, angle, earth))

    return Moved(rate, breaks=(*at, *(at + ramp)))
