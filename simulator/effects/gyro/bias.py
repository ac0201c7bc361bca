"""Biases along a known course: raw += size · course(t), t since the epoch.

bias_drift
    Linear over the mission, (t − t₀) in days from the start t₀ of the recording: ageing of the gyro's electronics and, in a gas
    bearing, of its fill. Table 1 of IEEE Std 952-1997 calls it rate ramp; over days it is slow enough to be a line.
bias_step
    H(t − time_s); a sample that the step falls into shows its mean. Seen after thermal shocks, power cycles and changes of the
    gyro's range.
bias_orbital
    sin(n t + φ), n = 2π/period: the Sun warms and the shadow cools the gyro once an orbit.
bias_periodic
    sin(2π t/P + φ). IEEE Std 952, annex C, calls it sinusoidal noise: a heater that switches, a pump, another instrument's duty
    cycle. The mean of the sine over a sample of length d is sin(π d/P)/(π d/P) times its value in the middle.
bias_temperature
    T − mean T over the recording's samples, the linear term of a gyro's thermal model; the constant one is the bias itself. T
    is what the housekeeping shows, linear between its rows. The column may be named; else one whose name ends in temperature_c
    is taken, the gyro's before others.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import DAY, DEG_H, TIME_PARAMETER, compute_share_after, put_on_axis
from simulator.effects.housekeeping_columns import TEMPERATURE, compute_temperature_change, no_temperature
from simulator.effects.periodic import Periodic, Sinusoid


@dataclass(frozen=True)
class _BiasCourse(Effect):
    course: Callable[[Stream, Parameters], Array] = field(kw_only=True)  # (n,) per unit of the size, as deg/h

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        return put_on_axis(self.course(stream, parameters) * DEG_H, axis)


class _BiasOrbital(Sinusoid):
    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        return put_on_axis(self.build_waves(stream.t_s, stream.orbit_period_s, parameters) * DEG_H, axis)


class _BiasPeriodic(Periodic):
    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        mean = np.sinc(stream.duration_s / float(parameters["period_s"]))[:, None]
        return put_on_axis(self.build_waves(stream.t_s, stream.orbit_period_s, parameters) * mean * DEG_H, axis)


def _count_days(stream: Stream, parameters: Parameters) -> Array:
    return np.asarray((stream.t_s - stream.span_s[0]) / DAY)


EFFECTS = [
    _BiasCourse(
        name="bias_drift",
        summary="bias grows linearly over mission time",
        says="{whose} bias {way} by {size}",
        ways=("rises", "falls"),
        unit="deg/h per day",
        stage="rate",
        prior=(1e-6, 1e5),
        meaning="The gyro's bias grows steadily over the whole mission time; positive: it reads ever higher.",
        course=_count_days,
    ),
    _BiasCourse(
        name="bias_step",
        summary="bias jumps at one time and stays",
        says="{whose} bias jumps {way} by {size} and stays there",
        ways=("up", "down"),
        unit="deg/h",
        stage="rate",
        prior=(1e-5, 5e3),
        parameters=(TIME_PARAMETER,),
        meaning="The gyro's bias jumps at one time and stays there; positive: it reads high afterwards.",
        switched=True,
        course=compute_share_after,
    ),
    _BiasOrbital(
        name="bias_orbital",
        summary="bias varies sinusoidally at orbit rate",
        says="{whose} bias swings by ±{size} once an orbit",
        unit="deg/h",
        stage="rate",
        prior=(1e-5, 1e3),
        meaning="The gyro's bias goes up and down once an orbit, as when sun and shadow warm and cool it.",
    ),
    _BiasPeriodic(
        name="bias_periodic",
        summary="bias swings with a period of its own",
        says="{whose} bias swings by ±{size} with a period of its own",
        unit="deg/h",
        stage="rate",
        prior=(1e-5, 1e3),
        meaning="The gyro's bias goes up and down with a steady period that is not the orbit's, as with a heater "
        "that switches.",
    ),
    _BiasCourse(
        name="bias_temperature",
        summary="bias follows a housekeeping temperature",
        says="{whose} bias {way} by {size} with a temperature",
        ways=("rises", "falls"),
        unit="deg/h per K",
        stage="rate",
        prior=(1e-6, 1e3),
        parameters=(TEMPERATURE,),
        meaning="The gyro's bias follows a temperature of the housekeeping data; positive: it reads high when warm.",
        requirement=no_temperature,
        course=partial(compute_temperature_change, "bias_temperature"),
    ),
]
