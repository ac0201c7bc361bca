"""What a kind of plan and a grade of gyro and references are; every range is log-uniform."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Span = tuple[float, float]


@dataclass(frozen=True)
class Grade:
    """A class of gyro and the references that go with it; each a range, log-uniform.

    Attributes
    ----------
    arw : angle random walk, deg/√s
    bias : deg/s
    matrix : size of the elements of G − I
    sigma : of the references about each axis, deg
    """

    arw: Span
    bias: Span
    matrix: Span
    sigma: Span


@dataclass(frozen=True)
class Kind:
    """A kind of plan; spans are log-uniform.

    Attributes
    ----------
    hz : sample rates to choose from
    intervals : fewest and most
    length_s : of an interval
    spacing_s : between references
    turn_deg_s : peak rates of turns
    turns : most in an interval
    sway_deg_s, sway_hz : of the real sway; None for none
    scan, tumble : whether the intervals swing to and fro, or tumble
    orbit : whether it orbits the Earth, and points to it between the slews if it has no other motion
    grade : its own grade, in place of a drawn one
    draw : (rng, grade, title) to the whole plan, in place of all of the above
    motion : a law of its own (`studies.validation.world.motions.base`) instead of turns, sway, scan or tumble
    """

    hz: tuple[float, ...]
    intervals: tuple[int, int]
    length_s: Span
    spacing_s: Span
    turn_deg_s: Span
    turns: int = 3
    sway_deg_s: Span | None = None
    sway_hz: Span = (0.05, 2.0)
    scan: bool = False
    tumble: bool = False
    orbit: bool = False
    motion: Callable[..., Any] | None = None
    grade: Grade | None = None
    draw: Callable[..., Any] | None = None
