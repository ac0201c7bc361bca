"""What a craft does in an interval, as an analytic body rate.

An interval's body rate is a sum of analytic pieces about axes of the body: a constant, turns with ramps of any share, a scan
that swings to and fro, sway at several frequencies, and a tumble ω = R(e, λt) w + λ e, whose attitude has the closed form A(t)
= R(e, λt) exp(−[w×]t) A(0). With an orbit the rate is that of an Earth-pointing `Profile` of the simulator. Or else the motion
is a law of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import Profile, Slew, Sway
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import convert_to_quaternion, turned
from studies.validation.world.kinds import Kind, Span
from studies.validation.world.motions.base import Lot

QUIET_S = 20.0  # before and after a turn

Rate = Callable[[Array], Array]


@dataclass(frozen=True)
class Path:
    """The rate of an interval at local times from 0 to its length, its turns, and the attitude (4,) that it begins in.

    A motion that is a law of its own (`studies.validation.world.motions`) has breaks: further times where it is not smooth.
    """

    rate: Rate
    length_s: float
    turns: tuple[Slew, ...]
    begin: Array
    breaks: tuple[float, ...] | None = None

    @property
    def still(self) -> bool:
        """Whether nothing is commanded to turn."""
        return not self.turns and self.breaks is None

    @property
    def knots(self) -> Array:
        """Times at which the rate is not smooth, s."""
        return np.unique(np.concatenate([[0.0, self.length_s], self.breaks or (), *(turn.knots for turn in self.turns)]))


def build_tumbling_rate(axis: Array, spin: float, w: Array) -> Rate:
    """ω = R(e, λt) w + λ e; (3,) unit vector, rad/s, (3,) rad/s."""
    return lambda tau: turned(axis, spin * tau, w) + spin * axis


def draw_turns(rng: np.random.Generator, kind: Kind, length: float, frame: Array, number: int) -> list[Slew]:
    """Turns of an interval, one after another, about near the axes of a frame in their order, so that all of them come."""
    count = int(rng.integers(0 if number > 2 else 1, kind.turns + 1))
    edges = np.linspace(0, length, count + 1)
    out = []
    for place, (low, high) in enumerate(pairwise(edges)):
        room = min(high - low - 2 * min(QUIET_S, 0.1 * (high - low)), 600.0)
        duration = float(rng.uniform(0.3, 0.9)) * room
        first = float(low + rng.uniform(0.1, 0.9) * (high - low - duration))
        ramp = float(rng.choice([0.5, rng.uniform(0.15, 0.5)]))
        peak = np.deg2rad(log_uniform(rng, *kind.turn_deg_s)) * rng.choice([-1, 1])
        axis = frame[:, (number + place) % 3] + 0.2 * rng.standard_normal(3)
        out.append(Slew(axis / np.linalg.norm(axis), float(peak * duration * (1 - ramp)), first, duration, ramp))
    return out


def _draw_sway(rng: np.random.Generator, amplitude: Span, hz: Span, most_hz: float) -> Rate:
    """Sway at three frequencies about each axis, rad/s."""
    size = np.deg2rad(log_uniform(rng, *amplitude)) * rng.uniform(0.2, 1, (3, 3)) / np.sqrt(3)
    turn = 2 * np.pi * np.array([[min(log_uniform(rng, *hz), most_hz) for _ in range(3)] for _ in range(3)])
    phase = rng.uniform(0, 2 * np.pi, (3, 3))
    return lambda tau: np.asarray((size * np.sin(tau[:, None, None] * turn + phase)).sum(axis=2))


def draw_free_path(rng: np.random.Generator, kind: Kind, length: float, turns: list[Slew], begin: Array, frame: Array) -> Path:
    """A craft, or a hand, without an orbit."""
    rest = np.deg2rad(log_uniform(rng, 1e-4, 2e-2)) * frame @ rng.standard_normal(3) * (rng.random() < 0.6)
    pieces: list[Rate] = [lambda tau: np.tile(rest, (len(tau), 1))]
    peak = np.deg2rad(log_uniform(rng, *kind.turn_deg_s))
    if kind.tumble:
        axis = frame[:, int(rng.integers(3))]
        pieces = [build_tumbling_rate(axis, float(peak * rng.uniform(-1, 1)), peak * rng.standard_normal(3))]
    elif kind.scan:
        axis, period = frame[:, int(rng.integers(3))], length / rng.uniform(2, 12)
        pieces.append(lambda tau: peak * np.tanh(2 * np.sin(2 * np.pi / period * tau))[:, None] * axis)
    if kind.sway_deg_s:
        pieces.append(_draw_sway(rng, kind.sway_deg_s, kind.sway_hz, np.inf))
    pieces += [lambda tau, turn=turn: turn.rates(tau)[:, None] * turn.axis for turn in turns]  # type: ignore[misc]
    return Path(lambda tau: np.asarray(sum(piece(tau) for piece in pieces)), length, tuple(turns), begin)


def draw_pointing_path(
    rng: np.random.Generator, kind: Kind, orbit: CircularOrbit, start: float, length: float, turns: list[Slew], yaw: float
) -> Path:
    """A craft that points to the Earth between its slews."""
    sway = None
    if kind.sway_deg_s:
        period = 1 / np.array([log_uniform(rng, *kind.sway_hz) for _ in range(3)])
        amplitude = np.deg2rad(log_uniform(rng, *kind.sway_deg_s)) * period / (2 * np.pi)
        sway = Sway(amplitude, period, rng.uniform(0, 2 * np.pi, 3))
    profile = Profile(orbit, start, start + length, yaw, tuple(turns), None, sway)
    return Path(profile.rate, length, tuple(turns), convert_to_quaternion(profile.attitude(np.zeros(1)))[0])


def draw_law_path(
    rng: np.random.Generator, craft: int, kind: Kind, orbit: CircularOrbit | None, start: float, length: float, begin: Array,
    frame: Array, number: int,
) -> Path:  # fmt: skip
    """A motion that is a law of its own; craft is the seed of what all intervals share."""
    lot = Lot(rng, np.random.default_rng(craft), kind, length, start, frame, number, orbit)
    assert kind.motion is not None
    moved = kind.motion(lot)
    return Path(moved.rate, length, moved.turns, begin, moved.breaks)
