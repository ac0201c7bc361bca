"""Nine kinds of plans with motions of their own, and six grades of gyros and references."""

from itertools import pairwise

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import Slew, smoothstep, smoothstep_integral
from simulator.truth.rotation import turned
from studies.validation.world.kinds import Grade, Kind
from studies.validation.world.motions.base import Lot, Moved, X, headed, knots, stepped, together, waves

ARCSEC = 1 / 3600
FULL_TURN = 2 * np.pi


def _near(lot: Lot, place: int, spread: float = 0.2) -> Array:
    """A unit vector near one of the carrier's axes, which take turns."""
    axis = lot.frame[:, (lot.number + place) % 3] + spread * lot.rng.standard_normal(3)
    return np.asarray(axis / np.linalg.norm(axis))


def flat_spin(lot: Lot) -> Moved:
    """A spent rocket stage loses energy, so that its cone opens while its angular momentum stays.

    With c = cos θ and k = I₁/I₃, ω = s (c e + √(1 − c²)/k (u cos λ + v sin λ)) and λ' = s c (1 − 1/k); c falls as a smoothstep.
    """
    k = log_uniform(lot.craft, 1.6, 6.0)
    spin, phase = lot.side() * lot.peak(), float(lot.rng.uniform(0, FULL_TURN))
    before, after = np.cos(np.deg2rad(lot.rng.uniform([5, 45], [30, 85])))
    first, duration = lot.length_s * lot.rng.uniform([0.05, 0.3], [0.4, 0.55])
    e, u, v = lot.frame.T

    def rate(tau: Array) -> Array:
        share = (tau - first) / duration
        c = before + (after - before) * smoothstep(share)
        lost = duration * smoothstep_integral(np.clip(share, 0.0, 1.0)) + np.maximum(tau - first - duration, 0.0)
        angle = phase + spin * (1 - 1 / k) * (before * tau + (after - before) * lost)
        across = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
        return np.asarray(spin * (c[:, None] * e + (np.sqrt(1 - c * c) / k)[:, None] * across))

    return Moved(rate, breaks=(float(first), float(first + duration)))


def hopper(lot: Lot) -> Moved:
    """A lander hops over a comet: each push sets it tumbling, a landing stops it, and it rocks until it rests."""
    edges, hops = lot.places(3, 9), []
    for place, (low, high) in enumerate(pairwise(edges)):
        leave, land = low + (high - low) * lot.rng.uniform([0.05, 0.5], [0.3, 0.8])
        push = log_uniform(lot.rng, 0.4, 2.0)
        spin = lot.peak() * _near(lot, place, 0.5) * lot.side()
        rock = float(lot.rng.uniform(0.05, 0.3)) * lot.peak() * _near(lot, place + 1, 0.5)
        hops.append(
            (leave, land, push, spin, float(lot.rng.uniform(-0.4, 0.4)) * lot.peak(), rock, log_uniform(lot.rng, 0.1, 0.5))
        )
    e = lot.frame[:, 2]

    def rate(tau: Array) -> Array:
        out = np.zeros((len(tau), 3))
        for leave, land, push, spin, precession, rock, hz in hops:
            flies = smoothstep((tau - leave) / push) - smoothstep((tau - land) / push)
            out += flies[:, None] * turned(e, precession * np.clip(tau - leave, 0.0, land + push - leave), spin)
            rests = np.maximum(tau - land, 0.0)
            out += (np.exp(-hz * rests) * np.sin(FULL_TURN * hz * rests))[:, None] * rock
        return out

    return Moved(rate, breaks=tuple(float(at + more) for a, b, push, *_ in hops for at in (a, b) for more in (0.0, push)))


