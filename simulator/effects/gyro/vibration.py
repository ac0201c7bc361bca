"""Structural tone, aliased by sampling: raw += size · sin(2π f t + φ), f the apparent frequency, t since the epoch.

Flexible appendages and wheels turn the gyro but hardly the body. Whatever the true frequency, a sampled tone shows up at one
between zero and half the sampling rate, the apparent one; t is the middle of the sample.
"""

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import Array, Effect, Parameter, Setting, Stream
from simulator.effects.common import DEG, PHASE, index, number

FREQUENCY = Parameter("apparent_hz", "Hz", 0.2, "apparent frequency, at most half the sampling rate", 0.0, 1e6)


class Vibration(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Add the tone."""
        frequency = number(setting.parameters, "apparent_hz")
        half_rate = 0.5 / float(np.median(stream.duration_s))
        if frequency > half_rate:
            raise InputError(f"{setting.label()}: apparent_hz {frequency:g} is above half the sampling rate, {half_rate:g} Hz")
        phase = np.deg2rad(number(setting.parameters, "phase_deg"))
        out = samples.copy()
        out[:, index(setting.axis)] += setting.size * DEG * np.sin(2 * np.pi * frequency * stream.t_s + phase)
        return out


EFFECT = Vibration(
    name="vibration",
    summary="structural tone, aliased by sampling",
    says="{gyro} picks up a steady vibration of {size}",
    unit="deg/s",
    stage="pickup",
    prior=(1e-7, 10.0),
    bounds=(-1e5, 1e5),
    sign="positive",
    parameters=(FREQUENCY, PHASE),
    meaning="A steady tone in the samples, at the frequency that sampling makes of it.",
)
