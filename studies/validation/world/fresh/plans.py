"""Kinds of plans and grades of gyro and references of the fresh source: spacecraft, benches, carriers and a walker."""

from itertools import pairwise

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import Slew, smoothstep
from studies.validation.world.kinds import Grade, Kind
from studies.validation.world.motions.base import Angle, Lot, Moved, X, headed, knots, stepped, together, waves


def build_circling(low: float, span: float, angle: float, cycles: float, edge: float) -> tuple[Angle, Angle]:
    """Two angles that circle between two times, angle · g · cos φ and angle · g · sin φ.

    Parameters
    ----------
    low, span : begin and duration, s
    angle : largest, rad
    cycles : turns of φ, of either sign
    edge : share of the duration in which g rises from 0 to 1 by a smoothstep, and falls again at the end; at most 0.5
    """
    speed = 2 * np.pi * cycles / span

    def radius(tau: Array) -> tuple[Array, Array]:
        rise, fall = (np.clip(share / edge, 0.0, 1.0) for share in ((tau - low) / span, (low + span - tau) / span))
        up, down = smoothstep(rise), smoothstep(fall)
        slope = 6 * (rise * (1 - rise) * down - up * fall * (1 - fall)) / (edge * span)
        return angle * up * down, angle * slope

    def first(tau: Array) -> tuple[Array, Array]:
        (size, growth), phase = radius(tau), speed * (tau - low)
        return size * np.cos(phase), growth * np.cos(phase) - size * speed * np.sin(phase)

    def second(tau: Array) -> tuple[Array, Array]:
        (size, growth), phase = radius(tau), speed * (tau - low)
        return size * np.sin(phase), growth * np.sin(phase) + size * speed * np.cos(phase)

    return first, second


def draw_strip_imager_motion(lot: Lot) -> Moved:
    """Nod of a push-broom imager: slow sweeps along strips, quick flybacks, and rolls or yaws to the next strip."""
    pitches, rolls, yaws = (list[Slew]() for _ in range(3))
    jitter = np.deg2rad(log_uniform(lot.craft, 1e-4, 3e-3))
    for low, high in pairwise(lot.places(4, 9)):
        sweep, turn = lot.angle(8, 40), 0.55 * low + 0.45 * high
        pitches += [Slew(X, sweep, low, turn - low, 0.1), lot.step(turn, high, -sweep)]
        aside = lot.step(turn, high, lot.angle(8, 50))
        (rolls if lot.rng.random() < 0.5 else yaws).append(aside)
    shaken = [waves(lot.rng, jitter, (0.01, 0.1)) for _ in range(3)]
    yaw = together(stepped(yaws), shaken[0])
    pitch, roll = together(stepped(pitches), shaken[1]), together(stepped(rolls), shaken[2])
    return Moved(headed(lambda tau: yaw(tau)[1], pitch, roll, lot.frame), breaks=knots(pitches + rolls + yaws))


def draw_sun_search_motion(lot: Lot) -> Moved:
    """Search of a lost craft for the Sun: its camera's axis spirals out and in again, and the craft turns about that axis."""
    pitches, rolls, yaws = [], [], []
    breaks: tuple[float, ...] = ()
    widest = np.deg2rad(log_uniform(lot.craft, 6.0, 35.0))
    for low, high in pairwise(lot.places(1, 4)):
        span, peak = 0.75 * (high - low), lot.peak()
        cycles = float(np.clip(peak * span / (2 * np.pi * widest), 1.5, 12.0))
        angle = min(widest, peak * span / (2 * np.pi * cycles))
        pitch, roll = build_circling(low, span, angle, lot.side() * cycles, 0.5)
        pitches.append(pitch)
        rolls.append(roll)
        yaws.append(lot.step(low + span if lot.rng.random() < 0.7 else low, high, lot.angle(30, 170)))
        breaks += (low, low + 0.5 * span, low + span)
    yaw = stepped(yaws)
    rate = headed(lambda tau: yaw(tau)[1], together(*pitches), together(*rolls), lot.frame)
    return Moved(rate, breaks=breaks + knots(yaws))


def draw_coning_motion(lot: Lot) -> Moved:
    """Coning test on a three-axis table: one axis of the gyros after another moves on a cone, then turns about itself."""
    rates, breaks = [], ()
    for place, (low, high) in enumerate(pairwise(lot.places(2, 5))):
        span, half = 0.7 * (high - low), lot.angle(2, 15)
        cycles = lot.peak() / abs(half) * span / (2 * np.pi)
        pitch, roll = build_circling(low, span, half, lot.side() * max(cycles, 1.0), 0.1)
        turn = lot.step(low + span, high, lot.angle(20, 120))
        axes = np.roll(lot.frame, lot.number + place, axis=1)
        rates.append(headed(lambda tau, turn=turn: turn.rates(tau), pitch, roll, axes))  # type: ignore[misc]
        breaks += (low, low + 0.1 * span, low + 0.9 * span, low + span, *turn.knots)
    return Moved(lambda tau: np.asarray(sum(rate(tau) for rate in rates)), breaks=breaks)


