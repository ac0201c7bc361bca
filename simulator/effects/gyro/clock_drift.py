"""Clocks of gyro and references that run apart: raw(t) = raw_true(t − d), d = size · 10⁻⁶ (t − middle of the recording).

The clock of the samples is slow by `size` against that of the references: their tags get later and later. The mean delay is an
effect of its own, of a delay that stays. A quartz oscillator is off its frequency by 1 to 100 ppm and more with temperature
(IEEE Std 1139); receivers and cameras of another computer differ as much. Each sample is read at its own delay, to first
order −d · dω_raw/dt, the column. A gyro that counts angle per tick of the slow clock also reads low by `size`, which its scale
factor takes up.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Setting, Stream, Surroundings
from simulator.effects.common import PPM
from simulator.effects.timing import compute_delay_columns, delay_rates

LEAST_SPAN_S = 10.0  # at the largest plausible drift the delay then changes by 5 ms


def compute_tag_delay(stream: Stream) -> Array:
    """Compute the delay of each sample's tag per ppm of drift, (n,) s; zero in the middle of the recording."""
    first, last = stream.span_s
    return np.asarray(PPM * (stream.t_s - 0.5 * (first + last)))


class ClockDrift(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """−d · dω_raw/dt per ppm."""
        return compute_delay_columns(stream) * compute_tag_delay(stream)[:, None, None]

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Readings at t − d."""
        return delay_rates(raw, stream, setting.size * compute_tag_delay(stream))

    def missing(self, around: Surroundings) -> str | None:
        """It needs some time in which the clocks can run apart, and references to show it."""
        first, last = around.stream.span_s
        if last - first < LEAST_SPAN_S:
            return f"the recording is shorter than {LEAST_SPAN_S:g} s, in which clocks do not run apart"
        return None


EFFECT = ClockDrift(
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
    meaning="The clocks of gyro and references run apart: the gyro's tags get later and later against the references (earlier "
    "if negative).",
)
