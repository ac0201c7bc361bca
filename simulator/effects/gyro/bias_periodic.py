"""Bias that swings with a period of its own: raw += size · sin(2π t/P + φ), t since the epoch; a sample shows its mean.

IEEE Std 952, annex C, calls it sinusoidal noise: a heater that switches, a pump, another instrument's duty cycle. The mean of
the sine over a sample of length d is sin(π d/P)/(π d/P) times its value in the middle. What swings with the orbit is
`bias_orbital`.
"""

import numpy as np

from simulator.effects.base import Array, Parameters, Stream
from simulator.effects.common import DEG_H, harmonic, number, put_on_axis
from simulator.effects.periodic import Periodic


class BiasPeriodic(Periodic):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """Sine and cosine, as deg/h."""
        period = number(parameters, "period_s")
        mean = np.sinc(stream.duration_s / period)[:, None]
        return put_on_axis(harmonic(stream.t_s, period) * mean * DEG_H, axis)


EFFECT = BiasPeriodic(
    name="bias_periodic",
    summary="bias swings with a period of its own",
    says="{whose} bias swings by ±{size} with a period of its own",
    unit="deg/h",
    stage="rate",
    prior=(1e-5, 1e3),
    meaning="The gyro's bias goes up and down with a steady period that is not the orbit's, as with a heater that switches.",
)
