"""Clocks of gyro and references that disagree: raw(t) = raw_true(t − d), the sample tagged t was measured at t − d.

To first order the reading changes by −d · dω_raw/dt, the column; the simulator shifts the cumulative angle itself, see
`simulator.effects.timing`.

time_offset
    d = size: the tags are late.
clock_drift
    d = size · 10⁻⁶ (t − middle of the recording). The clock of the samples is slow by `size` against that of the references:
    their tags get later and later. The mean delay is `time_offset`. A quartz oscillator is off its frequency by 1 to 100 ppm
    and more with temperature (IEEE Std 1139); receivers and cameras of another computer differ as much. A gyro that counts
    angle per tick of the slow clock also reads low by `size`, which its scale factor takes up.
clock_slip
    d = size · H(t − time_s). A sample that is lost, or counted twice, and a tag that is made by counting: all later tags are
    off by a sample. Sizes are those of a sample or some. A sample that the step falls into shows both readings by their share.
clock_wander
    d a Gauss–Markov process of σ = size, to first order: a receiver that stamps samples as they arrive, or a clock that is
    steered. A diagnosis has no name for it: such errors are part of its remainder, which an adopted scenario simulates.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Parameters, Setting, Stream, Surroundings
from simulator.effects.common import PPM, TIME_PARAMETER, compute_share_after, gauss_markov, number
from simulator.effects.timing import compute_delay_columns, delay_rates

LEAST_SPAN_S = 10.0  # at the largest plausible drift the delay then changes by 5 ms


@dataclass(frozen=True)
class _LateTags(Effect):
    delay: Callable[[Stream, Parameters], Array] = field(kw_only=True)  # (n,) s per unit of the size

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        return compute_delay_columns(stream) * self.delay(stream, parameters)[:, None, None]

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        return delay_rates(raw, stream, setting.size * self.delay(stream, setting.parameters))


class _ClockSlip(_LateTags):
    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Mix the readings before and after the step by their share of a sample, and not one at a delay between them."""
        late = delay_rates(raw, stream, np.full(len(stream.t_s), setting.size))
        return np.asarray(raw + self.delay(stream, setting.parameters)[:, None] * (late - raw))


class _ClockWander(Effect):
    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        late_s = setting.size * gauss_markov(rng, stream.t_s, number(setting.parameters, "time_constant_s"))
        return np.asarray(compute_delay_columns(stream)[:, :, 0] * late_s[:, None])


def _compute_constant_delay(stream: Stream, parameters: Parameters) -> Array:
    return np.ones(len(stream.t_s))


def _compute_growing_delay(stream: Stream, parameters: Parameters) -> Array:
    first, last = stream.span_s
    return np.asarray(PPM * (stream.t_s - 0.5 * (first + last)))


def _explain_short_recording(around: Surroundings) -> str | None:
    first, last = around.stream.span_s
    if last - first < LEAST_SPAN_S:
        return f"the recording is shorter than {LEAST_SPAN_S:g} s, in which clocks do not run apart"
    return None


EFFECTS = [
    _LateTags(
        name="time_offset",
        summary="gyro tags late (+) against the reference clock",
        says="the gyro's time tags are {size} {way}",
        ways=("late", "early"),
        unit="s",
        stage="clock",
        prior=(1e-4, 10.0),
        bounds=(-3600.0, 3600.0),
        axes=(),
        meaning="The gyro's time tags are late against the clock of the reference attitudes (early if negative).",
        delay=_compute_constant_delay,
    ),
    _LateTags(
        name="clock_drift",
        summary="the gyro's clock runs apart from the reference clock",
        says="the gyro's time tags get {size} {way} as the recording goes on",
        ways=("later", "earlier"),
        unit="ppm",
        stage="clock",
        prior=(0.1, 500.0),
        weight=0.02,  # a clock that drifts or slips by so much is far rarer than one that is set wrong: by judgement
        bounds=(-1e5, 1e5),
        axes=(),
        meaning="The clocks of gyro and references run apart: the gyro's tags get later and later against the references "
        "(earlier if negative).",
        requirement=_explain_short_recording,
        delay=_compute_growing_delay,
    ),
    _ClockSlip(
        name="clock_slip",
        summary="gyro tags get late (+) by a step at one time",
        says="the gyro's time tags jump by {size} {way} at one time",
        ways=("late", "early"),
        unit="s",
        stage="clock",
        prior=(1e-4, 2.0),
        weight=0.02,  # a clock that drifts or slips by so much is far rarer than one that is set wrong: by judgement
        bounds=(-60.0, 60.0),
        axes=(),
        parameters=(TIME_PARAMETER,),
        meaning="The gyro's time tags are late from one time on (early if negative), as after a sample that was lost or "
        "counted twice.",
        switched=True,
        delay=compute_share_after,
    ),
    _ClockWander(
        name="clock_wander",
        summary="the gyro's time tags wander",
        says="the gyro's time tags wander by {size}",
        unit="s",
        stage="random_rate",
        prior=(1e-6, 1.0),
        bounds=(0.0, 10.0),
        axes=(),
        parameters=(Parameter("time_constant_s", "s", 60.0, "time constant", 1e-3, 1e9),),
        meaning="The gyro's time tags are early and late by a random time that lasts for a while.",
    ),
]
