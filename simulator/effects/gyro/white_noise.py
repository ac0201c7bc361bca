"""White noise of the rates and of the angle that is read out, other than stated.

noise_excess
    The white noise of each sample times size; 1 is as stated.
noise_angle_white
    The angle that the gyro reads out has white noise v with the standard deviation size: raw_k += (v_{k+1} − v_k)/Δt, IEEE Std
    952, annex C: a spectrum of the rate that rises as f², and the Allan variance 3 size²/τ². Rates are differences of readings.
    Counts of size q make size = q/√12, "quantization noise". Where samples follow one another it does not add up: of the angle
    turned, only the first and the last reading are in error. Each stretch of samples without a hole begins with a reading of
    its own.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Setting, Stream
from simulator.effects.common import RAD_PER_ARCSEC, NoiseFactor, index, list_runs, no_gyro_noise


class _NoiseAngleWhite(Effect):
    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        out = samples.copy()
        for part in list_runs(stream.t_s, stream.duration_s, stream.intervals):
            reading = setting.size * RAD_PER_ARCSEC * rng.standard_normal(part.stop - part.start + 1)
            out[part, index(setting.axis)] += np.diff(reading) / stream.duration_s[part]
        return out


EFFECTS = [
    NoiseFactor(
        name="noise_excess",
        summary="white gyro noise is other than stated",
        says="{whose} white noise is {size} times what is stated",
        unit="factor",
        stage="white_noise",
        prior=(0.1, 30.0),
        bounds=(0.0, 1e6),
        axis_optional=True,
        meaning="The gyro's white noise is not what the recording states; 1 would be as stated.",
        symptom="white_noise_level",
        requirement=no_gyro_noise,
    ),
    _NoiseAngleWhite(
        name="noise_angle_white",
        summary="angle white noise, readout noise of the angle",
        says="the angle that {gyro} reads out is noisy by {size}",
        unit="arcsec",
        stage="pickup",
        prior=(1e-3, 1e4),
        bounds=(0.0, 1e6),
        meaning="The angle that the gyro reads out is noisy; the rates, its differences, have more noise the "
        "higher the frequency.",
        symptom="readout_noise",
        requirement=no_gyro_noise,
    ),
]