def draw_random_switch_motion(lot: Lot) -> Moved:
    """Identification test on a three-axis table, whose axes switch at random between three rates on the ticks of a clock."""
    tick = lot.length_s / float(lot.rng.uniform(20, 90))
    ramp = float(lot.rng.uniform(0.15, 0.6)) * tick
    count = int(lot.length_s / tick) + 2
    levels = lot.rng.choice([-1.0, 0.0, 1.0], (count, 3), p=[0.4, 0.2, 0.4])
    levels[0] = 0.0
    peaks = np.array([lot.peak() for _ in range(3)])
    axes = lot.frame + 0.02 * lot.craft.standard_normal((3, 3))

    def rate(tau: Array) -> Array:
        place = np.clip(np.floor(tau / tick).astype(int), 1, count - 1)
        share = smoothstep((tau - place * tick) / ramp)[:, None]
        now = (1 - share) * levels[place - 1] + share * levels[place]
        return np.asarray((now * peaks) @ axes.T)

    ticks = tick * np.arange(1, count - 1)
    breaks = np.concatenate([ticks, ticks + ramp])
    return Moved(rate, breaks=tuple(breaks[breaks < lot.length_s].tolist()))


def draw_excavator_motion(lot: Lot) -> Moved:
    """Work of an excavator: the boom digs, swings aside, dumps and swings back, and the tracks tilt as the load shifts."""
    swings, booms, tilts = [], [], []
    shake = np.deg2rad(log_uniform(lot.craft, 0.02, 0.2))
    for low, high in pairwise(lot.places(2, 6)):
        at = low + (high - low) * np.array([0.0, 0.25, 0.5, 0.65, 0.9, 1.0])
        dig, lift, aside, tilt = lot.angle(10, 25), lot.angle(20, 45), lot.angle(40, 130), lot.angle(1, 8)
        booms += [lot.step(at[0], at[1], dig), lot.step(at[1], at[2], -dig - abs(lift)), lot.step(at[3], at[4], abs(lift))]
        swings += [lot.step(at[1], at[3], aside), lot.step(at[3], at[4], -0.9 * aside), lot.step(at[4], at[5], -0.1 * aside)]
        tilts += [lot.step(at[0], at[1], tilt), lot.step(at[3], at[5], -tilt)]
    swing, shaken = stepped(swings), [waves(lot.rng, shake, (0.4, 2.0)) for _ in range(3)]
    yaw = together(swing, shaken[0])
    pitch, roll = together(stepped(booms), shaken[1]), together(stepped(tilts), shaken[2])
    return Moved(headed(lambda tau: yaw(tau)[1], pitch, roll, lot.frame), breaks=knots(swings + booms + tilts))


def draw_sawtooth_dives(lot: Lot) -> Moved:
    """Dives of an underwater glider: it goes down and up by turns, banks by shifting its battery, and the bank turns it."""
    steep = np.deg2rad(log_uniform(lot.craft, 15.0, 40.0))
    edges = lot.places(2, 7)
    gain = lot.peak() / np.tan(np.deg2rad(25.0))
    pitches, banks, side = [], [], lot.side()
    for place, (low, high) in enumerate(pairwise(edges)):
        third = (high - low) / 3
        pitches.append(lot.step(low, low + third, side * steep * (1.0 if place == 0 else 2.0)))
        side = -side
        bank = lot.angle(10, 35)
        banks += [lot.step(low, low + 1.5 * third, bank), lot.step(low + 1.7 * third, high, -bank)]
    swell = np.deg2rad(log_uniform(lot.rng, 0.02, 0.5))
    pitch = together(stepped(pitches), waves(lot.rng, swell, (0.03, 0.15)))
    roll = together(stepped(banks), waves(lot.rng, 2 * swell, (0.03, 0.2)))
    return Moved(headed(lambda tau: gain * np.tan(roll(tau)[0]), pitch, roll, lot.frame), breaks=knots(pitches + banks))


