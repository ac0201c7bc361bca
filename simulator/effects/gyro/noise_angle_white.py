"""Angle white noise: the angle that the gyro reads out has white noise v with the standard deviation size.

raw_k += (v_{k+1} − v_k)/Δt, IEEE Std 952, annex C: a spectrum of the rate that rises as f², and the Allan variance 3 size²/τ².
Rates are differences of readings. Counts of size q make size = q/√12, "quantization noise". Where samples follow one another
it does not add up: of the angle turned, only the first and the last reading are in error. Each stretch of samples without a
hole begins with a reading of its own.
"""

import numpy as np

from simulator.effects.base import Array, Effect, SampleTests, Setting, Smallest, Stream, Surroundings
from simulator.effects.common import RAD_PER_ARCSEC, compute_noise_powers, index, list_runs, log_uniform, no_gyro_noise

FEWEST_QUIET_SAMPLES = 200  # quiet samples
DIFFERENCED = 20 / 6  # variance of second differences of differences of white noise, over that of white noise


class NoiseAngleWhite(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """Add the differences of the readings' noise."""
        out = samples.copy()
        for part in list_runs(stream):
            reading = setting.size * RAD_PER_ARCSEC * rng.standard_normal(part.stop - part.start + 1)
            out[part, index(setting.axis)] += np.diff(reading) / stream.duration_s[part]
        return out

    def draw_size(self, rng: np.random.Generator, around: Surroundings, axis: str | None) -> float:
        """Differences from half the noise of a sample to three times that."""
        return float(np.deg2rad(around.sample_sigma_deg)) * around.sample_s / RAD_PER_ARCSEC * log_uniform(rng, 0.5, 3.0)

    def smallest(self, around: Surroundings, tests: SampleTests) -> list[Smallest]:
        """Second differences show the variance σ² + 10/3 (size/Δt)², and must pass the test of the level of the noise."""
        n = sum(tests.quiet)
        if n < FEWEST_QUIET_SAMPLES or around.arw == 0:
            return [Smallest(None, np.inf, f"needs {FEWEST_QUIET_SAMPLES} quiet samples of a gyro with stated noise")]
        excess, _ = compute_noise_powers(n, tests)
        sigma = around.arw / np.sqrt(around.sample_s)
        return [
            Smallest(
                None, float(sigma * around.sample_s * np.sqrt((excess - 1) / DIFFERENCED)) / RAD_PER_ARCSEC, "any one axis"
            )
        ]


EFFECT = NoiseAngleWhite(
    name="noise_angle_white",
    summary="angle white noise, readout noise of the angle",
    says="the angle that {gyro} reads out is noisy by {size}",
    unit="arcsec",
    stage="pickup",
    prior=(1e-3, 1e4),
    bounds=(0.0, 1e6),
    meaning="The angle that the gyro reads out is noisy; the rates, its differences, have more noise the higher the frequency.",
    symptom="readout_noise",
    requirement=no_gyro_noise,
)
