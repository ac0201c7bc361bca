"""Samples that a tone is added to, or that are falsified, repeated or stopped.

vibration
    Structural tone, aliased by sampling: raw += size · sin(2π f t + φ), f the apparent frequency, t the middle of the sample
    since the epoch. Flexible appendages and wheels turn the gyro but hardly the body. Whatever the true frequency, a sampled
    tone shows up at one between zero and half the sampling rate, the apparent one.
spikes
    Bit flips, lost counts: with probability ``fraction`` a sample is off by ± size · E, E exponential of mean 1. The sign is
    random, so the mean absolute outlier is size and their mean is zero; each axis has its own.
stale_samples
    Telemetry that repeats the previous sample, all axes at once. A two-state chain, fresh and stale: a stale run goes on with
    probability 1 − 1/size, so its length is geometric of mean size; fresh ones turn stale with probability p such that the
    share of stale samples f = p·size/(1 + p·size) is ``fraction``. The first sample of an interval is fresh.
gyro_stop
    The reading is size in the samples that begin from begin_s to end_s, whatever the motion. A converter or a supply that drops
    out, or a driver that puts out the zero level. Such a stretch carries no rate, and the mask of a recording
    (`gyrocal.masking`) leaves it out.
"""

import numpy as np

from gyrocal.arrays import Mask
from gyrocal.errors import InputError
from simulator.effects.base import Array, Effect, Parameter, Setting, Stream
from simulator.effects.common import DEG, PHASE, index, number, select_axes


class _Vibration(Effect):
    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        frequency = number(setting.parameters, "apparent_hz")
        half_rate = 0.5 / float(np.median(stream.duration_s))
        if frequency > half_rate:
            raise InputError(f"{setting.label()}: apparent_hz {frequency:g} is above half the sampling rate, {half_rate:g} Hz")
        phase = np.deg2rad(number(setting.parameters, "phase_deg"))
        out = samples.copy()
        out[:, index(setting.axis)] += setting.size * DEG * np.sin(2 * np.pi * frequency * stream.t_s + phase)
        return out


class _Spikes(Effect):
    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        axes = select_axes(setting.axis)
        shape = (len(samples), len(axes))
        hit = rng.random(shape) < number(setting.parameters, "fraction")
        outlier = rng.laplace(0.0, setting.size * DEG, shape)  # an exponential with random sign
        out = samples.copy()
        out[:, axes] += np.where(hit, outlier, 0.0)
        return out


class _StaleSamples(Effect):
    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        stale = _draw_stale_mask(rng, len(samples), setting.size, number(setting.parameters, "fraction"))
        stale[[part.start for part in stream.intervals]] = False
        source = np.maximum.accumulate(np.where(stale, 0, np.arange(len(samples))))
        return np.asarray(samples[source])


class _GyroStop(Effect):
    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        begin = stream.t_s - 0.5 * stream.duration_s
        inside = (begin >= number(setting.parameters, "begin_s")) & (begin < number(setting.parameters, "end_s"))
        out = samples.copy()
        for column in select_axes(setting.axis):
            out[inside, column] = setting.size * DEG
        return out


def _draw_stale_mask(rng: np.random.Generator, count: int, mean_run: float, fraction: float) -> Mask:
    """Draw the samples that repeat the one before, (count,)."""
    onset = fraction / ((1 - fraction) * mean_run)
    if onset > 1:
        raise InputError(
            f"stale_samples: fraction {fraction:g} needs longer runs than {mean_run:g}; one sample between two is fresh"
        )
    stale = np.zeros(count, dtype=bool)
    place = int(rng.geometric(onset)) if onset > 0 else count
    while place < count:
        length = int(rng.geometric(1 / mean_run))
        stale[place : place + length] = True
        place += length + int(rng.geometric(onset))
    return stale


EFFECTS = [
    _Vibration(
        name="vibration",
        summary="structural tone, aliased by sampling",
        says="{gyro} picks up a steady vibration of {size}",
        unit="deg/s",
        stage="pickup",
        prior=(1e-7, 10.0),
        bounds=(-1e5, 1e5),
        sign="positive",
        parameters=(Parameter("apparent_hz", "Hz", 0.2, "apparent frequency, at most half the sampling rate", 0.0, 1e6), PHASE),
        meaning="A steady tone in the samples, at the frequency that sampling makes of it.",
    ),
    _Spikes(
        name="spikes",
        summary="outliers in the gyro samples",
        says="single samples of {gyro} are far off, by about {size}",
        unit="deg/s",
        stage="outliers",
        prior=(1e-6, 1e3),
        bounds=(0.0, 1e4),
        axis_optional=True,
        parameters=(Parameter("fraction", "", 0.001, "share of the samples", 0.0, 1.0),),
        meaning="Single samples are far off, as by bit flips or lost counts; the size is their mean height.",
        symptom="outliers",
    ),
    _StaleSamples(
        name="stale_samples",
        summary="telemetry repeats the previous sample",
        says="telemetry repeats old samples of the gyro, in runs of {number} on average",
        unit="samples, mean run",
        stage="telemetry",
        prior=(1.0, 100.0),
        bounds=(1.0, 1e6),
        axes=(),
        parameters=(Parameter("fraction", "", 0.01, "share of the samples that are repeats", 0.0, 0.99),),
        meaning="Telemetry repeats the sample before; the size is the mean length of a run of repeats.",
        symptom="repeats",
    ),
    _GyroStop(
        name="gyro_stop",
        summary="the gyro stops at a level for a while and resumes",
        says="{whose} readings stop at {size} for a while",
        unit="deg/s",
        stage="telemetry",
        prior=(1e-6, 1e3),
        bounds=(-1e5, 1e5),
        axis_optional=True,
        parameters=(
            Parameter("begin_s", "s", None, "time at which it stops, since the epoch", -1e12, 1e12),
            Parameter("end_s", "s", None, "time at which it resumes", -1e12, 1e12),
        ),
        meaning="The gyro's reading stops at a level for a while, whatever the motion, and resumes; the size is the level.",
    ),
]
