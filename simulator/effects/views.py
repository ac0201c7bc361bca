"""What an effect sees of a recording or a plan, and what it says of it.

Arrays are in radians, radians per second and seconds; what an effect says of itself is in its own unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, Flags

Value = float | str
Parameters = Mapping[str, Value]


@dataclass(frozen=True)
class Stream:
    """The gyro samples as an effect on rates sees them."""

    t_s: Array  # (n,) middle of each sample, s since the epoch
    duration_s: Array  # (n,)
    rates: Array  # (n, 3) body rates, rad/s: the true ones in the simulator, the best estimate in a diagnosis
    raw: Array  # (n, gyros) noise-free raw rates, of three gyros G⁻¹(ω − b), rad/s
    intervals: tuple[slice, ...]  # the samples of each interval
    orbit_period_s: float  # NaN if unknown
    span_s: tuple[float, float]  # first start and last stop of the intervals
    housekeeping: Mapping[str, Array] = field(default_factory=dict)  # named columns at t_s, (n,) each
    gyros: tuple[str, ...] = ("x", "y", "z")  # names of the gyros
    axes: Array | None = None  # (gyros, 3) scale factor times axis of each, where they are not x, y and z


@dataclass(frozen=True)
class Trackers:
    """Which of several sensors each reference is of, and what it sees."""

    names: tuple[str, ...]  # of the sensors; the first defines the body's axes
    sensor: NDArray[np.intp]  # (m,) number of that of each reference
    to_axes: Array  # (m, 3, 3) its mounting, body to sensor; its boresight is its z axis
    rates: Array  # (m, 3) body rates, rad/s
    path: Array  # (m,) angle that its boresight has moved over the sky since the interval's start, rad
    # (m, 3) velocities, inertial, in units of that of light; NaN where the orbit's elements are not stated
    orbital: Array  # on the orbit
    annual: Array  # of the Earth about the Sun
    housekeeping: Mapping[str, Array] = field(default_factory=dict)  # named columns at the references, (m,) each


@dataclass(frozen=True)
class References:
    """The reference attitudes as an effect on them sees them."""

    t_s: Array  # (m,) s since the epoch
    quaternions: Array  # (m, 4) inertial to body, scalar last
    interval: NDArray[np.intp]  # (m,) index of the interval each belongs to
    forward: NDArray[np.str_]  # (m,) str, the body axis along the velocity, "+x", "-x", …; "" if unknown
    orbit_period_s: float  # NaN if unknown
    # (m,) rad, angle of the velocity in the body's xy-plane from +x to +y; NaN if unknown, None if all are
    heading: Array | None = None
    trackers: Trackers | None = None  # of references by several sensors, None of one in body axes


@dataclass(frozen=True)
class Surroundings:
    """What a recording, or a maneuver plan, offers for an effect to act on and to be seen in."""

    stream: Stream  # the gyro samples; noise-free, or the best estimate of that
    references: References  # the reference attitudes
    arw: float  # stated angle random walk, rad/√s
    sample_s: float  # length of a sample, s
    reference_sigma: Array  # (m, 3) stated sigma of the references, rad

    @property
    def sample_sigma_deg(self) -> float:
        """Stated white noise of a sample, deg/s."""
        return float(np.rad2deg(self.arw / np.sqrt(self.sample_s)))


@dataclass(frozen=True)
class ProcessTimes:
    """Times at which the covariance of a random process is wanted."""

    t_s: Array  # (c,) s since the epoch
    run_s: Array  # (c,) sampled time up to then, the gaps between intervals left out, s
    interval: NDArray[np.intp]  # (c,) index of the interval
    # (c,) angle that a tracker's boresight has moved over the sky since the interval's start, rad; None for others
    path: Array | None = None


@dataclass(frozen=True)
class SampleView:
    """Gyro samples as recorded, for effects that bring a test of their own."""

    t_s: Array  # (n,) middle of each sample, s since the epoch
    sample_s: float  # length of a sample, s
    rates: Array  # (n, gyros) raw rates as recorded, rad/s
    sigma: Array  # (gyros,) white noise of a sample, rad/s
    inside: Flags  # (n,) bool, whether a sample lies inside an interval
    intervals: tuple[slice, ...]  # the samples of each interval
    # (n, gyros) raw rates without noise, from the references or by smoothing, rad/s; NaN where they are not known
    motion: Array
    gyros: tuple[str, ...] = ("x", "y", "z")  # names of the gyros


@dataclass(frozen=True)
class Detection:
    """What an effect's own test found in the samples."""

    effect: str
    axis: str | None
    size: float  # in its unit, as sigma
    unit: str  # of the size
    sigma: float
    parameters: Parameters  # its other numbers, as far as they are known
    log_odds: float  # log of the probability of the samples with the effect over that without
    p_value: float  # of the test if the effect is absent
    text: str  # what was seen, for people


@dataclass(frozen=True)
class Fault:
    """A stretch of a recording that shows no rate or no attitude, and the effect that is found to make it."""

    detection: Detection  # what was found
    samples: Flags  # (n,) bool, gyro samples that carry no rate
    references: Flags  # (m,) bool, references that carry no attitude


@dataclass(frozen=True)
class SampleTests:
    """The tests of the samples that a diagnosis makes, as far as the smallest size which they show depends on them."""

    power: float  # probability to be seen at the smallest size
    quiet: tuple[int, ...]  # samples in each arc clear of slews and transitions
    event_p: float  # p-value at which a wrong noise level counts
    correlated: float  # variance of a mean of squared second differences, over that of as many independent squares
    line_p: float  # p-value at which a tone counts
    lowest_line_hz: float  # the lowest frequency that is tried
    outlier_sigma: float  # from where on a sample is an outlier
    fewest_clipped: int  # samples at the same largest reading that make a limit
    coarse: float  # smallest step on which readings count as a lattice, in sigma of a sample
    fewest_references: int  # second differences of references without which their noise is not tested
    reference_p: float  # p-value at which a wrong noise level of the references counts
    trimming: float  # what leaving outliers out adds to the variance of that test


@dataclass(frozen=True)
class Smallest:
    """The smallest size of an effect that shows in the samples; infinite if none does, with the reason as text."""

    axis: str | None
    size: float
    text: str = ""
