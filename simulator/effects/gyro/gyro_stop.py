"""Gyro that stops at a level for a while and resumes: the reading is size from begin_s to end_s, whatever the motion.

A converter or a supply that drops out, or a driver that puts out the zero level. Such a stretch carries no rate, and the mask
of a recording (`gyrocal.masking`) leaves it out.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Setting, Stream
from simulator.effects.common import DEG, number, select_axes


class GyroStop(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """The level in the samples that begin inside the stretch."""
        begin = stream.t_s - 0.5 * stream.duration_s
        inside = (begin >= number(setting.parameters, "begin_s")) & (begin < number(setting.parameters, "end_s"))
        out = samples.copy()
        for column in select_axes(setting.axis):
            out[inside, column] = setting.size * DEG
        return out


EFFECT = GyroStop(
    name="gyro_stop",
    summary="the gyro stops at a level for a while and resumes",
    says="{whose} readings stop at {size} for a while",
    unit="deg/s",
    stage="telemetry",
    prior=(1e-6, 1e3),
    bounds=(-1e5, 1e5),
    axis_optional=True,
    parameters=(
        Parameter("begin_s", "s", None, "time at which it stops, since the epoch", -1e12, 1e12),
        Parameter("end_s", "s", None, "time at which it resumes", -1e12, 1e12),
    ),
    meaning="The gyro's reading stops at a level for a while, whatever the motion, and resumes; the size is the level.",
)