def momentum_dumps(lot: Lot) -> Moved:
    """A satellite drifts through its dead band in parabolas, is kicked as thrusters unload its wheels, and slews after that."""
    edges, slews, kicks = lot.places(3, 7), [], []
    for place, (low, high) in enumerate(pairwise(edges)):
        slews.append(lot.step(0.6 * low + 0.4 * high, high, lot.angle(15, 100), _near(lot, place)))
        kicks.append((low, 0.15 * lot.peak() * _near(lot, place + 1, 0.6), (high - low) * log_uniform(lot.rng, 0.03, 0.15)))
    drift = np.deg2rad(log_uniform(lot.craft, 2e-4, 5e-3)) * lot.craft.standard_normal(3)

    def rate(tau: Array) -> Array:
        share = np.mod(np.interp(tau, edges, np.arange(len(edges))), 1.0)
        out = (2 * share - 1)[:, None] * drift
        for begin, kick, settle in kicks:
            inner = np.maximum(tau - begin, 0.0) / settle
            out += (np.exp(-inner) * np.sin(3 * inner))[:, None] * kick
        return np.asarray(out + sum(slew.rates(tau)[:, None] * slew.axis for slew in slews))

    return Moved(rate, tuple(slews), tuple(float(edge) for edge in edges[1:-1]))


def glider(lot: Lot) -> Moved:
    """An underwater glider dives and climbs in turn, banks to spiral, ψ' = gain · φ, and rolls in the swell."""
    edges, dives, banks = lot.places(4, 10), [], []
    nose, bank, way = np.deg2rad(log_uniform(lot.craft, 15.0, 40.0)), 0.0, lot.side()
    gain = log_uniform(lot.craft, 0.02, 0.1)
    for number, (low, high) in enumerate(pairwise(edges)):
        dives.append(lot.step(low, 0.5 * (low + high), way * (1 if number == 0 else 2) * (-1) ** number * nose))
        wanted = lot.angle(5, 35)
        banks.append(lot.step(low, high, wanted - bank))
        bank = wanted
    swell = np.deg2rad(log_uniform(lot.rng, 0.1, 1.0))
    pitch = together(stepped(dives), waves(lot.rng, swell, (0.02, 0.08)))
    roll = together(stepped(banks), waves(lot.rng, 2 * swell, (0.02, 0.1)))
    return Moved(headed(lambda tau: gain * roll(tau)[0], pitch, roll, lot.frame), breaks=knots(dives + banks))


def coaster(lot: Lot) -> Moved:
    """A roller coaster goes through loops, corkscrews and banked curves, and its wheels rattle on the track."""
    edges, turns = lot.places(4, 12), []
    for low, high in pairwise(edges):
        figure = lot.rng.random()
        if figure < 0.6:  # a loop or a corkscrew
            turns.append(lot.step(low, high, lot.side() * FULL_TURN, lot.frame[:, int(figure < 0.3)]))
            continue
        bank, third = lot.angle(20, 60), (high - low) / 3
        turns.append(lot.step(low, low + third, bank, lot.frame[:, 0]))
        curve = lot.frame @ np.array([0.0, np.sin(bank), np.cos(bank)])
        turns.append(lot.step(low + third, high - third, np.sign(bank) * abs(lot.angle(60, 270)), curve))
        turns.append(lot.step(high - third, high, -bank, lot.frame[:, 0]))
    rattle = np.deg2rad(log_uniform(lot.craft, 1e-3, 2e-2))
    rattles = [waves(lot.rng, rattle, (2.0, 7.0)) for _ in range(3)]

    def rate(tau: Array) -> Array:
        out = np.stack([one(tau)[1] for one in rattles], axis=1)
        return np.asarray(out + sum(turn.rates(tau)[:, None] * turn.axis for turn in turns))

    return Moved(rate, breaks=knots(turns))


def robot_arm(lot: Lot) -> Moved:
    """A robot's arm goes from pose to pose: base, shoulder and wrist start and stop together, and the gears hum."""
    edges = lot.places(4, 16)
    poses = np.deg2rad([150.0, 50.0, 170.0]) * lot.rng.uniform(-1, 1, (len(edges), 3))
    joints: tuple[list[Slew], list[Slew], list[Slew]] = ([], [], [])
    for (low, high), move in zip(pairwise(edges), np.diff(poses, axis=0), strict=True):
        duration = min(1.5 * float(np.abs(move).max()) / lot.peak(), 0.8 * (high - low))
        begin = low + float(lot.rng.uniform(0.05, 0.95)) * (high - low - duration)
        ramp = float(lot.rng.uniform(0.15, 0.5))
        for joint, angle in zip(joints, move, strict=True):
            joint.append(Slew(X, float(angle), begin, duration, ramp))
    hum = np.deg2rad(log_uniform(lot.craft, 3e-4, 3e-3))
    base, shoulder, wrist = (
        together(stepped(joint, float(first)), waves(lot.rng, hum, (1.5, 6.0)))
        for joint, first in zip(joints, poses[0], strict=True)
    )
    return Moved(headed(lambda tau: base(tau)[1], shoulder, wrist, lot.frame), breaks=knots(joints[0]))


