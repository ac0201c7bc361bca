"""An element of the gyro matrix that steps at one time: raw_axis += size · 10⁻⁶ ω_toward H(t − time_s).

With toward = axis the scale factor jumps; else the gyro's input axis tilts towards another one, as after a thermal shock or
a shift of the mount. A sample that the step falls into shows its mean.
"""

from simulator.effects.base import Array, Effect, Parameters, Stream
from simulator.effects.common import PPM, TIME_PARAMETER, TOWARD, compute_share_after, index, number, put_on_axis


class GMatrixStep(Effect):
    """See the module."""

    def columns(self, stream: Stream, axis: str | None, parameters: Parameters) -> Array:
        """10⁻⁶ ω_toward H(t − time_s)."""
        omega = stream.rates[:, index(str(parameters["toward"]))]
        return put_on_axis(PPM * omega * compute_share_after(stream, number(parameters, "time_s")), axis)


EFFECT = GMatrixStep(
    name="g_matrix_step",
    summary="an element G[axis, toward] steps at one time",
    says="{whose} scale or alignment jumps by {size} at one time",
    unit="ppm",
    stage="rate",
    prior=(1.0, 5e4),
    bounds=(-1e6, 1e6),
    parameters=(TIME_PARAMETER, TOWARD),
    meaning="One element of the gyro's scale-factor and misalignment matrix jumps at one time, as after a shock.",
    switched=True,
)
