"""Bias that jumps at one time and stays: raw += size · H(t − time_s).

A sample that the step falls into shows its mean. Seen after thermal shocks, power cycles and changes of the gyro's range.
"""

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import DEG_H, TIME_PARAMETER, compute_share_after, number, put_on_axis


class BiasStep(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """H(t − time_s), as deg/h."""
        return put_on_axis(compute_share_after(stream, number(parameters, "time_s")) * DEG_H, axis)


EFFECT = BiasStep(
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
)
