"""Reference offset where the spacecraft flies -x forward: e = size about the axis there, zero elsewhere.

After a yaw turn another sun-sensor head looks at the Sun, with its own misalignment. Which axis is forward is read from the
interval's activity, see `simulator.effects.recorded.forward_axes`.
"""

from collections.abc import Mapping

from simulator.effects.base import Array, Effect, References, Surroundings, Value
from simulator.effects.common import DEG, on_axis

BACKWARD = "-x"


class ReferenceModeOffset(Effect):
    """See the module."""

    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """One where -x is forward, as degrees."""
        return on_axis((references.forward == BACKWARD) * DEG, axis)

    def missing(self, around: Surroundings) -> str | None:
        """It needs references in this mode and in another one, since an offset of all of them cannot be seen."""
        flown = set(around.references.forward) - {""}
        if BACKWARD not in flown:
            return f"no reference is taken with {BACKWARD} forward"
        return None if len(flown) > 1 else f"all references are taken with {BACKWARD} forward"


EFFECT = ReferenceModeOffset(
    name="reference_mode_offset",
    summary="reference offset in -x forward against other modes",
    unit="deg",
    stage="reference",
    prior=(5e-4, 5.0),
    bounds=(-90.0, 90.0),
    meaning="The reference attitude is offset when flying -x forward, as when another sensor head takes over.",
)
