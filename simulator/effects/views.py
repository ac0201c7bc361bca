"""What an effect sees of a recording or a plan, and what it says of it.

Arrays are in radians, radians per second and seconds; what an effect says of itself is in its own unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = float | str
Parameters = Mapping[str, Value]


@dataclass(frozen=True)
class Stream:
    """The gyro samples as an effect on rates sees them.

    Attributes
    ----------
    t_s : (n,) middle of each sample, s since the epoch
    duration_s : (n,)
    rates : (n, 3) body rates, rad/s: the true ones in the simulator, the best estimate in a diagnosis
    raw : (n, gyros) noise-free raw rates, of three gyros G⁻¹(ω − b), rad/s
    intervals : the samples of each interval
    orbit_period_s : NaN if unknown
    span_s : first start and last stop of the intervals
    housekeeping : named columns at t_s, (n,) each
    gyros : names of the gyros
    axes : (gyros, 3) scale factor times axis of each, where they are not x, y and z
    """

    t_s: Array
    duration_s: Array
    rates: Array
    raw: Array
    intervals: tuple[slice, ...]
    orbit_period_s: float
    span_s: tuple[float, float]
    housekeeping: Mapping[str, Array] = field(default_factory=dict)
    gyros: tuple[str, ...] = ("x", "y", "z")
    axes: Array | None = None


@dataclass(frozen=True)
class Trackers:
    """Which of several sensors each reference is of, and what it sees.

    Attributes
    ----------
    names : of the sensors; the first defines the body's axes
    sensor : (m,) number of that of each reference
    to_axes : (m, 3, 3) its mounting, body to sensor; its boresight is its z axis
    rates : (m, 3) body rates, rad/s
    path : (m,) angle that its boresight has moved over the sky since the interval's start, rad
    orbital, annual : (m, 3) velocity on the orbit and of the Earth about the Sun, inertial, in units of that of light; NaN
        where the orbit's elements are not stated
    housekeeping : named columns at the references, (m,) each
    """

    names: tuple[str, ...]
    sensor: NDArray[np.intp]
    to_axes: Array
    rates: Array
    path: Array
    orbital: Array
    annual: Array
    housekeeping: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class References:
    """The reference attitudes as an effect on them sees them.

    Attributes
    ----------
    t_s : (m,) s since the epoch
    quaternions : (m, 4) inertial to body, scalar last
    interval : (m,) index of the interval each belongs to
    forward : (m,) str, the body axis along the velocity, "+x", "-x", …; "" if unknown
    orbit_period_s : NaN if unknown
    heading : (m,) rad, angle of the velocity in the body's xy-plane from +x to +y; NaN if unknown, None if all are
    trackers : of references by several sensors, None of one in body axes
    """

    t_s: Array
    quaternions: Array
    interval: NDArray[np.intp]
    forward: NDArray[np.str_]
    orbit_period_s: float
    heading: Array | None = None
    trackers: Trackers | None = None


@dataclass(frozen=True)
class Surroundings:
    """What a recording, or a maneuver plan, offers for an effect to act on and to be seen in.

    Attributes
    ----------
    stream : the gyro samples; noise-free, or the best estimate of that
    references : the reference attitudes
    arw : stated angle random walk, rad/√s
    sample_s : length of a sample, s
    reference_sigma : (m, 3) stated sigma of the references, rad
    """

    stream: Stream
    references: References
    arw: float
    sample_s: float
    reference_sigma: Array

    @property
    def sample_sigma_deg(self) -> float:
        """Stated white noise of a sample, deg/s."""
        return float(np.rad2deg(self.arw / np.sqrt(self.sample_s)))


@dataclass(frozen=True)
class ProcessTimes:
    """Times at which the covariance of a random process is wanted.

    Attributes
    ----------
    t_s : (c,) s since the epoch
    run_s : (c,) sampled time up to then, the gaps between intervals left out, s
    interval : (c,) index of the interval
    path : (c,) angle that a tracker's boresight has moved over the sky since the interval's start, rad; None for others
    """

    t_s: Array
    run_s: Array
    interval: NDArray[np.intp]
    path: Array | None = None


@dataclass(frozen=True)
class SampleView:
    """Gyro samples as recorded, for effects that bring a test of their own.

    Attributes
    ----------
    t_s : (n,) middle of each sample, s since the epoch
    sample_s : length of a sample, s
    rates : (n, gyros) raw rates as recorded, rad/s
    sigma : (gyros,) white noise of a sample, rad/s
    inside : (n,) bool, whether a sample lies inside an interval
    intervals : the samples of each interval
    motion : (n, gyros) raw rates without noise, from the references or by smoothing, rad/s; NaN where they are not known
    gyros : names of the gyros
    """

    t_s: Array
    sample_s: float
    rates: Array
    sigma: Array
    inside: NDArray[np.bool_]
    intervals: tuple[slice, ...]
    motion: Array
    gyros: tuple[str, ...] = ("x", "y", "z")


@dataclass(frozen=True)
class Detection:
    """What an effect's own test found in the samples.

    Attributes
    ----------
    effect, axis : which
    size, sigma : in its unit
    unit : of the size
    parameters : its other numbers, as far as they are known
    log_odds : log of the probability of the samples with the effect over that without
    p_value : of the test if the effect is absent
    text : what was seen, for people
    """

    effect: str
    axis: str | None
    size: float
    unit: str
    sigma: float
    parameters: Parameters
    log_odds: float
    p_value: float
    text: str


@dataclass(frozen=True)
class Fault:
    """A stretch of a recording that shows no rate or no attitude, and the effect that is found to make it.

    Attributes
    ----------
    detection : what was found
    samples : (n,) bool, gyro samples that carry no rate
    references : (m,) bool, references that carry no attitude
    """

    detection: Detection
    samples: NDArray[np.bool_]
    references: NDArray[np.bool_]


@dataclass(frozen=True)
class SampleTests:
    """The tests of the samples that a diagnosis makes, as far as the smallest size which they show depends on them.

    Attributes
    ----------
    power : probability to be seen at the smallest size
    quiet : samples in each arc clear of slews and transitions
    event_p : p-value at which a wrong noise level counts
    correlated : variance of a mean of squared second differences, over that of as many independent squares
    line_p, lowest_line_hz : p-value at which a tone counts, and the lowest frequency that is tried
    outlier_sigma : from where on a sample is an outlier
    fewest_clipped : samples at the same largest reading that make a limit
    coarse : smallest step on which readings count as a lattice, in sigma of a sample
    fewest_references : second differences of references without which their noise is not tested
    reference_p : p-value at which a wrong noise level of the references counts
    trimming : what leaving outliers out adds to the variance of that test
    """

    power: float
    quiet: tuple[int, ...]
    event_p: float
    correlated: float
    line_p: float
    lowest_line_hz: float
    outlier_sigma: float
    fewest_clipped: int
    coarse: float
    fewest_references: int
    reference_p: float
    trimming: float


@dataclass(frozen=True)
class Smallest:
    """The smallest size of an effect that shows in the samples; infinite if none does, with the reason as text."""

    axis: str | None
    size: float
    text: str = ""
