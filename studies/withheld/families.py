"""Effects outside the library: errors of gyros, clocks, samples and references, each a law with a sentence of physics.

A law gets the samples (`Samples`) or the references (`Sightings`) with three numbers drawn for a case, a phase, and a share and
a pace from 0 to 1, from which time constants and directions follow. It returns the error per unit of the size, about the axis
(n,) or about all axes (n, 3); a law of the stages that change samples or their timing returns the changed samples.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from scipy.signal import lfilter

from simulator.effects import Effect, Parameter, References, Setting, Stream, Surroundings
from simulator.effects.base import AXIS_NAMES, STAGES, Array, Value
from simulator.effects.common import DEG, DEG_H, PPM, gauss_markov, index, recursion
from simulator.effects.housekeeping_columns import TEMPERATURE_COLUMN
from simulator.truth.integration import accumulate
from simulator.truth.rotation import convert_to_matrix, separation

SIZES = {  # of a unit in rad, rad/s or s, and plausible sizes
    "deg/h": (DEG_H, (1e-7, 1e6)),
    "deg/s": (DEG, (1e-10, 1e2)),
    "deg": (DEG, (1e-7, 1e2)),
    "ppm": (PPM, (1e-3, 1e5)),
    "s": (1.0, (1e-8, 1e2)),
    "share": (1.0, (1e-5, 0.95)),
}
CALLS = {stage.name: stage.calls for stage in STAGES}  # method of an effect that each stage calls
TINY = 1e-30  # keeps a ratio of zeros finite
TURNING = 1e-3 * DEG  # rad/s; a body that nowhere turns faster does not turn
DENSE_RAD = 0.5  # turn between two references, up to which their difference is the rate

Rng = np.random.Generator | None
LAW_PARAMETERS = (
    Parameter("phase_deg", "deg", 0.0, "phase", -360.0, 360.0),
    Parameter("share", "", 0.5, "of one, as the law uses it", 0.0, 1.0),
    Parameter("pace", "", 0.5, "of one, how slow it is", 0.0, 1.0),
)


class LawNumbers:
    """Numbers of a law: axis k, phase (rad), share and pace from 0 to 1, and a generator, by default seeded by these."""

    def __init__(self, axis: str | None, parameters: Mapping[str, Value], rng: Rng = None):
        phase, self.share, self.pace = (float(parameters[parameter.name]) for parameter in LAW_PARAMETERS)
        seed = [int(1e6 * (phase + 360)), int(1e9 * self.share), int(1e9 * self.pace)]
        self.k, self.phase = seed[0] % 3 if axis is None else index(axis), float(np.deg2rad(phase))
        self.other_axis = (self.k + 1 + (self.share > 0.5)) % 3  # another axis
        self.rng = rng or np.random.default_rng(seed)
        self.length = 0.0  # of a median interval, s

    def scaled(self, low: float, high: float) -> float:
        """Scale the pace to a number between two, uniform in its logarithm."""
        return float(low * (high / low) ** self.pace)

    def between(self, low: float, high: float) -> float:
        """Scale the pace to a time between two shares of a median interval, s."""
        return self.length * self.scaled(low, high)

    def direction(self) -> Array:
        """Compute the unit vector (3,) that the numbers determine."""
        z = 2 * self.share - 1
        return np.array([*(np.sqrt(1 - z * z) * np.array([np.cos(self.phase), np.sin(self.phase)])), z])


class Samples(LawNumbers):
    """Samples for a law: times t (n,), s, body rates w (n, 3) and axis_rate (n,) about the axis, rad/s."""

    def __init__(self, axis: str | None, parameters: Mapping[str, Value], stream: Stream, rng: Rng = None):
        super().__init__(axis, parameters, rng)
        self.stream, self.t, self.w, self.axis_rate = stream, stream.t_s, stream.rates, stream.rates[:, self.k]
        self.sample_s, self.fastest = float(stream.duration_s[0]), float(np.abs(self.w).max())
        self.length = max(float(np.median([p.stop - p.start for p in stream.intervals])) * self.sample_s, 50 * self.sample_s)
        self.since_start = self.each(lambda p: self.t[p] - self.t[p.start])  # of the interval, s
        self.elapsed = np.asarray((self.t - self.t[0]) / (self.t[-1] - self.t[0]))  # from 0 to 1

    def each(self, law: Callable[[slice], Array]) -> Array:
        """Join the values that a law gives for each interval by itself."""
        return np.concatenate([law(part) for part in self.stream.intervals])

    def cycle(self, low: float, high: float) -> Array:
        """Compute the phase (n,), rad, of a period between two shares of an interval."""
        return 2 * np.pi * self.t / self.between(low, high) + self.phase

    @property
    def temperature(self) -> Array:
        """(n,) of the gyro above its mean, K."""
        temperature_k = self.stream.housekeeping[TEMPERATURE_COLUMN]
        return np.asarray(temperature_k - temperature_k.mean())

    def smooth(self, values: Array, time_s: float) -> Array:
        """Filter values (n,) by a first-order low-pass, which starts settled in each interval."""
        a = float(np.exp(-self.sample_s / time_s))
        return self.each(lambda p: lfilter([1 - a], [1, -a], values[p], zi=[a * values[p.start]])[0])

    def replaced(self, values: Array, column: Array) -> Array:
        """Return samples (n, 3) with those of the axis replaced."""
        out = values.copy()
        out[:, self.k] = column
        return out


class Sightings(LawNumbers):
    """References for a law: times t (m,), s, attitude matrices body (m, 3, 3), and the first reference of each interval."""

    def __init__(self, axis: str | None, parameters: Mapping[str, Value], references: References, rng: Rng = None):
        super().__init__(axis, parameters, rng)
        self.references, self.t, self.body = references, references.t_s, convert_to_matrix(references.quaternions)
        begins = np.append(True, np.diff(references.interval) != 0)
        self.first = np.maximum.accumulate(np.where(begins, np.arange(len(self.t)), 0))
        self.since_start = np.asarray(self.t - self.t[self.first])
        self.length = float(max(np.median([np.ptp(self.t[self.first == k]) for k in np.unique(self.first)]), 1e-3))

    @property
    def rates(self) -> Array:
        """Body rate (m, 3) from each reference to the next, rad/s; the last of an interval has the rate before it."""
        q = self.references.quaternions
        turns = -separation(q[:-1], q[1:]) / np.diff(self.t)[:, None]
        rates = np.vstack([turns, turns[-1:]])
        last = np.flatnonzero(np.append(np.diff(self.first) != 0, True))
        rates[last] = rates[np.maximum(last - 1, 0)]
        return rates


Law = TypeVar("Law", bound=Callable[..., Array])


@dataclass(frozen=True)
class Family(Effect):
    """An unlisted effect, which acts by its law at its stage."""

    law: Callable[..., Array] = field(default=np.zeros, compare=False)
    needs: tuple[str, ...] = ()  # required of a recording: temperature, turns, dense (references that follow the rate)
    side: str = ""  # gyro, reference or time, where that is not the side of its stage

    def implements(self, method: str) -> bool:
        """Check whether its stage calls this method."""
        return method == CALLS[self.stage]

    def missing(self, around: Surroundings) -> str | None:
        """Name what a recording lacks."""
        stream, references = around.stream, around.references
        gaps = np.diff(references.t_s)[np.diff(references.interval) == 0]
        lacks = {
            "temperature": TEMPERATURE_COLUMN not in stream.housekeeping,
            "turns": np.abs(stream.rates).max() < TURNING,
            "dense": gaps.size == 0 or float(gaps.max() * np.linalg.norm(stream.rates, axis=1).max()) > DENSE_RAD,
        }
        return next((f"the recording has no {need}" for need in self.needs if lacks[need]), None)

    def columns(self, stream: Stream, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """Compute the rate error per unit of the size, (n, 3, 1) rad/s."""
        return self._put_on_axes(self.law(Samples(axis, parameters, stream)), axis)[:, :, None]

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """Draw a random rate error, (n, 3) rad/s."""
        samples = Samples(setting.axis, setting.parameters, stream, rng)
        return setting.size * self._put_on_axes(self.law(samples), setting.axis)

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Compute the noise-free rates with the fault in their timing, (n, 3) rad/s."""
        return self.law(Samples(setting.axis, setting.parameters, stream), raw, setting.size)

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Compute the samples that the faulty gyro puts out, (n, 3) rad/s."""
        return self.law(Samples(setting.axis, setting.parameters, stream, rng), samples, SIZES[self.unit][0] * setting.size)

    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """Compute the error of the references per unit of the size, (m, 3, 1) rad."""
        return self._put_on_axes(self.law(Sightings(axis, parameters, references)), axis)[:, :, None]

    def reference_wander(self, rng: np.random.Generator, references: References, setting: Setting) -> Array:
        """Draw a random error of the references, (m, 3) rad."""
        sightings = Sightings(setting.axis, setting.parameters, references, rng)
        return setting.size * self._put_on_axes(self.law(sightings), setting.axis)

    def _put_on_axes(self, values: Array, axis: str | None) -> Array:
        """Put values (n,) on the axis, or (n, 3) on all axes; returns (n, 3) rad or rad/s per unit of the size."""
        out = np.zeros((len(values), 3))
        out[:, slice(None) if values.ndim == 2 else index(axis)] = values
        return SIZES[self.unit][0] * out


FAMILIES: dict[str, Family] = {}


def declare(stage: str, unit: str, *needs: str, all_axes: bool = False, side: str = "") -> Callable[[Law], Law]:
    """Declare a law as a family: its name is the function's, its summary the first sentence of the docstring."""

    def add(law: Law) -> Law:
        FAMILIES[law.__name__] = Family(
            name=law.__name__,
            summary=" ".join((law.__doc__ or "").split()).partition(". ")[0],
            unit=unit,
            stage=stage,
            prior=SIZES[unit][1],
            axes=() if all_axes else AXIS_NAMES,
            parameters=LAW_PARAMETERS,
            sign="positive" if CALLS[stage] == "apply" else "any",
            law=law,
            needs=needs,
            side=side,
        )
        return law

    return add


