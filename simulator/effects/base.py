"""Definition of an effect: its place in the measuring chain, its numbers and units, and its action there.

An effect is something a real gyro or attitude sensor does and the baseline simulator M0 (constant G and b, white noise on
rates and references) does not. It owns itself: everything that depends on which effect it is, is in its class. It acts at one
stage of the chain (`STAGES`), by the method which that stage calls, and says how a diagnosis may see it:

- **columns** (`columns`, `reference_columns`): a sum of known time functions times amplitudes, so that it is linear in its
  size like the calibration parameters themselves; nonlinear parameters such as a time constant are tried (`trials`);
- **covariance** (`covariance`): a random process, known by its statistics;
- **samples** (`symptom`, `detect`): a change of the samples themselves, seen in their statistics (clipping, rounding, repeats).

**Sign**: a positive size makes the gyro read high, raw shown = raw + size · h. A reference error e turns the reference
attitude to exp([e×]) A. Units are those of `Effect.unit`; arrays are in radians, radians per second and seconds.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrocal.arrays import Array as Array
from gyrocal.arrays import Mask

if TYPE_CHECKING:
    from simulator.sensors.suite import SensorSuite

Value = float | str
Parameters = Mapping[str, Value]

AXIS_NAMES = ("x", "y", "z")


class Stage(NamedTuple):
    """A stage of the measuring chain."""

    name: str
    calls: str  # the method of an effect


STAGES = (
    Stage("rate", "columns"),  # a deterministic error is added to the noise-free rate: columns times amplitudes
    Stage("random_rate", "wander"),  # a random error is added to the noise-free rate, such as a bias that wanders
    Stage("filter", "retimed"),  # the gyro's output follows its input late, as behind a low-pass filter
    Stage("clock", "retimed"),  # the clock of the samples' tags is not that of the references
    Stage("threshold", "apply"),  # the gyro does not react to some rates; its white noise comes after that
    Stage("white_noise", "noise_factor"),  # white noise as stated is added, times the factors of this stage's effects
    Stage("pickup", "apply"),  # the gyro picks up more than the rate of the body, such as a vibration
    Stage("outliers", "apply"),  # single samples are falsified
    Stage("range", "apply"),  # rates beyond what the gyro can show are cut off
    Stage("resolution", "apply"),  # samples are rounded or cut to a step
    Stage("telemetry", "apply"),  # samples are lost, delayed or repeated on their way
    Stage("reference", "reference_columns"),  # a deterministic error is added to the references: columns times amplitudes
    Stage("random_reference", "reference_wander"),  # a random error that is not white is added to the references
    Stage("reference_noise", "noise_factor"),  # white reference noise as stated is added, times the factors of this stage
    Stage("reference_telemetry", "replace_references"),  # references are repeated or falsified on their way
    Stage("sensor", "fitted"),  # the sun and Earth sensors differ from their nominal models
)
STAGE_NAMES = tuple(stage.name for stage in STAGES)
ON_REFERENCES = ("reference", "random_reference", "reference_noise", "reference_telemetry")

SYMPTOMS = (
    "white_noise_level",  # white noise of the samples other than stated
    "readout_noise",  # noise of the samples whose spectrum rises as f²
    "lattice",  # readings are multiples of a step
    "zero_samples",  # readings that are exactly zero more often than noise allows
    "plateau",  # the largest readings are all the same
    "outliers",  # single samples far off
    "repeats",  # samples that repeat the one before
    "filled_samples",  # samples that repeat a value which was not measured
    "reference_noise_level",  # white noise of the references other than stated
)


# ---- inputs of an effect ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Stream:
    """The gyro samples as an effect on rates sees them."""

    t_s: Array  # (n,) middle of each sample, s since the epoch
    duration_s: Array  # (n,)
    rates: Array  # (n, 3) body rates, rad/s: the true ones in the simulator, the best estimate in a diagnosis
    raw: Array  # (n, 3) noise-free raw rates G⁻¹(ω − b), rad/s
    intervals: tuple[slice, ...]  # the samples of each interval
    orbit_period_s: float  # NaN if unknown
    span_s: tuple[float, float]  # first start and last stop of the intervals
    housekeeping: Mapping[str, Array] = field(default_factory=dict)  # named columns at t_s, (n,) each


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


@dataclass(frozen=True)
class Surroundings:
    """Samples and references of a recording, or of a maneuver plan, on which an effect acts."""

    stream: Stream  # the gyro samples; noise-free, or the best estimate of that
    references: References  # the reference attitudes
    arw: float  # stated angle random walk, rad/√s
    sample_s: float  # length of a sample, s
    reference_sigma: Array  # (m, 3) stated sigma of the references, rad
    reference_axes: Array | None = None  # (m, 3, 3) `Attitudes.build_error_axes`
    # (m, 3) references minus the attitudes that the gyro propagates from the first of each interval, inertial axes, rad
    residuals: Array | None = None


@dataclass(frozen=True)
class ProcessTimes:
    """Times at which the covariance of a random process is wanted."""

    t_s: Array  # (c,) s since the epoch
    run_s: Array  # (c,) sampled time up to then, the gaps between intervals left out, s
    interval: NDArray[np.intp]  # (c,) index of the interval


@dataclass(frozen=True)
class SampleView:
    """Gyro samples as recorded, for effects that bring a test of their own."""

    t_s: Array  # (n,) middle of each sample, s since the epoch
    sample_s: float  # length of a sample, s
    rates: Array  # (n, 3) raw rates as recorded, rad/s
    sigma: Array  # (3,) white noise of a sample, rad/s
    inside: Mask  # (n,) bool, whether a sample lies inside an interval
    intervals: tuple[slice, ...]  # the samples of each interval
    # (n, 3) raw rates without noise, from the references or by smoothing, rad/s; NaN where they are not known
    motion: Array


@dataclass(frozen=True)
class Detection:
    """Result of an effect's own test of the samples."""

    effect: str
    axis: str | None
    size: float  # in its unit, as sigma
    unit: str  # of the size
    sigma: float
    parameters: Parameters  # its other numbers, as far as they are known
    log_odds: float  # log of the probability of the samples with the effect over that without
    p_value: float  # of the test if the effect is absent
    text: str  # what was seen, for people


