"""Five kinds of plans with motions of their own, and four grades of gyros and references."""

from itertools import pairwise

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import smoothstep, smoothstep_integral
from simulator.truth.rotation import turned
from studies.validation.world.kinds import Grade, Kind
from studies.validation.world.motions.base import Angle, Lot, Moved, Rate, X, headed, knots, stepped, together, waves

ARCSEC = 1 / 3600


def _changing_speed(lot: Lot, fewest: int, most: int, ramp: float) -> tuple[Angle, tuple[float, ...]]:
    """An angle that runs one way at speeds of the kind's, with ramps of a share of the shortest stretch; and its breaks."""
    edges = lot.places(fewest, most)
    speeds = lot.craft.choice([-1.0, 1.0]) * np.array([lot.peak() for _ in edges[1:]])
    at, ramp_s = edges[1:-1], ramp * float(np.diff(edges).min())

    def angle(tau: Array) -> tuple[Array, Array]:
        turn, speed = speeds[0] * tau, np.full(len(tau), speeds[0])
        for begin, change in zip(at, np.diff(speeds), strict=True):
            share = (tau - begin) / ramp_s
            speed += change * smoothstep(share)
            turn += change * (ramp_s * smoothstep_integral(share) + np.maximum(tau - begin - ramp_s, 0.0))
        return turn, speed

    return angle, tuple(float(time) for time in (*at, *(at + ramp_s)))


def _carried(carrier: Rate, axis: Array, angle: Angle) -> Rate:
    """Body rate of what turns about an axis of its carrier, R(e, α) ω + α' e."""

    def rate(tau: Array) -> Array:
        turn, speed = angle(tau)
        return np.asarray(turned(axis, turn, carrier(tau)) + speed[:, None] * axis)

    return rate


def ship_radar(lot: Lot) -> Moved:
    """A ship's radar scanner turns without end at one of its speeds, on a deck that rolls and pitches and changes course."""
    scan, breaks = _changing_speed(lot, 1, 4, 0.3)
    roll_hz, sea = log_uniform(lot.craft, 0.06, 0.15), np.deg2rad(log_uniform(lot.rng, 1.0, 8.0))
    courses = [lot.step(low, high, lot.angle(10, 90), X, 0.5 * (high - low)) for low, high in pairwise(lot.places(1, 3))]
    roll, pitch = waves(lot.rng, sea, (0.8 * roll_hz, 1.2 * roll_hz)), waves(lot.rng, 0.4 * sea, (roll_hz, 2 * roll_hz))
    deck = headed(lambda tau: stepped(courses)(tau)[1], pitch, roll, lot.frame)
    return Moved(_carried(deck, lot.frame[:, 2], scan), breaks=breaks + knots(courses))


def turbine_blade(lot: Lot) -> Moved:
    """A blade of a wind turbine: the rotor follows the wind, the blade pitches, feathers and flaps, and the nacelle yaws."""
    rotor, breaks = _changing_speed(lot, 2, 6, 0.8)
    pitches, yaws = [], []
    for low, high in pairwise(lot.places(3, 9)):
        pitches.append(lot.step(low, high, lot.angle(4, 90), X, 0.2 * (high - low)))
        yaws.append(lot.step(low, high, lot.angle(1, 12), X, 0.6 * (high - low)))
    own_hz, bend = log_uniform(lot.craft, 0.3, 1.2), np.deg2rad(log_uniform(lot.rng, 0.05, 0.6))
    flap, yaw, (shaft, across, blade) = waves(lot.rng, bend, (0.9 * own_hz, 1.1 * own_hz)), stepped(yaws), lot.frame.T
    hub = _carried(lambda tau: yaw(tau)[1][:, None] * blade, shaft, rotor)
    rate = _carried(lambda tau: hub(tau) + flap(tau)[1][:, None] * across, blade, stepped(pitches))
    return Moved(rate, breaks=breaks + knots(pitches + yaws))


def whale_tag(lot: Lot) -> Moved:
    """A tag on a whale: steep dives and climbs, strokes of the fluke in swells of effort, and rolls and turns in lunges."""
    beat, stroke = log_uniform(lot.craft, 0.15, 0.5), np.deg2rad(log_uniform(lot.craft, 1.5, 8.0))
    dives, rolls, turns = [], [], []
    for low, high in pairwise(lot.places(2, 7)):
        at, steep = low + (high - low) * np.array([0.0, 0.3, 0.7, 1.0]), lot.angle(20, 75)
        dives += [lot.step(at[0], at[1], steep), lot.step(at[2], at[3], -steep)]
        turns.append(lot.step(low, high, lot.angle(20, 200), X, 0.2 * (high - low)))
        if lot.rng.random() < 0.6:  # it lunges on its side, or rolls over
            over = lot.angle(60, 150)
            back = -over if lot.rng.random() < 0.6 else np.sign(over) * 2 * np.pi - over
            rolls += [lot.step(at[1], at[2], over), lot.step(at[2], at[3], back)]
    pitch = together(stepped(dives), waves(lot.rng, stroke, (0.92 * beat, 1.08 * beat), 3))
    roll = together(stepped(rolls), waves(lot.rng, 0.6 * stroke, (0.05, beat)))
    yaw = together(stepped(turns), waves(lot.rng, 0.3 * stroke, (0.92 * beat, 1.08 * beat), 3))
    return Moved(headed(lambda tau: yaw(tau)[1], pitch, roll, lot.frame), breaks=knots(dives + rolls + turns))