# ---- gyro: errors of the rate ----------------------------------------------------------------------------------------------


@declare("rate", "deg/h")
def warm_up(samples: Samples) -> Array:
    """Bias relaxes after each switching on. The electronics come to their temperature (IEEE Std 1431)."""
    return np.exp(-samples.since_start / samples.between(0.03, 0.4))


@declare("rate", "deg/h")
def heater_duty(samples: Samples) -> Array:
    """Bias has two values, those of a heater on and off (IEEE Std 952, supply sensitivity)."""
    return (np.mod(samples.cycle(0.04, 0.5) / (2 * np.pi), 1.0) < 0.15 + 0.6 * samples.share).astype(float)


@declare("rate", "deg/h")
def register_ramp(samples: Samples) -> Array:
    """Bias is a saw tooth. An accumulator of the compensation overflows regularly (Savage, Strapdown Analytics)."""
    return np.mod(samples.cycle(0.1, 0.9) / (2 * np.pi), 1.0) - 0.5


@declare("rate", "deg/h", "temperature")
def shupe(samples: Samples) -> Array:
    """Bias follows the rate of change of the temperature (Shupe, Applied Optics 19, 1980)."""
    slow = samples.smooth(samples.temperature, max(60.0, samples.between(0.02, 0.05)))
    change = samples.each(lambda p: np.gradient(slow[p], samples.t[p]))
    return np.asarray(change / max(float(np.abs(change).max()), TINY))


