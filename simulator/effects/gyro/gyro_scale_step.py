"""Scale factor of one gyro that jumps at one time and stays: raw += size · 10⁻⁶ ω H(t − time_s), ω the rate about its axis.

For x, y and z it is `g_matrix_step` towards the axis itself. Of more than three gyros the parity sees it without a reference.
"""

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import PPM, TIME_PARAMETER, compute_share_after, index, number, put_on_axis


class GyroScaleStep(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """10⁻⁶ ω H(t − time_s)."""
        return put_on_axis(PPM * stream.rates[:, index(axis)] * compute_share_after(stream, number(parameters, "time_s")), axis)


EFFECT = GyroScaleStep(
    name="gyro_scale_step",
    summary="scale factor of one of several gyros jumps at one time",
    says="{whose} scale factor jumps by {size} and stays there",
    unit="ppm",
    stage="rate",
    prior=(1.0, 5e4),
    bounds=(-1e6, 1e6),
    parameters=(TIME_PARAMETER,),
    meaning="The scale factor of one gyro jumps at one time and stays there.",
    switched=True,
    of_arrays=True,
)
