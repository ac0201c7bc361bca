"""The slews of one interval as a few numbers, within limits on rate, acceleration, the Sun and time.

An interval starts and has to end in one of the pointing modes, whose yaws from LVLH are quarter turns k₁ and k₂. The first slew
is free, with the rotation vector r₁ in body axes. The second one leads to the end,

    R(r₂) = R(e_z (k₂ − k₁) π/2) R(r₁)ᵀ    the short way,

so that no plan needs a slew outside its intervals. Where r₂ = 0 there is one slew only.

A slew takes the shortest time that rate and acceleration allow. Its ramps are smoothsteps (`simulator.truth.maneuvers`), whose
largest slope is 3/2: with the peak rate Ω and ramps of d = f T the acceleration is 1.5 Ω/d. Hence, for limits Ω and a,

    d = 1.5 Ω/a,  T = θ/Ω + d    if θ ≥ Ω d;    else f = ½,  T = √(6 θ/a)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from diagnosis.plan.settings import SETTINGS
from simulator.scenario import IntervalSection, Scenario, SlewSection, build_profiles
from simulator.truth.maneuvers import MODE_YAW, Profile
from simulator.truth.sun import DAY, compute_julian_date, compute_sun_vector

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

QUARTER = np.pi / 2
QUARTER_MODES = tuple(sorted(MODE_YAW, key=lambda mode: MODE_YAW[mode] % (2 * np.pi)))  # by the quarter turns of their yaw
NO_TURN = 1e-6  # rad, below which a rotation is none


@dataclass(frozen=True)
class SlewLimits:
    """What a plan may do.

    Attributes
    ----------
    rate, acceleration : of the attitude relative to LVLH, rad/s and rad/s²
    slew_s : total time of all slews and transitions of holds, s
    settle_s : from an interval's start to its first slew, and from its last slew to its end, s
    keep_out : body axis, and its smallest angle to the Sun, rad, from an interval's first slew to its last; None for any
    """

    rate: float
    acceleration: float
    slew_s: float
    settle_s: float = 60.0
    keep_out: tuple[Vector, float] | None = None


@dataclass(frozen=True)
class IntervalDesign:
    """The slews of one interval.

    Attributes
    ----------
    start, end : yaw of the modes it starts and ends in, quarter turns; an index of `QUARTER_MODES`
    turn : rotation vector of the first slew, rad in body axes; zero for none
    place : shares in [0, 1]: of the spare time before the first slew, and of the rest between the two slews
    hold : whether it keeps the scenario's inertial hold, then without slews
    length : share of the scenario's interval that it lasts, from the same start
    """

    start: int
    end: int
    turn: Vector = (0.0, 0.0, 0.0)
    place: tuple[float, float] = (0.0, 0.0)
    hold: bool = False
    length: float = 1.0

    @cached_property
    def turns(self) -> list[Array]:
        """Rotation vectors of the slews, rad; each (3,)."""
        needed = Rotation.from_rotvec([0.0, 0.0, -QUARTER * (self.end - self.start)])
        second = -(needed * Rotation.from_rotvec(self.turn)).as_rotvec()
        return [turn for turn in (np.array(self.turn), second) if np.linalg.norm(turn) > NO_TURN]


def compute_shortest_slew(angle: float, limits: SlewLimits) -> tuple[float, float]:
    """Compute the duration, s, and the ramp fraction of the shortest slew by an angle ≥ 0, rad."""
    ramp = 1.5 * limits.rate / limits.acceleration
    if angle >= limits.rate * ramp:
        duration = angle / limits.rate + ramp
        return duration, ramp / duration
    return float(np.sqrt(6 * angle / limits.acceleration)), 0.5


def read_limits(scenario: Scenario) -> tuple[float, float]:
    """The largest rate, rad/s, and acceleration, rad/s², of a scenario's slews; zero without slews."""
    slews = [slew for interval in scenario.interval for slew in interval.slew]
    peaks = [abs(np.deg2rad(one.angle_deg)) / (one.duration_s * (1 - one.ramp_fraction)) for one in slews]
    slopes = [1.5 * peak / (one.ramp_fraction * one.duration_s) for peak, one in zip(peaks, slews, strict=True)]
    return max(peaks, default=0.0), max(slopes, default=0.0)


def compute_slew_time(scenario: Scenario) -> float:
    """Compute the time that slews and the transitions of holds take, s: all with neither orbit rate nor inertial rate zero."""
    return float(sum(stop - start for profile in build_profiles(scenario) for start, stop in profile.moving_spans))


def find_end_quarter(profile: Profile) -> int | None:
    """Find the quarter turns of yaw that an interval ends in; None for an attitude that is no mode's."""
    turned = Rotation.identity()
    for slew in profile.slews:
        turned = Rotation.from_rotvec(-slew.angle * slew.axis) * turned
    x, y, z = turned.as_rotvec()
    quarters = (profile.yaw - z) / QUARTER
    return round(quarters) % 4 if max(abs(x), abs(y), abs(quarters - round(quarters))) < NO_TURN else None


def build_slews(design: IntervalDesign, length: float, limits: SlewLimits) -> tuple[tuple[SlewSection, ...], float]:
    """The slews in an interval of the scenario's length, s, and the time that is left over, s: negative if they do not fit."""
    turns = design.turns
    angles = [float(np.linalg.norm(turn)) for turn in turns]
    shapes = [compute_shortest_slew(angle, limits) for angle in angles]
    spare = length * design.length - 2 * limits.settle_s - sum(duration for duration, _ in shapes)
    before = design.place[0] * max(spare, 0.0)
    begin, out = limits.settle_s + before, []
    for turn, angle, (duration, ramp) in zip(turns, angles, shapes, strict=True):
        out.append(
            SlewSection(
                axis=tuple((turn / angle).tolist()),
                angle_deg=float(np.rad2deg(angle)),
                start_s=begin,
                duration_s=duration,
                ramp_fraction=ramp,
            )
        )
        begin += duration + design.place[1] * (max(spare, 0.0) - before)
    return tuple(out), spare


def build_interval(section: IntervalSection, design: IntervalDesign, limits: SlewLimits) -> IntervalSection:
    """The interval with a design that fits in it."""
    slews, _ = build_slews(design, section.stop_s - section.start_s, limits)
    mode = QUARTER_MODES[design.start]
    text = "inertial hold" if design.hold else "slews" if slews else f"{mode} forward"
    return section.model_copy(
        update={
            "stop_s": section.start_s + design.length * (section.stop_s - section.start_s),
            "mode": mode,
            "slew": slews,
            "hold": section.hold if design.hold else None,
            "activity": text,
        }
    )


def compute_sun_margin(profile: Profile, epoch: str, keep_out: tuple[Sequence[float], float]) -> float:
    """Smallest angle of a body axis to the Sun less the keep-out angle, rad, from the first slew to the last."""
    if not profile.slews:
        return float(np.pi)
    first, last = profile.slews[0].start, profile.slews[-1].stop
    tau = np.linspace(first, last, 2 + int((last - first) / SETTINGS.sun_check_s))
    axis = np.array(keep_out[0]) / np.linalg.norm(keep_out[0])
    sun = compute_sun_vector(compute_julian_date(epoch) + (profile.start_s + tau) / DAY)
    cosine = np.einsum("i,nij,nj->n", axis, profile.compute_tracking_attitude(tau), sun)
    return float(np.arccos(np.clip(cosine, -1, 1)).min()) - keep_out[1]
