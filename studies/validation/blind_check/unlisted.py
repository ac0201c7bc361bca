"""Effects that are on no list, to see whether a diagnosis says "unknown".

They stand for what somebody else would invent: other non-linearities, other periods, memory of slews, random jumps, errors of
the references with other shapes. Each is a time function h of the truth about one axis; size · h is added to the noise-free
reading or to the error angle of the references, and everything else is the full simulation. Shapes are of order one; what
size they get follows from how strong they shall be.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from simulator.effects import References, Stream
from simulator.effects.common import DAY, gauss_markov, recursion

Array = NDArray[np.float64]

ORBIT_RATE = 1.1e-3  # rad/s, to make rates of order one
SLEWING = 2.0  # times orbit rate: a yaw rate above this is a slew
ECLIPSE = 0.35  # share of the orbit
ODD = 1.37  # periods an orbit of a bias locked to nothing


@dataclass(frozen=True)
class View:
    """What an effect may depend on.

    Attributes
    ----------
    stream : true rates at the samples
    references : true attitudes at the references
    starts_s : (intervals,) start of each interval, s
    stops_s : (intervals,) its stop, s
    axis : 0, 1, 2: the axis acted on
    phase : rad, any
    share : in (0, 1), any
    rng : for random effects, at the start of its stream
    """

    stream: Stream
    references: References
    starts_s: Array
    stops_s: Array
    axis: int
    phase: float
    share: float
    rng: np.random.Generator

    @property
    def orbit(self) -> Array:
        """Orbit angle n t at the samples, rad, (n,)."""
        return 2 * np.pi * self.stream.t_s / self.stream.orbit_period_s

    @property
    def own_rate(self) -> Array:
        """Rate about the axis, over orbit rate, (n,)."""
        return np.asarray(self.stream.rates[:, self.axis] / ORBIT_RATE)

    @property
    def other_rate(self) -> Array:
        """Rate about another axis, yaw unless it is the own one, over orbit rate, (n,)."""
        return np.asarray(self.stream.rates[:, 2 if self.axis != 2 else 1] / ORBIT_RATE)

    def since_start(self) -> Array:
        """Time since the interval's start at the samples, s, (n,)."""
        out = np.empty(self.stream.t_s.size)
        for part, start in zip(self.stream.intervals, self.starts_s, strict=True):
            out[part] = self.stream.t_s[part] - start
        return out

    def since_slew(self) -> Array:
        """Time since the last yaw slew ended, inside the interval, s; infinite before it and zero during it; (n,)."""
        slewing = np.abs(self.stream.rates[:, 2]) > SLEWING * ORBIT_RATE
        out = np.full(self.stream.t_s.size, np.inf)
        for part in self.stream.intervals:
            last = np.maximum.accumulate(np.where(slewing[part], np.arange(part.stop - part.start), -1))
            known = last >= 0
            t_s = self.stream.t_s[part]
            out[part] = np.where(known, t_s - t_s[np.maximum(last, 0)], np.inf)
        return out

    def span_share(self) -> Array:
        """Mission time from 0 to 1, (n,)."""
        first, last = self.stream.span_s
        return np.asarray((self.stream.t_s - first) / (last - first))

    def reference_since_start(self) -> Array:
        """Time since the interval's start at the references, s, (m,)."""
        return np.asarray(self.references.t_s - self.starts_s[self.references.interval])


def _scale_cubic(view: View) -> Array:
    return np.asarray(view.own_rate**3)


def _acceleration_squared(view: View) -> Array:
    """Angular acceleration about the axis with the largest, squared; on the scale of a slew's ramp."""
    out = np.zeros(view.stream.t_s.size)
    for part in view.stream.intervals:
        slope = np.gradient(view.stream.rates[part, 2], view.stream.t_s[part])
        out[part] = (slope / 5e-5) ** 2
    return out


