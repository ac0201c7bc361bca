"""Small pieces that several effects share."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from gyrocal.arrays import Array
from gyrocal.errors import InputError
from gyrocal.jit_cache import compile_cached
from simulator.effects.base import (
    AXIS_NAMES,
    Effect,
    Parameter,
    Parameters,
    ProcessTimes,
    Setting,
    Stream,
    Surroundings,
    Trial,
    Value,
)

DEG = float(np.deg2rad(1.0))  # rad
DEG_H = DEG / 3600  # rad/s
RAD_PER_ARCSEC = DEG / 3600  # rad
PPM = 1e-6
DAY = 86400.0
HOUR = 3600.0
PAUSE_SAMPLES = 0.5  # of a sample: a longer pause between two samples separates them


TIME_PARAMETER = Parameter("time_s", "s", None, "time of the step since the epoch", -1e12, 1e12)
TOWARD = Parameter("toward", "", None, "body axis whose rate is picked up", choices=AXIS_NAMES, tried=AXIS_NAMES)
PHASE = Parameter("phase_deg", "deg", 0.0, "phase at the epoch", -360.0, 360.0)


def number(parameters: Parameters, name: str) -> float:
    """Read a parameter that is a number."""
    return float(parameters[name])


def index(axis: str | None) -> int:
    """Return 0, 1 or 2 of an axis that must be given."""
    if axis not in AXIS_NAMES:
        raise InputError(f"axis {axis}: must be one of x, y, z")
    return AXIS_NAMES.index(axis)


def select_axes(axis: str | None) -> list[int]:
    """Select the indices of an optional axis: all if it is not given."""
    return [0, 1, 2] if axis is None else [index(axis)]


def put_on_axis(values: Array, axis: str | None) -> Array:
    """Put time functions (n,) or (n, k) on one axis, (n, 3, k)."""
    values = values.reshape(len(values), -1)
    out = np.zeros((len(values), 3, values.shape[1]))
    out[:, index(axis)] = values
    return out


def compute_share_after(stream: Stream, parameters: Parameters) -> Array:
    """Compute the share of each sample that is after time_s, (n,): the mean of H(t − time_s) over the sample."""
    after = stream.t_s + 0.5 * stream.duration_s - number(parameters, "time_s")
    return np.asarray(np.clip(after / stream.duration_s, 0.0, 1.0))


def harmonic(t_s: Array, period_s: float) -> Array:
    """Compute sin and cos of 2π t/period, (n, 2); amplitudes (size cos φ, size sin φ) make size sin(2π t/period + φ)."""
    angle = 2 * np.pi / period_s * t_s
    return np.column_stack([np.sin(angle), np.cos(angle)])


def phase_amplitudes(setting: Setting) -> Array:
    """Compute (size cos φ, size sin φ)."""
    phase = np.deg2rad(number(setting.parameters, "phase_deg"))
    return setting.size * np.array([np.cos(phase), np.sin(phase)])


def convert_phase_amplitudes(amplitudes: Array) -> tuple[float, dict[str, Value]]:
    """Convert amplitudes to size ≥ 0 and phase, the reverse of `phase_amplitudes`."""
    return float(np.hypot(*amplitudes)), {"phase_deg": float(np.rad2deg(np.arctan2(amplitudes[1], amplitudes[0])))}


def list_runs(t_s: Array, duration_s: Array, intervals: Sequence[slice]) -> list[slice]:
    """List stretches of samples without a hole, none longer than an interval; arguments as of a `Stream`."""
    begin, end = t_s - 0.5 * duration_s, t_s + 0.5 * duration_s
    out = []
    for part in intervals:
        holes = np.flatnonzero(begin[part][1:] - end[part][:-1] > PAUSE_SAMPLES * duration_s[part][:-1]) + 1
        edges = [part.start, *(part.start + holes), part.stop]
        out += [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]
    return out


def gauss_markov(rng: np.random.Generator, t_s: Array, time_constant_s: float) -> Array:
    """Draw a first-order Gauss–Markov process of unit variance at increasing times, exact whatever their spacing; (n,)."""
    if len(t_s) == 0:
        return np.empty(0)
    draws = rng.standard_normal(len(t_s))
    lag = np.diff(t_s) / time_constant_s
    drive = np.append(draws[0], draws[1:] * np.sqrt(-np.expm1(-2 * lag)))
    return recursion(np.append(0.0, np.exp(-lag)), drive)


def markov(t_s: Array, time_constant_s: float) -> Array:
    """Compute the covariance of a first-order Gauss–Markov process of unit variance at some times, (c,) → (c, c)."""
    # In one piece of memory: there may be thousands of times.
    lag = np.subtract.outer(t_s, t_s)
    np.abs(lag, out=lag)
    lag /= -time_constant_s
    return np.asarray(np.exp(lag, out=lag))


def measure_reference_arc(around: Surroundings) -> tuple[float, float]:
    """Measure the median spacing of references, s, infinite without a series, and the longest interval they cover, s."""
    references = around.references
    is_step = (np.diff(references.interval) == 0) & (np.diff(references.t_s) > 0)
    if not is_step.any():
        return float("inf"), 0.0
    longest = max(float(np.ptp(references.t_s[references.interval == k])) for k in np.unique(references.interval))
    return float(np.median(np.diff(references.t_s)[is_step])), longest


def no_gyro_noise(around: Surroundings) -> str | None:
    """Give the reason why an effect that is detected against the stated noise cannot act; None if it can."""
    return None if around.arw > 0 else "the recording states no gyro noise"


def no_orbit(around: Surroundings) -> str | None:
    """Give the reason why an effect at orbit rate cannot act; None if it can."""
    return None if np.isfinite(around.stream.orbit_period_s) else "the recording does not state its orbit's period"


@compile_cached
def recursion(decay: Array, drive: Array) -> Array:
    """Compute x_k = decay_k x_{k−1} + drive_k from x_{−1} = 0, (n,)."""
    out = np.empty_like(drive)
    value = 0.0
    for k in range(len(drive)):
        value = decay[k] * value + drive[k]
        out[k] = value
    return out


@dataclass(frozen=True)
class NoiseFactor(Effect):
    """White noise of an axis, or of all, times the size; the same draws are scaled, so that all else stays as it was."""

    def noise_factor(self, setting: Setting) -> Array:
        """Return the size on its axes, 1 elsewhere."""
        factor = np.ones(3)
        factor[select_axes(setting.axis)] = setting.size
        return factor


class TriedConstants(NamedTuple):
    """Time constants that a diagnosis tries, even in their logarithm."""

    spacings: float  # of the references, the shortest
    intervals: float  # of the longest interval with references, the longest
    ratio: float  # of one to the next, or more where there would be too many of them
    most: int = 100
    least_arc: float = 0.0  # spacings of the references that the longest interval must be longer than


@dataclass(frozen=True)
class GaussMarkov(Effect):
    """A first-order Gauss–Markov process on one axis."""

    parameters: tuple[Parameter, ...] = (Parameter("time_constant_s", "s", 600.0, "time constant", 1e-3, 1e9),)
    scale: float = field(kw_only=True)  # of the size, in rad/s or rad
    tried: TriedConstants = field(kw_only=True)

    def draw(self, rng: np.random.Generator, t_s: Array, setting: Setting) -> Array:
        """Draw the process at some times (n,), in true time over gaps too; (n, 3)."""
        process = gauss_markov(rng, t_s, number(setting.parameters, "time_constant_s"))
        return put_on_axis(setting.size * self.scale * process, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """Compute exp(−|Δt|/τ)."""
        return np.asarray(self.scale**2 * markov(at.t_s, number(parameters, "time_constant_s")))

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """List time constants from the shortest that the spacing of references shows to the longest that an interval does."""
        spacing, arc = measure_reference_arc(around)
        low, high = self.tried.spacings * spacing, self.tried.intervals * arc
        if not (high > low and arc > self.tried.least_arc * spacing):
            return ()
        count = int(np.ceil(np.log(high / low) / np.log(self.tried.ratio))) + 1
        constants = np.geomspace(low, high, int(np.clip(count, 2, self.tried.most)))
        return tuple(Trial({"time_constant_s": float(constant)}, 1 / constants.size) for constant in constants)

    def missing(self, around: Surroundings) -> str | None:
        """Require references that follow one another."""
        return None if self.trials(around) else "it needs a series of references"


@dataclass(frozen=True)
class DirectedEffect(Effect):
    """An effect of several angles: its size is their norm, its parameters say the direction and may have any length."""

    @property
    def directions(self) -> tuple[Parameter, ...]:
        """The parameters that are angles; all but words."""
        return tuple(parameter for parameter in self.parameters if not parameter.choices)

    def amplitudes(self, setting: Setting) -> Array:
        """Return the angles, in the effect's unit."""
        direction = np.array([float(setting.parameters[parameter.name]) for parameter in self.directions])
        length = np.linalg.norm(direction)
        return np.asarray(setting.size * direction / length) if length > 0 else np.zeros(direction.size)

    def from_amplitudes(self, amplitudes: Array) -> tuple[float, dict[str, Value]]:
        """Return the norm, and the angles."""
        named = {parameter.name: float(value) for parameter, value in zip(self.directions, amplitudes, strict=True)}
        return float(np.linalg.norm(amplitudes)), dict(named)

    def completed(self, setting: Setting) -> Setting:
        """Complete a setting: replace the direction by the angles."""
        size, angles = self.from_amplitudes(self.amplitudes(setting))
        if size == 0:
            raise InputError(f"{setting.label()}: {', '.join(angles)} are all zero, and it would do nothing; one must not be")
        others = {name: value for name, value in setting.parameters.items() if name not in angles}
        return replace(setting, size=size, parameters={**others, **angles})
