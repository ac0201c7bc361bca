"""Structural tone, aliased by sampling: raw += size · sin(2π f t + φ), f the apparent frequency, t since the epoch.

Flexible appendages and wheels turn the gyro but hardly the body. Whatever the true frequency, a sampled tone shows up at one
between zero and half the sampling rate, the apparent one; t is the middle of the sample.
"""

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import Array, Effect, Parameter, SampleTests, Setting, Smallest, Stream, Surroundings, Value
from simulator.effects.common import DEG, PHASE, compute_noncentrality, index, number

FEWEST_SPECTRUM_SAMPLES = 256  # quiet samples in a row for a spectrum


def draw_frequency(rng: np.random.Generator, around: Surroundings) -> Value:
    """An apparent frequency clear of zero and of half the sampling rate, Hz."""
    return float(rng.uniform(0.02, 0.47 / around.sample_s))


FREQUENCY = Parameter(
    "apparent_hz", "Hz", 0.2, "apparent frequency, at most half the sampling rate", 0.0, 1e6, draw=draw_frequency
)


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

    def smallest(self, around: Surroundings, tests: SampleTests) -> list[Smallest]:
        """Power of a tone in the longest quiet stretch under a Hann window, of noise bandwidth 3/2.

        2 × power over noise is χ² with 2 degrees of freedom and noncentrality A² n/(3 σ²); it must pass 2 ln(tried/p).
        """
        n, sigma = max(tests.quiet, default=0), around.sample_sigma_deg
        if n < FEWEST_SPECTRUM_SAMPLES or sigma == 0:
            return [Smallest(None, np.inf, f"needs {FEWEST_SPECTRUM_SAMPLES} quiet samples in a row, and noise")]
        needed = compute_noncentrality(2 * np.log(n / 2 / tests.line_p), 2, tests.power)
        text = f"above {tests.lowest_line_hz:g} Hz; up to 1.2 times that between frequency bins"
        return [Smallest(None, float(sigma * np.sqrt(3 * needed / n)), text)]


EFFECT = Vibration(
    name="vibration",
    summary="structural tone, aliased by sampling",
    says="{gyro} picks up a steady vibration of {size}",
    unit="deg/s",
    stage="pickup",
    prior=(1e-7, 10.0),
    bounds=(-1e5, 1e5),
    sign="positive",
    blind_sizes=(0.3, 3.0),
    in_noise=True,
    parameters=(FREQUENCY, PHASE),
    meaning="A steady tone in the samples, at the frequency that sampling makes of it.",
    symptom="spectral_line",
)
