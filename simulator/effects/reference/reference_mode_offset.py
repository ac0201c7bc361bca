"""Reference offset where the spacecraft flies -x forward: e = size about the axis there, zero elsewhere.

After a yaw turn another sun-sensor head looks at the Sun, with its own misalignment. Which axis is forward is read from the
interval's activity, see `simulator.effects.recorded.forward_axes`.
"""

from collections.abc import Mapping

from simulator.effects.base import Array, Effect, References, Value
from simulator.effects.common import DEG, on_axis


class ReferenceModeOffset(Effect):
    """See the module."""

    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """One where -x is forward, as degrees."""
        return on_axis((references.forward == "-x") * DEG, axis)


EFFECT = ReferenceModeOffset(
    name="reference_mode_offset",
    summary="reference offset in -x forward against other modes",
    unit="deg",
    acts_on="references",
    kind="columns",
    prior=(5e-4, 5.0),
    bounds=(-90.0, 90.0),
)
