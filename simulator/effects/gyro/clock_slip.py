"""Gyro tags that get late by a step at one time and stay so: raw(t) = raw_true(t − size H(t − time_s)).

A sample that is lost, or counted twice, and a tag that is made by counting: all later tags are off by a sample. Sizes are those
of a sample or some. A sample that the step falls into shows both readings by their share of it. To first order the reading
changes by −size · H(t − time_s) dω_raw/dt, the column.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, Setting, Stream
from simulator.effects.common import TIME_PARAMETER, compute_share_after, number
from simulator.effects.timing import compute_delay_columns, delay_rates


class ClockSlip(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """−H(t − time_s) dω_raw/dt."""
        return compute_delay_columns(stream) * compute_share_after(stream, number(parameters, "time_s"))[:, None, None]

    def retimed(self, raw: Array, stream: Stream, setting: Setting) -> Array:
        """Late readings from time_s on."""
        after = compute_share_after(stream, number(setting.parameters, "time_s"))[:, None]
        late = delay_rates(raw, stream, np.full(len(stream.t_s), setting.size))
        return np.asarray(raw + after * (late - raw))


EFFECT = ClockSlip(
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
    meaning="The gyro's time tags are late from one time on (early if negative), as after a sample that was lost or counted "
    "twice.",
    switched=True,
)