def pendulum(lot: Lot) -> Moved:
    """A bob swings in an ellipse whose plane turns, and twists on its wire; both die away.

    The swing is z = A e^{−γt} (cos wt + iε sin wt) e^{iΩt}, its parts are pitch and roll.
    """
    w, twist = (FULL_TURN * log_uniform(lot.craft, low, high) for low, high in ((0.1, 0.4), (0.02, 0.08)))
    swing, flat = np.deg2rad(log_uniform(lot.rng, 4.0, 15.0)), float(lot.rng.uniform(-0.3, 0.3))
    fade, calm = lot.length_s * lot.rng.uniform([0.4, 0.3], [3.0, 3.0])
    plane = FULL_TURN * float(lot.rng.uniform(-3, 3)) / lot.length_s
    high, phase = lot.peak(), float(lot.rng.uniform(0, FULL_TURN))

    def swung(tau: Array) -> tuple[Array, Array]:
        turning = swing * np.exp(-tau / fade + 1j * (plane * tau + phase))
        z = turning * (np.cos(w * tau) + 1j * flat * np.sin(w * tau))
        return z, (1j * plane - 1 / fade) * z + turning * w * (1j * flat * np.cos(w * tau) - np.sin(w * tau))

    def pitch(tau: Array) -> tuple[Array, Array]:
        z, rate = swung(tau)
        return z.real, rate.real

    def roll(tau: Array) -> tuple[Array, Array]:
        z, rate = swung(tau)
        return z.imag, rate.imag

    return Moved(headed(lambda tau: high * np.exp(-tau / calm) * np.sin(twist * tau + phase), pitch, roll, lot.frame))


def headset(lot: Lot) -> Moved:
    """A head in a game looks aside and back in quick turns, nods and tilts, and it never holds quite still."""
    angles: tuple[list[Slew], list[Slew], list[Slew]] = ([], [], [])
    limits = ((15, 90), (8, 40), (5, 30))
    for low, high in pairwise(lot.places(8, 30)):
        which, middle = int(lot.rng.choice(3, p=[0.45, 0.35, 0.2])), 0.5 * (low + high)
        glance = lot.angle(*limits[which])
        angles[which].append(lot.step(low, middle, glance, X, 0.3))
        angles[which].append(lot.step(middle, high, -glance, X, 0.3))
    sway, tremor = np.deg2rad(log_uniform(lot.rng, 0.3, 2.0)), np.deg2rad(log_uniform(lot.craft, 1e-3, 1e-2))
    yaw, pitch, roll = (
        together(stepped(steps), waves(lot.rng, sway, (0.08, 0.6)), waves(lot.rng, tremor, (4.0, 9.0))) for steps in angles
    )
    return Moved(headed(lambda tau: yaw(tau)[1], pitch, roll, lot.frame), breaks=knots([*angles[0], *angles[1], *angles[2]]))