def draw_parachute_motion(lot: Lot) -> Moved:
    """Descent below a parachute: the capsule swings on a wandering ellipse and winds the riser up and down, ever less."""
    swing_hz = log_uniform(lot.craft, 0.08, 0.25)
    swing, breathing = np.deg2rad(log_uniform(lot.rng, 2.0, 12.0)), np.deg2rad(log_uniform(lot.rng, 0.02, 0.2))
    wound, calm = abs(lot.angle(40, 400)), log_uniform(lot.rng, 0.5, 4.0) * lot.length_s
    turn = lot.peak() / wound  # rad/s of the winding's phase
    phase = float(lot.rng.uniform(0, 2 * np.pi))
    pitch, roll = (
        together(waves(lot.rng, swing, (0.93 * swing_hz, 1.07 * swing_hz), 3), waves(lot.rng, breathing, (0.5, 2.0)))
        for _ in range(2)
    )

    def yaw_rate(tau: Array) -> Array:
        return np.asarray(wound * turn * np.exp(-tau / calm) * np.cos(turn * tau + phase))

    return Moved(headed(yaw_rate, pitch, roll, lot.frame))


def draw_walking_motion(lot: Lot) -> Moved:
    """Walk with a sensor at the waist: the pelvis turns and tilts with each stride, and the path has corners."""
    stride_hz, height = 0.5 * log_uniform(lot.craft, 1.3, 2.1), np.deg2rad(log_uniform(lot.craft, 1.0, 4.0))
    hurry, period = float(lot.rng.uniform(0.02, 0.15)), lot.length_s / float(lot.rng.uniform(2, 8))
    corners = [lot.step(low, high, lot.angle(30, 180)) for low, high in pairwise(lot.places(3, 10))]

    def build_gait(sizes: tuple[float, ...]) -> Angle:
        harmonics, phases = np.arange(1, len(sizes) + 1), lot.craft.uniform(0, 2 * np.pi, len(sizes))

        def gait(tau: Array) -> tuple[Array, Array]:
            slow = 2 * np.pi * tau / period
            angle = 2 * np.pi * stride_hz * (tau + hurry * period / (2 * np.pi) * np.sin(slow))
            speed = 2 * np.pi * stride_hz * (1 + hurry * np.cos(slow))
            inner = angle[:, None] * harmonics + phases
            return np.sin(inner) @ (height * np.array(sizes)), speed * (np.cos(inner) @ (height * harmonics * np.array(sizes)))

        return gait

    yaw = together(stepped(corners), build_gait((1.0, 0.2, 0.1)))
    pitch, roll = build_gait((0.15, 0.5, 0.05)), build_gait((0.6, 0.1, 0.1))
    return Moved(headed(lambda tau: yaw(tau)[1], pitch, roll, lot.frame), breaks=knots(corners))


KINDS: dict[str, Kind] = {
    "nodding_imager": Kind((2, 5, 10), (4, 12), (240, 2400), (2, 60), (0.2, 2), orbit=True, motion=draw_strip_imager_motion),
    "sun_search": Kind((4, 10, 20), (3, 12), (200, 2400), (1, 40), (0.2, 2), orbit=True, motion=draw_sun_search_motion),
    "coning_table": Kind((50, 100, 200), (3, 12), (60, 600), (0.05, 2), (0.5, 8), motion=draw_coning_motion),
    "random_rates": Kind((50, 100, 200), (3, 12), (20, 240), (0.05, 2), (1, 15), motion=draw_random_switch_motion),
    "excavator": Kind((50, 100, 200), (2, 9), (120, 900), (0.1, 5), (4, 30), motion=draw_excavator_motion),
    "sea_glider": Kind((2, 5, 10), (3, 10), (300, 3600), (5, 100), (0.4, 4), motion=draw_sawtooth_dives),
    "parachute": Kind((50, 100), (2, 10), (60, 600), (0.2, 5), (3, 30), motion=draw_parachute_motion),
    "walker": Kind((100, 200), (2, 9), (60, 400), (0.05, 2), (15, 70), motion=draw_walking_motion),
}

ARCSEC = 1 / 3600
GRADES: dict[str, Grade] = {
    "automotive_chip": Grade((3e-3, 1.5e-2), (0.3, 3.0), (1e-2, 4e-2), (0.1, 0.8)),  # stability-control MEMS, coarse optics
    "module_and_autocollimator": Grade((1.5e-3, 4e-3), (0.01, 0.07), (2e-4, 1e-3), (4 * ARCSEC, 20 * ARCSEC)),
    "cubesat": Grade((1e-3, 4e-3), (0.02, 0.3), (3e-3, 2e-2), (10 * ARCSEC, 100 * ARCSEC)),  # MEMS gyro, star camera
    "gnss_compass": Grade((1.5e-5, 8e-5), (1e-6, 1e-5), (5e-5, 5e-4), (0.05, 0.3)),  # navigation FOG, satellite compass
    "worn_laser": Grade((3e-4, 1.5e-3), (3e-5, 8e-4), (1e-5, 1e-4), (20 * ARCSEC, 200 * ARCSEC)),  # ring laser near its end
}