@declare("rate", "deg/h", "turns")
def slew_heating(samples: Samples) -> Array:
    """Bias follows the recent turning. Torquers warm the sensor (IEEE Std 813, torquer heating)."""
    return samples.smooth(np.abs(samples.w[:, samples.other_axis]), samples.between(0.05, 0.5)) / samples.fastest


@declare("rate", "deg/h", "turns")
def mass_unbalance(samples: Samples) -> Array:
    """Bias follows gravity's component along an axis of the case (IEEE Std 528, g-sensitive drift)."""
    start = np.array([0.0, 0.0, 0.0, 1.0])
    attitude = samples.each(lambda p: convert_to_matrix(accumulate(start, samples.w[p] * samples.sample_s)[1:]))
    return np.asarray(attitude[:, samples.other_axis] @ samples.direction())


@declare("rate", "deg/h", "turns")
def pivot_friction(samples: Samples) -> Array:
    """Bias keeps the sign of the last fast turn. A gimbal sticks where it was turned to (IEEE Std 813)."""
    rates = samples.w[:, samples.other_axis]
    strong = np.abs(rates) > samples.fastest * (0.05 + 0.3 * samples.share)
    return np.where(strong.any(), np.sign(rates[np.maximum.accumulate(np.where(strong, np.arange(len(rates)), 0))]), 0.0)


@declare("rate", "s", "turns")
def cross_acceleration(samples: Samples) -> Array:
    """An axis reads the angular acceleration about another. A float lags behind its case (Titterton and Weston)."""
    return samples.each(lambda p: np.gradient(samples.w[p, samples.other_axis], samples.sample_s))