def soaring_bird(lot: Lot) -> Moved:
    """A bird circles in thermals, glides on to the next, and beats its wings in bouts that pitch its body."""
    hz, beat = log_uniform(lot.craft, 1.5, 4.0), np.deg2rad(log_uniform(lot.craft, 0.3, 2.0))
    edges, banks, pitches, circles, bouts = lot.places(3, 9), [], [], [], []
    for low, high in pairwise(edges):
        edge = 0.15 * (high - low)
        if lot.rng.random() < 0.6:
            bank, turn = lot.angle(15, 40), lot.peak()
            banks += [lot.step(low, low + edge, bank), lot.step(high - edge, high, -bank)]
            circles.append((low, high - edge, edge, np.sign(bank) * turn))
            continue
        dive = lot.angle(5, 30)
        pitches += [lot.step(low, low + 2 * edge, dive), lot.step(high - 2 * edge, high, -dive)]
        bouts.append((low + 2 * edge, high - 3 * edge, edge))

    def flapping(tau: Array) -> tuple[Array, Array]:
        gate, slope, inner = np.zeros(len(tau)), np.zeros(len(tau)), FULL_TURN * hz * tau
        for low, high, edge in bouts:
            for at, way in ((low, 1.0), (high, -1.0)):
                share = np.clip((tau - at) / edge, 0.0, 1.0)
                gate += way * smoothstep(share)
                slope += way * 6 * share * (1 - share) / edge
        return beat * gate * np.sin(inner), beat * (slope * np.sin(inner) + FULL_TURN * hz * gate * np.cos(inner))

    def heading(tau: Array) -> Array:
        turning = yawing(tau)[1]
        for low, high, edge, turn in circles:
            turning = turning + turn * (smoothstep((tau - low) / edge) - smoothstep((tau - high) / edge))
        return np.asarray(turning)

    air = np.deg2rad(log_uniform(lot.rng, 0.3, 3.0))
    yawing, rolling, lifting = (waves(lot.rng, share * air, (0.05, 0.6)) for share in (0.4, 1.0, 0.5))
    pitch, roll = together(stepped(pitches), flapping, lifting), together(stepped(banks), rolling)
    edged = tuple(float(at) for low, high, edge, *_ in (*circles, *bouts) for at in (low, low + edge, high, high + edge))
    return Moved(headed(heading, pitch, roll, lot.frame), breaks=knots(banks + pitches) + edged)


KINDS: dict[str, Kind] = {
    "flat_spin": Kind((10, 20, 50), (3, 12), (60, 900), (0.5, 10), (2, 15), motion=flat_spin),
    "hopper": Kind((5, 10, 20), (3, 10), (200, 2400), (1, 30), (0.3, 6), motion=hopper),
    "momentum_dumps": Kind((2, 4, 8), (4, 14), (600, 5400), (5, 200), (0.05, 0.8), motion=momentum_dumps),
    "glider": Kind((4, 8, 16), (3, 10), (600, 5400), (2, 60), (0.3, 3), motion=glider),
    "coaster": Kind((100, 200), (3, 12), (40, 300), (0.05, 2), (20, 90), motion=coaster),
    "robot_arm": Kind((100, 125, 250), (3, 14), (40, 500), (0.05, 5), (3, 40), motion=robot_arm),
    "pendulum": Kind((50, 100, 200), (3, 12), (60, 600), (0.1, 5), (0.8, 8), motion=pendulum),
    "headset": Kind((100, 200), (2, 10), (30, 300), (0.05, 1), (30, 150), motion=headset),
    "soaring_bird": Kind((50, 100, 200), (3, 12), (60, 600), (0.2, 8), (5, 25), motion=soaring_bird),
}

GRADES: dict[str, Grade] = {
    "depolarised_coil": Grade((2e-6, 1e-5), (1e-7, 1e-5), (1e-5, 1e-4), (0.5 * ARCSEC, 4 * ARCSEC)),
    "ring_laser_on_satnav": Grade((3e-5, 1.5e-4), (1e-6, 2e-5), (2e-5, 3e-4), (0.03, 0.3)),
    "averaged_array": Grade((1e-4, 4e-4), (2e-3, 3e-2), (3e-4, 2e-3), (0.03, 0.3)),
    "toy_with_cameras": Grade((4e-3, 1.5e-2), (0.1, 1.0), (5e-3, 2e-2), (0.003, 0.02)),
    "vibrating_cylinder": Grade((5e-4, 3e-3), (0.01, 0.15), (2e-3, 1e-2), (0.004, 0.04)),
    "spring_restrained": Grade((1e-3, 8e-3), (0.02, 0.3), (5e-3, 2e-2), (0.1, 0.6)),
}