def _rate_product(view: View) -> Array:
    first, second = (k for k in range(3) if k != view.axis)
    return np.asarray(view.stream.rates[:, first] * view.stream.rates[:, second] / ORBIT_RATE**2)


def _orbit_times_rate(view: View) -> Array:
    return np.asarray(np.sin(view.orbit + view.phase) * view.stream.rates[:, 1] / ORBIT_RATE)


def _warm_up(view: View) -> Array:
    return np.asarray(np.exp(-view.since_start() / (600 + 1400 * view.share)))


def _bias_twice_orbit(view: View) -> Array:
    return np.asarray(np.sin(2 * view.orbit + view.phase))


def _bias_odd_period(view: View) -> Array:
    return np.asarray(np.sin(ODD * view.orbit + view.phase))


def _eclipse(view: View) -> Array:
    return (np.mod(view.orbit + view.phase, 2 * np.pi) < 2 * np.pi * ECLIPSE).astype(float)


def _scale_drift(view: View) -> Array:
    return np.asarray(view.other_rate * view.span_share())


def _scale_orbital(view: View) -> Array:
    return np.asarray(view.own_rate * np.sin(view.orbit + view.phase))


def _relaxing_misalignment(view: View) -> Array:
    return np.asarray(view.other_rate * np.exp(-view.since_slew() / (300 + 900 * view.share)))


def _slew_heating(view: View) -> Array:
    return np.asarray(np.exp(-view.since_slew() / (400 + 800 * view.share)))


def _markov(view: View) -> Array:
    return np.asarray(gauss_markov(view.rng, view.stream.t_s, 300.0))


def _hysteresis(view: View) -> Array:
    yaw = view.stream.rates[:, 2]
    last = np.maximum.accumulate(np.where(np.abs(yaw) > SLEWING * ORBIT_RATE, np.arange(yaw.size), -1))
    return np.asarray(np.where(last >= 0, np.sign(yaw[np.maximum(last, 0)]), 0.0))


def _telegraph(view: View) -> Array:
    """Two levels with exponential dwell times of 900 s on average, in sampled time."""
    run = np.cumsum(view.stream.duration_s)
    jumps = np.cumsum(view.rng.exponential(900.0, int(run[-1] / 200) + 50))
    return np.asarray(np.searchsorted(jumps, run) % 2, dtype=float)


def _chirp(view: View) -> Array:
    tau = view.since_start()
    return np.asarray(np.sin(2 * np.pi * (tau / 4000 + 0.5 * tau**2 / 4000 / 1500) + view.phase))


def _lagging_crosstalk(view: View) -> Array:
    """What another axis showed some twenty seconds before, over what it shows."""
    out = np.empty(view.stream.t_s.size)
    for part in view.stream.intervals:
        decay = np.exp(-view.stream.duration_s[part] / (15 + 45 * view.share))
        rate = view.other_rate[part]
        drive = (1 - decay) * rate
        drive[0] = rate[0]
        out[part] = recursion(decay, drive) - rate
    return out


def _bias_daily(view: View) -> Array:
    return np.asarray(np.sin(2 * np.pi * view.stream.t_s / DAY + view.phase))


def _reference_ramp(view: View) -> Array:
    return np.asarray(view.reference_since_start() / 3000.0)


def _reference_minus_y(view: View) -> Array:
    """Where the yaw slews have turned by a quarter since the interval's start."""
    out = np.zeros(view.references.t_s.size)
    for number, part in enumerate(view.stream.intervals):
        inside = view.references.interval == number
        turned = np.abs(np.cumsum(view.stream.rates[part, 2] * view.stream.duration_s[part]))
        angle = np.interp(view.references.t_s[inside], view.stream.t_s[part], turned)
        out[inside] = np.abs(angle - np.pi / 2) < np.pi / 8
    return out