@declare("rate", "ppm", "turns")
def scale_ageing(samples: Samples) -> Array:
    """Scale factor drifts through the recording. Radiation darkens the fibre (Lefèvre, The Fiber-Optic Gyroscope)."""
    return samples.axis_rate * samples.elapsed ** (0.5 + 2 * samples.share)


@declare("rate", "ppm", "turns")
def range_switch(samples: Samples) -> Array:
    """Scale factor is another one above a rate. The amplifier switches its range (IEEE Std 1431)."""
    return np.where(np.abs(samples.axis_rate) > samples.fastest * (0.2 + 0.6 * samples.share), samples.axis_rate, 0.0)


@declare("rate", "deg/s", "turns")
def backscatter(samples: Samples) -> Array:
    """Error swings with the angle turned. Backscatter adds the beat's sine (Aronowitz, Ring Laser Gyro, 1999)."""
    turned = samples.each(lambda p: np.cumsum(samples.axis_rate[p]) * samples.sample_s)
    return np.sin(samples.scaled(0.7, 15.0) * turned + samples.phase)


@declare("random_rate", "deg/h")
def popcorn_noise(samples: Samples) -> Array:
    """Bias hops at random between two levels (Kirton and Uren, Advances in Physics 38, 1989)."""
    hops = samples.rng.random(len(samples.t)) < -0.5 * np.expm1(-2 * samples.sample_s / samples.between(0.02, 0.4))
    return (np.cumsum(hops) % 2).astype(float)


@declare("random_rate", "deg/h")
def stress_releases(samples: Samples) -> Array:
    """Bias jumps at random times by heavy-tailed amounts. Solder and glue crack (Titterton and Weston)."""
    released = samples.rng.random(len(samples.t)) < -np.expm1(-samples.sample_s / samples.between(0.15, 1.5))
    return np.cumsum(np.where(released, np.clip(samples.rng.standard_t(1.5, len(samples.t)), -10, 10), 0.0))


@declare("random_rate", "ppm", "turns", all_axes=True)
def foam_mount(samples: Samples) -> Array:
    """Misalignment wanders at random and returns. Foam lets the gyro tilt (Titterton and Weston, mounts)."""
    tilt = [gauss_markov(samples.rng, samples.t, samples.between(0.02, 0.5)) for _ in range(3)]
    return np.cross(samples.w, np.stack(tilt, axis=1))


# ---- gyro: timing and samples ----------------------------------------------------------------------------------------------


@declare("clock", "s", "turns", all_axes=True)
def clock_resets(samples: Samples, raw: Array, size: float) -> Array:
    """Tags drift and are set right again and again. The clock is synchronised at intervals (CCSDS 301.0)."""
    late = samples.t - size * np.mod(samples.cycle(0.1, 0.6) / (2 * np.pi), 1.0)
    return samples.each(lambda p: np.stack([np.interp(late[p], samples.t[p], raw[p, axis]) for axis in range(3)], axis=1))


@declare("filter", "share", "turns")
def peaking(samples: Samples, raw: Array, size: float) -> Array:
    """Output overshoots changes of rate. A digital filter peaks before its cut-off (Savage, Strapdown Analytics)."""
    rate = raw[:, samples.k]
    return samples.replaced(raw, rate + size * (rate - samples.smooth(rate, samples.between(0.002, 0.02))))


@declare("threshold", "deg/s", "turns")
def lock_in(samples: Samples, values: Array, size: float) -> Array:
    """Rates below a limit lock, and above it read sign · √(rate² − limit²) (Aronowitz, Ring Laser Gyro, 1999)."""
    rate = values[:, samples.k]
    return samples.replaced(values, np.sign(rate) * np.sqrt(np.maximum(rate**2 - size**2, 0.0)))


@declare("pickup", "share", "turns")
def intensity_noise(samples: Samples, values: Array, size: float) -> Array:
    """Noise grows in proportion to the rate (Lefèvre, The Fiber-Optic Gyroscope, relative intensity noise)."""
    return samples.replaced(values, values[:, samples.k] + size * samples.axis_rate * samples.rng.standard_normal(len(values)))


@declare("telemetry", "share")
def smoothed_output(samples: Samples, values: Array, size: float) -> Array:
    """Each sample holds a part of the one before. The processor smooths (Savage, Strapdown Analytics)."""
    rate = values[:, samples.k]
    before = samples.each(lambda p: np.append(rate[p.start], rate[p][:-1]))
    return samples.replaced(values, (1 - size) * rate + size * before)


