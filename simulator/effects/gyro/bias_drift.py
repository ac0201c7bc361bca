"""Bias that grows linearly over the mission: raw += size · (t − t₀), t₀ the start of the recording.

Ageing of the gyro's electronics and, in a gas bearing, of its fill. Table 1 of IEEE Std 952-1997 calls it rate ramp; over
days it is slow enough to be a line.
"""

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import DAY, DEG_H, put_on_axis


class BiasDrift(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """Days since the start, as deg/h."""
        return put_on_axis((stream.t_s - stream.span_s[0]) / DAY * DEG_H, axis)


EFFECT = BiasDrift(
    name="bias_drift",
    summary="bias grows linearly over mission time",
    says="{whose} bias {way} by {size}",
    ways=("rises", "falls"),
    unit="deg/h per day",
    stage="rate",
    prior=(1e-6, 1e5),
    meaning="The gyro's bias grows steadily over the whole mission time; positive: it reads ever higher.",
)