def two_wheels(lot: Lot) -> Moved:
    """A satellite that lost a wheel slews about two axes; sunlight rolls it about the third, in parabolas between pulses."""
    first, second, lost = lot.frame.T
    edges, slews = lot.places(2, 5), []
    for low, high in pairwise(edges):
        for (begin, end), axis in zip(pairwise(np.linspace(low, high, 4)), (first, second, first), strict=True):
            slews.append(lot.step(begin, end, lot.angle(8, 120), axis))
    pulse = 0.06 * float(np.diff(edges).min())
    roll = lot.craft.choice([-1.0, 1.0]) * np.deg2rad(log_uniform(lot.rng, 1.0, 20.0))

    def rate(tau: Array) -> Array:
        drift = np.zeros(len(tau))
        for low, high in pairwise(edges):
            peak, left = 4 * roll / (high - low), 1 - 2 * (tau - low) / (high - low)
            drift += peak * left * (smoothstep((tau - low) / pulse) - smoothstep((tau - high) / pulse))
        return np.asarray(drift[:, None] * lost + sum(slew.rates(tau)[:, None] * slew.axis for slew in slews))

    return Moved(rate, tuple(slews), tuple(float(edge + more) for edge in edges for more in (0.0, pulse)))


def tethered_probe(lot: Lot) -> Moved:
    """A probe on a tether swings along the orbit and across, spins about the tether as that unwinds, and nods. Small swings
    have √3 n in the orbit's plane and 2 n across (Beletsky and Levin, Dynamics of Space Tether Systems, 1993)."""
    assert lot.orbit
    n, phases = lot.orbit.mean_motion, lot.craft.uniform(0, 2 * np.pi, 2)
    sizes = np.deg2rad([log_uniform(lot.craft, 5.0, 40.0), log_uniform(lot.craft, 3.0, 25.0)])
    nod_hz, nod = log_uniform(lot.craft, 2e-3, 2e-2), np.deg2rad(log_uniform(lot.rng, 0.2, 4.0))
    spin, breaks = _changing_speed(lot, 2, 5, 0.8)

    def swings(which: int, speed: float, carried: float) -> Angle:
        def angle(tau: Array) -> tuple[Array, Array]:
            inner = speed * (lot.start_s + tau) + phases[which]
            return carried * tau + sizes[which] * np.sin(inner), carried + sizes[which] * speed * np.cos(inner)

        return together(angle, waves(lot.rng, nod, (0.8 * nod_hz, 1.2 * nod_hz)))

    hung = headed(np.zeros_like, swings(0, np.sqrt(3) * n, -n), swings(1, 2 * n, 0.0), lot.frame)
    return Moved(_carried(hung, lot.frame[:, 2], spin), breaks=breaks)


KINDS: dict[str, Kind] = {
    "ship_radar": Kind((50, 100, 200), (3, 12), (40, 600), (0.05, 1), (20, 150), motion=ship_radar),
    "turbine_blade": Kind((50, 100, 200), (3, 12), (120, 1200), (0.1, 3), (8, 90), motion=turbine_blade),
    "whale_tag": Kind((25, 50, 100), (3, 12), (200, 1800), (0.3, 8), (4, 30), motion=whale_tag),
    "two_wheels": Kind((2, 4, 10), (4, 14), (600, 5400), (5, 120), (0.05, 0.8), orbit=True, motion=two_wheels),
    "tethered_probe": Kind((1, 2, 4), (3, 10), (900, 7200), (5, 150), (0.05, 1), orbit=True, motion=tethered_probe),
}

GRADES: dict[str, Grade] = {
    "phone_chip_on_tags": Grade((2.5e-3, 6e-3), (0.1, 1.0), (5e-3, 3e-2), (0.1, 1.2)),  # BMI270 class, fiducial markers
    "silicon_ring_on_stars": Grade((8e-5, 3e-4), (5e-3, 0.1), (1e-3, 5e-3), (4 * ARCSEC, 40 * ARCSEC)),  # CRH03 class
    "open_loop_coil_on_rtk": Grade((1.2e-4, 4e-4), (1e-5, 6e-4), (2e-4, 1.5e-3), (0.02, 0.15)),  # DSP-1760 class, two antennas
    "marine_resonator": Grade((1.2e-5, 6e-5), (1e-6, 2e-5), (2e-5, 2e-4), (0.01, 0.1)),  # BlueNaute class, gyrocompass
}
