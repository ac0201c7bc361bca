"""Reference offset where the spacecraft flies -x forward: e = size about the axis there, zero elsewhere.

After a yaw turn another sun-sensor head looks at the Sun, with its own misalignment. Which axis is forward follows from how the
body turns (`simulator.effects.flight_mode`). In an inertial hold none is; whether the head of the mode before it goes on being
used is not known, and is a parameter.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.effects.base import Array, Effect, Parameter, References, Surroundings, Trial, Value
from simulator.effects.common import DEG, on_axis

BACKWARD = "-x"
HOLDS = ("off", "on")


def any_holds(rng: np.random.Generator, around: Surroundings) -> Value:
    """Off or on."""
    return str(rng.choice(HOLDS))


class ReferenceModeOffset(Effect):
    """See the module."""

    def reference_columns(self, references: References, axis: str | None, parameters: Mapping[str, Value]) -> Array:
        """One where -x is forward, as degrees."""
        forward = _carried_on(references) if parameters.get("holds") == "on" else references.forward
        return on_axis((forward == BACKWARD) * DEG, axis)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Without and with the offset in holds, if there are any."""
        both = (_carried_on(around.references) != around.references.forward).any()
        holds = HOLDS if both else HOLDS[:1]
        return tuple(Trial({"holds": choice}, 1 / len(holds)) for choice in holds)

    def missing(self, around: Surroundings) -> str | None:
        """It needs references in this mode and in another one, since an offset of all of them cannot be seen."""
        flown = set(around.references.forward) - {""}
        if BACKWARD not in flown:
            return f"no reference is taken with {BACKWARD} forward"
        return None if len(flown) > 1 else f"all references are taken with {BACKWARD} forward"


def _carried_on(references: References) -> NDArray[np.str_]:
    """The forward axes, where there is none that of the reference before in the same interval."""
    out = references.forward.copy()
    for row in range(1, len(out)):
        if out[row] == "" and references.interval[row] == references.interval[row - 1]:
            out[row] = out[row - 1]
    return out


EFFECT = ReferenceModeOffset(
    name="reference_mode_offset",
    summary="reference offset in -x forward against other modes",
    says="the reference attitude is off by {size} about {axis} in -x forward",
    unit="deg",
    stage="reference",
    prior=(1e-5, 10.0),
    bounds=(-90.0, 90.0),
    parameters=(Parameter("holds", "", "off", "in an inertial hold after -x forward", choices=HOLDS, draw=any_holds),),
    meaning="The reference attitude is offset when flying -x forward, as when another sensor head takes over.",
)