@declare("telemetry", "share", "turns", all_axes=True)
def packets_swapped(samples: Samples, values: Array, size: float) -> Array:
    """Some packets come in the wrong order. The ground joins them as they arrive (CCSDS 133.0)."""
    length, out = int(samples.scaled(2, 16)), values.copy()
    starts = np.concatenate([np.arange(p.start + length, p.stop - length, 2 * length) for p in samples.stream.intervals])
    for start in starts[samples.rng.random(len(starts)) < size]:
        out[start - length : start + length] = np.roll(values[start - length : start + length], length, axis=0)
    return out


@declare("telemetry", "share")
def bit_errors(samples: Samples, values: Array, size: float) -> Array:
    """Single bits of words are turned. The link has errors that no code mends (CCSDS 131.0)."""
    rate, count = values[:, samples.k], len(values)
    weights = float(np.abs(rate).max()) * 2.0 ** -np.arange(1.0, 12.0)
    hit = samples.rng.random(count) < 0.02 * size
    return samples.replaced(values, rate + hit * samples.rng.choice([-1.0, 1.0], count) * samples.rng.choice(weights, count))


# ---- references ------------------------------------------------------------------------------------------------------------


@declare("reference", "deg", "turns")
def field_waves(sightings: Sightings) -> Array:
    """Error has waves over the sky. Distortion and catalogue shift stars (Liebe, IEEE Trans. AES 38, 2002)."""
    return np.sin(
        sightings.scaled(3.0, 40.0) * (sightings.body[:, sightings.other_axis] @ sightings.direction()) + sightings.phase
    )


@declare("reference", "deg")
def acquisition_tail(sightings: Sightings) -> Array:
    """Error decays after each acquisition. The tracker's filter settles (Liebe, IEEE Trans. AES 38, 2002)."""
    return np.exp(-sightings.since_start / sightings.between(0.05, 0.4))


@declare("reference", "deg", "turns")
def sun_glint(sightings: Sightings) -> Array:
    """Error appears near one direction. Stray light pulls the centroids (Liebe, IEEE Trans. AES 38, 2002)."""
    angle = np.arccos(np.clip(sightings.body[:, sightings.other_axis] @ sightings.direction(), -1, 1))
    return np.exp(-0.5 * ((angle - angle.min()) / sightings.scaled(0.05, 0.5)) ** 2)


@declare("reference", "deg", "turns")
def parallax(sightings: Sightings) -> Array:
    """Error goes with the pose. Cameras and markers are not where their calibration has them."""
    down = sightings.body @ sightings.direction()
    return down[:, sightings.k] * down[:, (sightings.k + 1) % 3] + 0.5 * down[:, (sightings.k + 2) % 3] ** 2


@declare("random_reference", "s", "dense", "turns", all_axes=True, side="time")
def late_exposures(sightings: Sightings) -> Array:
    """References are late by a random time. Exposures wait for the processor (Liebe, IEEE Trans. AES 38, 2002)."""
    return -sightings.rates * sightings.rng.random(len(sightings.t))[:, None]


@declare("random_reference", "deg")
def marker_swap(sightings: Sightings) -> Array:
    """Error is constant through random episodes. A marker is lost and the fit goes on with the others."""
    length, share, inside = sightings.between(0.02, 0.15), 0.1 + 0.3 * sightings.share, False
    out = np.zeros(len(sightings.t))
    for row, away in enumerate(-np.expm1(-np.diff(sightings.t, prepend=sightings.t[0]) / length)):
        inside = sightings.rng.random() > away if inside else sightings.rng.random() < away * share / (1 - share)
        out[row] = inside
    return out


@declare("random_reference", "deg", all_axes=True)
def loop_closures(sightings: Sightings) -> Array:
    """Error is a random walk that returns to zero at random times. Visual odometry meets a place again."""
    step = np.diff(sightings.since_start, prepend=0.0).clip(0.0) / sightings.between(0.1, 1.0)
    keeps = np.where(sightings.first == np.arange(len(sightings.t)), 0.0, sightings.rng.random(len(step)) < np.exp(-step))
    drive = np.sqrt(step)[:, None] * sightings.rng.standard_normal((len(step), 3))
    return np.stack([recursion(keeps, keeps * drive[:, axis]) for axis in range(3)], axis=1)