# ---- effects and settings ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """One effect with its numbers; `simulator.effects.setting` makes a validated one."""

    effect: str  # name in the registry
    axis: str | None  # "x", "y", "z", or None where the effect has none or acts on all
    size: float  # in the effect's unit
    parameters: Parameters = field(default_factory=dict)  # the effect's other numbers by name

    def label(self) -> str:
        """Format effect and axis, e.g. "bias_drift:z" or "time_offset"."""
        return self.effect if self.axis is None else f"{self.effect}:{self.axis}"


@dataclass(frozen=True)
class Parameter:
    """A number or choice of an effect beside its size."""

    name: str  # with its unit at the end, e.g. "time_s"
    unit: str  # for tables
    default: Value | None  # None if it must be given
    summary: str  # what it is, in a few words
    lower: float = -np.inf  # inclusive bounds of a number
    upper: float = np.inf
    choices: tuple[str, ...] = ()  # the words allowed, or () for a number; ("*",) allows any word
    tried: tuple[Value, ...] = ()  # values that a diagnosis tries, equally probable


@dataclass(frozen=True)
class Trial:
    """One set of an effect's parameters that a diagnosis tries, and its prior weight among them."""

    parameters: Parameters = field(default_factory=dict)
    weight: float = 1.0


@dataclass(frozen=True)
class Effect:
    """One effect; subclasses give the method that their stage calls, and what a diagnosis needs."""

    name: str
    summary: str
    unit: str  # of the size, for people
    stage: str  # where in the measuring chain it acts, one of `STAGES`
    prior: tuple[float, float]  # plausible range of the absolute size, log-uniform
    bounds: tuple[float, float] = (-1e9, 1e9)  # of a size that can be simulated, inclusive
    axes: tuple[str, ...] = AXIS_NAMES  # or () if it has none
    axis_optional: bool = False  # whether no axis means all of them
    parameters: tuple[Parameter, ...] = ()  # beside the size
    meaning: str = ""  # a sentence for the report of a diagnosis; the summary by default
    says: str = ""  # description of the effect as the first words of a sentence, see `sentence`
    ways: tuple[str, ...] = ()  # what {way} in it stands for at a positive and at a negative size
    sign: Literal["any", "positive"] = "any"  # "positive" if a negative size means nothing, or another effect
    weight: float = 1.0  # prior probability beside that of the other effects, which have 1
    switched: bool = False  # whether its column is switched on at the parameter time_s, whose values a diagnosis chooses
    scanned: bool = False  # whether its columns are a sine's of the parameter period_s, which a diagnosis scans the data for
    symptom: str | None = None  # one of `SYMPTOMS`, the statistic of the samples that shows it
    requirement: Callable[[Surroundings], str | None] | None = None  # why it cannot act on a recording; None if it can

    # ---- what it is ------------------------------------------------------------------------------------------------------

    def implements(self, method: str) -> bool:
        """Tell whether its class gives a method that the base class leaves open."""
        return getattr(type(self), method, None) not in (None, getattr(Effect, method, None))

    @property
    def has_columns(self) -> bool:
        """Whether it is a sum of columns, on the rates or on the references."""
        return self.implements("columns") or self.implements("reference_columns")

    @property
    def is_process(self) -> bool:
        """Whether it is a random process, known by its covariance."""
        return self.implements("covariance")

    @property
    def is_nameable(self) -> bool:
        """Whether a diagnosis may name it as a cause; others can only be simulated."""
        tested = self.symptom is not None or self.implements("detect")
        return self.has_columns or self.is_process or tested or self.stage == "sensor"

    @property
    def on_references(self) -> bool:
        """Whether it acts on the reference attitudes."""
        return self.stage in ON_REFERENCES

    @property
    def in_samples(self) -> bool:
        """Whether it changes the samples themselves or the white noise, and shows in their statistics."""
        return self.implements("apply") or self.implements("noise_factor")

    def sentence(self, axis: str | None, value: float, size: str) -> str:
        """Describe the effect by a clause in plain words, without a capital or a full stop.

        Parameters
        ----------
        axis : of the body, or None for all
        value : the size in its unit; its sign says which way
        size : the same without its sign as it is to be shown, with the unit behind the number
        """
        gyro = f"the {axis} gyro" if axis else "every gyro"
        words = {"gyro": gyro, "whose": f"{gyro}'s", "axis": axis or "every axis", "size": size, "number": size.split(" ")[0]}
        if self.ways:
            words["way"] = self.ways[value < 0]
        return self.says.format(**words) if self.says else f"{self.summary} ({size}{f', axis {axis}' if axis else ''})"

    # ---- what it does, by stage ------------------------------------------------------------------------------------------

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """Return the change of the raw reading per unit of each linear amplitude, (n, 3, k) rad/s."""
        raise NotImplementedError(f"{self.name} has no columns on the rates")

    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        """Return the error angle e of the references per unit of each linear amplitude, (m, 3, k) rad."""
        raise NotImplementedError(f"{self.name} has no columns on the references")

    def amplitudes(self, setting: Setting) -> Array:
        """Return the linear amplitudes of a setting, (k,) in the effect's unit."""
        return np.array([setting.size])

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Convert amplitudes to the size and the parameters that they hold."""
        return float(amplitudes[0]), {}

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """Draw the random error of the raw rates, (n, 3) rad/s."""
        raise NotImplementedError(f"{self.name} is no random process on the rates")

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Return noise-free raw rates with the fault in their timing, (n, 3) rad/s."""
        raise NotImplementedError(f"{self.name} does not act on timing")

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Change raw samples (n, 3), rad/s, to those that are put out."""
        raise NotImplementedError(f"{self.name} does not act on samples")

    def noise_factor(self, setting: Setting) -> Array:
        """Return the factor of each axis's white noise, (3,)."""
        raise NotImplementedError(f"{self.name} is no factor on white noise")

    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        """Draw the random error e of the references, (m, 3) rad."""
        raise NotImplementedError(f"{self.name} is no random process on the references")

    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        """Repeat or falsify some of the recorded reference attitudes (m, 4); `references` are the true ones."""
        raise NotImplementedError(f"{self.name} does not falsify references")

    def fitted(self, suite: "SensorSuite", setting: Setting) -> "SensorSuite":
        """Return the sun and Earth sensors with the effect."""
        raise NotImplementedError(f"{self.name} does not act on the sensors")

    # ---- how a diagnosis tries it ----------------------------------------------------------------------------------------

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """Compute the covariance (c, c) of a process on one axis per unit size², (rad/s)² on rates, rad² on references."""
        raise NotImplementedError(f"{self.name} is no random process")

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """List sets of parameters to try, with weights that add up to one, without time_s and those in the amplitudes.

        By default all combinations of the values that its parameters give as tried.
        """
        tried = {parameter.name: parameter.tried for parameter in self.parameters if parameter.tried}
        sets = list(product(*tried.values()))
        return tuple(Trial(dict(zip(tried, values, strict=True)), 1 / len(sets)) for values in sets)

    def missing(self, around: Surroundings) -> str | None:
        """Give the reason why the effect cannot act on, or be seen in, a recording; None if it can."""
        return self.requirement(around) if self.requirement else None

    def detect(self, view: SampleView) -> Sequence[Detection]:
        """Test the samples by the effect's own test; for effects that no `symptom` shows."""
        return ()

    def completed(self, setting: Setting) -> Setting:
        """Complete a validated setting to the form in which it acts; an `InputError` if it would do nothing."""
        return setting