def _reference_jump(view: View) -> Array:
    """From some time in the longest intervals on, until the interval's end."""
    length = view.stops_s - view.starts_s
    number = int(np.argsort(length)[-1 - int(3 * view.share)])
    at = view.starts_s[number] + length[number] * (0.25 + 0.5 * np.mod(7 * view.share, 1.0))
    return np.asarray((view.references.interval == number) & (view.references.t_s > at), dtype=float)


def _reference_roll_rate(view: View) -> Array:
    return np.asarray(np.interp(view.references.t_s, view.stream.t_s, view.stream.rates[:, 0] / ORBIT_RATE))


def _reference_third(view: View) -> Array:
    return np.asarray(np.sin(3 * 2 * np.pi * view.references.t_s / view.references.orbit_period_s + view.phase))


def _reference_settling(view: View) -> Array:
    return np.asarray(np.exp(-view.reference_since_start() / (400 + 800 * view.share)))


@dataclass(frozen=True)
class Unlisted:
    """An invention.

    Attributes
    ----------
    name, summary : for tables
    acts_on : "rates" (h in rad/s per unit) or "references" (h in rad per unit)
    shape : h at the samples (n,) or at the references (m,)
    axes : on which it may act
    """

    name: str
    summary: str
    acts_on: Literal["rates", "references"]
    shape: Callable[[View], Array]
    axes: tuple[str, ...] = ("x", "y", "z")


_ALL = (
    Unlisted("scale_cubic", "scale factor error in the cube of the rate", "rates", _scale_cubic, ("y", "z")),
    Unlisted("acceleration_squared", "bias with the square of the yaw acceleration", "rates", _acceleration_squared),
    Unlisted("rate_product", "product of the two other rates", "rates", _rate_product),
    Unlisted("orbit_times_rate", "pitch rate picked up as the orbit position says", "rates", _orbit_times_rate, ("x", "z")),
    Unlisted("warm_up", "bias that decays from each interval's start", "rates", _warm_up),
    Unlisted("bias_twice_orbit", "bias at twice orbit rate", "rates", _bias_twice_orbit),
    Unlisted("bias_odd_period", "bias at 1.37 times orbit rate", "rates", _bias_odd_period),
    Unlisted("bias_eclipse", "bias between two levels, 35 % of each orbit", "rates", _eclipse),
    Unlisted("bias_daily", "bias with a period of a day", "rates", _bias_daily),
    Unlisted("scale_drift", "misalignment that grows with mission time", "rates", _scale_drift),
    Unlisted("scale_orbital", "scale factor at orbit rate", "rates", _scale_orbital, ("y",)),
    Unlisted("relaxing_misalignment", "misalignment that fades after each slew", "rates", _relaxing_misalignment, ("x", "y")),
    Unlisted("slew_heating", "bias that decays after each slew", "rates", _slew_heating),
    Unlisted("rate_markov", "Gauss-Markov rate error of 300 s", "rates", _markov),
    Unlisted("hysteresis", "bias with the sign of the last slew", "rates", _hysteresis),
    Unlisted("telegraph", "bias that jumps between two levels at random", "rates", _telegraph),
    Unlisted("chirp", "bias oscillation that gets faster in each interval", "rates", _chirp),
    Unlisted("lagging_crosstalk", "another axis shows up with a lag", "rates", _lagging_crosstalk),
    Unlisted("reference_ramp", "reference drifts within each interval", "references", _reference_ramp),
    Unlisted("reference_minus_y", "reference offset in -y forward", "references", _reference_minus_y),
    Unlisted("reference_jump", "reference jumps in the middle of an interval", "references", _reference_jump),
    Unlisted("reference_roll_rate", "reference error that follows the roll rate", "references", _reference_roll_rate),
    Unlisted("reference_third", "reference error at three times orbit rate", "references", _reference_third),
    Unlisted("reference_settling", "reference settles from each interval's start", "references", _reference_settling),
)
UNLISTED: Mapping[str, Unlisted] = {one.name: one for one in _ALL}
