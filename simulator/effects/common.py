"""Small pieces that several effects share."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from gyrocal.errors import InputError
from gyrocal.jit_cache import compile_cached
from simulator.arrays import Array
from simulator.effects.base import (
    AXIS_NAMES,
    Parameter,
    Parameters,
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
    """A parameter that is a number."""
    return float(parameters[name])


def index(axis: str | None) -> int:
    """0, 1 or 2 of an axis that must be given."""
    if axis not in AXIS_NAMES:
        raise InputError(f"axis {axis}: must be one of x, y, z")
    return AXIS_NAMES.index(axis)


def select_axes(axis: str | None) -> list[int]:
    """Indices of an optional axis: all if it is not given."""
    return [0, 1, 2] if axis is None else [index(axis)]


def put_on_axis(values: Array, axis: str | None) -> Array:
    """Time functions (n,) or (n, k) put on one axis, (n, 3, k)."""
    values = values.reshape(len(values), -1)
    out = np.zeros((len(values), 3, values.shape[1]))
    out[:, index(axis)] = values
    return out


def compute_share_after(stream: Stream, time_s: float) -> Array:
    """Share of each sample that is after a time, (n,): the mean of H(t − time_s) over the sample."""
    return np.asarray(np.clip((stream.t_s + 0.5 * stream.duration_s - time_s) / stream.duration_s, 0.0, 1.0))


def harmonic(t_s: Array, period_s: float) -> Array:
    """sin and cos of 2π t/period, (n, 2); with amplitudes (size cos φ, size sin φ) they add up to size sin(2π t/period + φ)."""
    angle = 2 * np.pi / period_s * t_s
    return np.column_stack([np.sin(angle), np.cos(angle)])


def phase_amplitudes(setting: Setting) -> Array:
    """(size cos φ, size sin φ)."""
    phase = np.deg2rad(number(setting.parameters, "phase_deg"))
    return setting.size * np.array([np.cos(phase), np.sin(phase)])


def convert_phase_amplitudes(amplitudes: Array) -> tuple[float, dict[str, Value]]:
    """Size ≥ 0 and phase, the reverse of `phase_amplitudes`."""
    return float(np.hypot(*amplitudes)), {"phase_deg": float(np.rad2deg(np.arctan2(amplitudes[1], amplitudes[0])))}


def list_runs(stream: Stream) -> list[slice]:
    """Stretches of samples that follow one another without a hole, none longer than an interval."""
    end = stream.t_s + 0.5 * stream.duration_s
    begin = stream.t_s - 0.5 * stream.duration_s
    out = []
    for part in stream.intervals:
        holes = np.flatnonzero(begin[part][1:] - end[part][:-1] > PAUSE_SAMPLES * stream.duration_s[part][:-1]) + 1
        edges = [part.start, *(part.start + holes), part.stop]
        out += [slice(int(a), int(b)) for a, b in pairwise(edges) if b > a]
    return out


def gauss_markov(rng: np.random.Generator, t_s: Array, time_constant_s: float) -> Array:
    """First-order Gauss–Markov process of unit variance at increasing times, exact whatever their spacing; (n,)."""
    if len(t_s) == 0:
        return np.empty(0)
    draws = rng.standard_normal(len(t_s))
    lag = np.diff(t_s) / time_constant_s
    drive = np.append(draws[0], draws[1:] * np.sqrt(-np.expm1(-2 * lag)))
    return recursion(np.append(0.0, np.exp(-lag)), drive)


def markov(t_s: Array, time_constant_s: float) -> Array:
    """Covariance of a first-order Gauss–Markov process of unit variance at some times, (c,) → (c, c)."""
    # In one piece of memory: there may be thousands of times.
    lag = np.subtract.outer(t_s, t_s)
    np.abs(lag, out=lag)
    lag /= -time_constant_s
    return np.asarray(np.exp(lag, out=lag))


def measure_reference_arc(around: Surroundings) -> tuple[float, float]:
    """Median spacing of the references, s, infinite without a series; and the longest interval that they cover, s."""
    references = around.references
    inside = (np.diff(references.interval) == 0) & (np.diff(references.t_s) > 0)
    if not inside.any():
        return float("inf"), 0.0
    longest = max(float(np.ptp(references.t_s[references.interval == k])) for k in np.unique(references.interval))
    return float(np.median(np.diff(references.t_s)[inside])), longest


def list_time_constants(low: float, high: float, ratio: float, most: int = 100) -> tuple[Trial, ...]:
    """Trials of ``time_constant_s`` from low to high, s, a ratio apart or more and even in their logarithm."""
    if not high > low:
        return ()
    count = int(np.ceil(np.log(high / low) / np.log(ratio))) + 1
    constants = np.geomspace(low, high, int(np.clip(count, 2, most)))
    return tuple(Trial({"time_constant_s": float(constant)}, 1 / constants.size) for constant in constants)


def build_factor(axis: str | None, size: float) -> Array:
    """A factor on the noise of one axis, or of all, (3,)."""
    factor = np.ones(3)
    factor[select_axes(axis)] = size
    return factor


def no_gyro_noise(around: Surroundings) -> str | None:
    """Reason why an effect that is detected against the stated noise cannot act; None if it can."""
    return None if around.arw > 0 else "the recording states no gyro noise"


def no_orbit(around: Surroundings) -> str | None:
    """Reason why an effect at orbit rate cannot act; None if it can."""
    return None if np.isfinite(around.stream.orbit_period_s) else "the recording does not state its orbit's period"


def round_to_multiples(samples: Array, axis: str | None, step: float, rounded: Callable[[Array], Array]) -> Array:
    """Samples (n, 3) with one axis, or all, at whole multiples of a step."""
    out = samples.copy()
    axes = select_axes(axis)
    out[:, axes] = rounded(samples[:, axes] / step) * step
    return out


@compile_cached
def recursion(decay: Array, drive: Array) -> Array:
    """x_k = decay_k x_{k−1} + drive_k from x_{−1} = 0, (n,)."""
    out = np.empty_like(drive)
    value = 0.0
    for k in range(len(drive)):
        value = decay[k] * value + drive[k]
        out[k] = value
    return out
