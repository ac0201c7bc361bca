"""What an effect is: its name, numbers and units, and what it does to rates, samples or references.

An effect is something a real gyro or attitude sensor does and the baseline simulator M0 (constant G and b, white noise on
rates and references) does not. Each says it in the form its kind needs:

- **columns**: a sum of known time functions times amplitudes, so that it is linear in its size like the calibration
  parameters themselves; nonlinear parameters such as the time of a step are held;
- **covariance**: a random process, known by its statistics;
- **stream**: a change of the samples themselves, seen in them directly (clipping, rounding, repeats).

**Sign**: a positive size makes the gyro read high, raw shown = raw + size · h. A reference error e turns the reference
attitude to exp([e×]) A. Units are those of `Effect.unit`; arrays are in radians, radians per second and seconds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Value = float | str
AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Setting:
    """One effect with its numbers; `simulator.effects.setting` makes a validated one.

    Attributes
    ----------
    effect : name in the registry
    axis : "x", "y", "z", or None where the effect has none or acts on all
    size : in the effect's unit
    parameters : the effect's other numbers by name
    """

    effect: str
    axis: str | None
    size: float
    parameters: Mapping[str, Value] = field(default_factory=dict)

    def label(self) -> str:
        """Effect and axis, e.g. "bias_drift:z" or "time_offset"."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"


@dataclass(frozen=True)
class Parameter:
    """A number or choice of an effect beside its size.

    Attributes
    ----------
    name : with its unit at the end, e.g. "time_s"
    unit : for tables
    default : None if it must be given
    summary : what it is, in a few words
    lower, upper : inclusive bounds of a number
    choices : the words allowed, or () for a number; ("*",) allows any word
    """

    name: str
    unit: str
    default: Value | None
    summary: str
    lower: float = -np.inf
    upper: float = np.inf
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Stream:
    """The gyro samples as an effect on rates sees them.

    Attributes
    ----------
    t_s : (n,) middle of each sample, s since the epoch
    duration_s : (n,)
    rates : (n, 3) body rates, rad/s: the true ones in the simulator, the best estimate in a diagnosis
    raw : (n, 3) noise-free raw rates G⁻¹(ω − b), rad/s
    intervals : the samples of each interval
    orbit_period_s : NaN if unknown
    span_s : first start and last stop of the intervals
    housekeeping : named columns at t_s, (n,) each
    """

    t_s: Array
    duration_s: Array
    rates: Array
    raw: Array
    intervals: tuple[slice, ...]
    orbit_period_s: float
    span_s: tuple[float, float]
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
    """

    t_s: Array
    quaternions: Array
    interval: NDArray[np.intp]
    forward: NDArray[np.str_]
    orbit_period_s: float


@dataclass(frozen=True)
class Effect:
    """One effect; subclasses give the methods that its kind and place in the chain need.

    Attributes
    ----------
    name, summary, unit : for people; the unit is that of the size
    acts_on : "rates" (noise-free), "timing" (of the noise-free rates), "noise" (random errors of the rates), "samples"
        (what is put out), "references", "sensors" (`simulator.effects.sensor`)
    kind : how a diagnosis sees it: linear columns, only a covariance, or the samples themselves
    prior : plausible range of the absolute size, log-uniform
    bounds : of a size that can be simulated, inclusive
    axes : ("x", "y", "z"), or () if it has none
    axis_optional : no axis means all of them
    parameters : beside the size
    housekeeping : how the name of the column it needs ends
    """

    name: str
    summary: str
    unit: str
    acts_on: Literal["rates", "timing", "samples", "noise", "references", "sensors"]
    kind: Literal["columns", "covariance", "stream"]
    prior: tuple[float, float]
    bounds: tuple[float, float] = (-1e9, 1e9)
    axes: tuple[str, ...] = AXES
    axis_optional: bool = False
    parameters: tuple[Parameter, ...] = ()
    housekeeping: str | None = None

    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """What is added to the raw reading per unit of each linear amplitude, (n, 3, k) rad/s."""
        raise NotImplementedError(f"{self.name} has no columns on the rates")

    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """Error angle e of the references per unit of each linear amplitude, (m, 3, k) rad."""
        raise NotImplementedError(f"{self.name} has no columns on the references")

    def amplitudes(self, setting: Setting) -> Array:
        """The linear amplitudes of a setting, (k,) in the effect's unit."""
        return np.array([setting.size])

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Size, and the parameters that the amplitudes hold."""
        return float(amplitudes[0]), {}

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Noise-free raw rates with the fault in their timing, (n, 3) rad/s."""
        raise NotImplementedError(f"{self.name} does not act on timing")

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """Random error of the raw rates, (n, 3) rad/s."""
        raise NotImplementedError(f"{self.name} is no random process on the rates")

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Raw samples (n, 3), rad/s, as they are put out."""
        raise NotImplementedError(f"{self.name} does not act on samples")

    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        """Random error e of the references, (m, 3) rad."""
        raise NotImplementedError(f"{self.name} is no random process on the references")

    def noise_factor(self, setting: Setting) -> Array:
        """What the white noise of each axis is multiplied by, (3,)."""
        raise NotImplementedError(f"{self.name} is no factor on white noise")
