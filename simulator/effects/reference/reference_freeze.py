"""Reference that repeats its last attitude for a while: references from begin_s to begin_s + size show the one before begin_s.

A camera or a filter that hangs puts out its last result again. Such repeats carry no attitude, and the mask of a recording
(`gyrocal.masking`) leaves them out.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, References, Setting
from simulator.effects.common import number


class ReferenceFreeze(Effect):
    """See the module."""

    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        """The last reference before begin_s again, within its interval."""
        begin = number(setting.parameters, "begin_s")
        frozen = (references.t_s >= begin) & (references.t_s < begin + setting.size)
        out = quaternions.copy()
        for interval in np.unique(references.interval[frozen]):
            own = references.interval == interval
            before = np.flatnonzero(own & (references.t_s < begin))
            if before.size:
                out[own & frozen] = quaternions[before[np.argmax(references.t_s[before])]]
        return out


EFFECT = ReferenceFreeze(
    name="reference_freeze",
    summary="the reference repeats its last attitude for a while",
    says="the reference attitude stands still for {size} while the body moves",
    unit="s",
    stage="reference_telemetry",
    prior=(1e-2, 1e4),
    bounds=(0.0, 1e9),
    axes=(),
    parameters=(Parameter("begin_s", "s", None, "first time at which it repeats, since the epoch", -1e12, 1e12),),
    meaning="The reference repeats its last attitude for a while although the body moves; the size is how long at most.",
    sign="positive",
)
