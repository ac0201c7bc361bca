"""Gyro time tags that are late against the references' clock: raw(t) = raw_true(t − size).

The sample tagged t was measured at t − size. To first order the reading changes by −size · dω_raw/dt, the column; the
simulator shifts the cumulative angle itself, see `simulator.effects.timing`.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Setting, Stream
from simulator.effects.timing import compute_delay_columns, delay_rates


class TimeOffset(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """−dω_raw/dt."""
        return compute_delay_columns(stream)

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Means over [t − size, t − size + Δ) of the reading."""
        return delay_rates(raw, stream, np.full(len(stream.t_s), setting.size))


EFFECT = TimeOffset(
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
)
