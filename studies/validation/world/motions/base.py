"""What the laws of motion share: what they draw from, what they give, and rates from three angles.

Where a carrier's heading ψ, elevation θ and bank φ are given, A = R_x(φ) R_y(θ) R_z(ψ), its body rate is (Wertz, Spacecraft
Attitude Determination and Control, kinematics of the 3-2-1 sequence)

    ω = (φ' − ψ' sin θ,  θ' cos φ + ψ' cos θ sin φ,  −θ' sin φ + ψ' cos θ cos φ)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from simulator.effects.base import Array
from simulator.effects.common import log_uniform
from simulator.truth.maneuvers import Slew
from simulator.truth.orbit import CircularOrbit
from studies.validation.world.kinds import Kind, Span

Rate = Callable[[Array], Array]
Angle = Callable[[Array], tuple[Array, Array]]
"""An angle and its rate at local times, (n,) → (n,), (n,)."""

X = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Lot:
    """What a law draws from.

    Attributes
    ----------
    rng : of the interval
    craft : begins anew in every interval, so that what is drawn from it first is the craft's own
    kind : the ranges
    length_s, start_s : of the interval, the latter since the epoch
    frame : (3, 3) columns are the carrier's axes in the gyros' frame
    number : of the interval
    orbit : None without one
    """

    rng: np.random.Generator
    craft: np.random.Generator
    kind: Kind
    length_s: float
    start_s: float
    frame: Array
    number: int
    orbit: CircularOrbit | None

    def peak(self) -> float:
        """A rate of the kind's, rad/s."""
        return float(np.deg2rad(log_uniform(self.rng, *self.kind.turn_deg_s)))

    def side(self) -> float:
        """One, or minus one."""
        return float(self.rng.choice([-1.0, 1.0]))

    def angle(self, low_deg: float, high_deg: float) -> float:
        """An angle of either sign, rad."""
        return self.side() * float(np.deg2rad(log_uniform(self.rng, low_deg, high_deg)))

    def places(self, fewest: int, most: int) -> Array:
        """Edges of stretches of unequal lengths that fill the interval, (count + 1,) s."""
        parts = self.rng.uniform(0.5, 1.5, int(self.rng.integers(fewest, most + 1)))
        return np.append(0.0, np.cumsum(parts)) / parts.sum() * self.length_s

    def step(self, low: float, high: float, angle: float, axis: Array = X, least_s: float = 0.0) -> Slew:
        """A turn between two times, at a peak rate of the kind's unless it has a least duration, or no time for it."""
        duration = min(max(1.5 * abs(angle) / self.peak(), least_s), 0.8 * (high - low))
        first = low + float(self.rng.uniform(0.05, 0.95)) * (high - low - duration)
        return Slew(axis / np.linalg.norm(axis), angle, first, duration, float(self.rng.uniform(0.3, 0.5)))


@dataclass(frozen=True)
class Moved:
    """What a law gives: a body rate in the gyros' frame, its turns, and further times where it is not smooth."""

    rate: Rate
    turns: tuple[Slew, ...] = ()
    breaks: tuple[float, ...] = field(default=())


def knots(steps: Sequence[Slew]) -> tuple[float, ...]:
    """Times where steps are not smooth."""
    return tuple(knot for step in steps for knot in step.knots)


def stepped(steps: Sequence[Slew], begin: float = 0.0) -> Angle:
    """An angle that goes from one value to the next."""

    def evaluate(tau: Array) -> tuple[Array, Array]:
        angle, rate = np.full(len(tau), begin), np.zeros(len(tau))
        for step in steps:
            angle += step.angles(tau)
            rate += step.rates(tau)
        return angle, rate

    return evaluate


def waves(rng: np.random.Generator, size: float, hz: Span, count: int = 5) -> Angle:
    """An angle of such an rms, rad, that is a sum of waves."""
    turn = 2 * np.pi * np.array([log_uniform(rng, *hz) for _ in range(count)])
    high, phase = rng.uniform(0.3, 1.0, count), rng.uniform(0, 2 * np.pi, count)
    high *= size * np.sqrt(2 / (high @ high))

    def evaluate(tau: Array) -> tuple[Array, Array]:
        inner = tau[:, None] * turn + phase
        return np.sin(inner) @ high, np.cos(inner) @ (high * turn)

    return evaluate


def together(*angles: Angle) -> Angle:
    """A sum of angles."""

    def evaluate(tau: Array) -> tuple[Array, Array]:
        parts = [angle(tau) for angle in angles]
        return np.sum([part[0] for part in parts], axis=0), np.sum([part[1] for part in parts], axis=0)

    return evaluate


def headed(yaw_rate: Rate, pitch: Angle, roll: Angle, frame: Array) -> Rate:
    """Body rate of a carrier from the rate of its heading, its elevation and its bank."""

    def evaluate(tau: Array) -> Array:
        turning, (theta, up), (phi, over) = yaw_rate(tau), pitch(tau), roll(tau)
        own = [
            over - turning * np.sin(theta),
            up * np.cos(phi) + turning * np.cos(theta) * np.sin(phi),
            turning * np.cos(theta) * np.cos(phi) - up * np.sin(phi),
        ]
        return np.stack(own, axis=1) @ frame.T

    return evaluate
