"""Reference offset where the spacecraft flies -x forward: e = size about the axis there, zero elsewhere.

After a yaw turn another sun-sensor head looks at the Sun, with its own misalignment. Which way the body flies follows from how
it turns (`simulator.effects.flight_mode`). At which heading of a turn the head takes over, and whether it goes on being used in
an inertial hold, which has no heading, is not known; both are parameters.
"""

from collections.abc import Sequence

import numpy as np

from gyrocal.arrays import Mask
from simulator.effects.base import Array, Effect, Parameter, Parameters, References, Surroundings, Trial, Value
from simulator.effects.common import DEG, put_on_axis

BACKWARD = "-x"
REVERSED_MODES = ("+x", BACKWARD)  # between which a turn of 180 degrees passes through all headings
HOLDS = ("off", "on")
WITHIN_DEG = 90.0
TRIED_DEG = tuple(range(30, 125, 15))  # headings from -x at which the head may take over


class _ReferenceModeOffset(Effect):
    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        return put_on_axis(np.where(_find_affected(references, parameters), DEG, 0.0), axis)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """Try each heading and rule for holds that reaches other references, weighted by the number of such headings."""
        counted: dict[bytes, tuple[dict[str, Value], int]] = {}
        # That of the simulator is the first of those that reach the same references.
        for within in sorted(TRIED_DEG, key=lambda angle: abs(angle - WITHIN_DEG)):
            for holds in HOLDS:
                parameters: dict[str, Value] = {"holds": holds, "within_deg": float(within)}
                key = _find_affected(around.references, parameters).tobytes()
                first, count = counted.get(key, (parameters, 0))
                counted[key] = first, count + 1
        total = sum(count for _, count in counted.values())
        return tuple(Trial(parameters, count / total) for parameters, count in counted.values())

    def missing(self, around: Surroundings) -> str | None:
        """Require references in this mode and in another one, since an offset of all of them cannot be seen."""
        forward_axes = set(around.references.forward) - {""}
        if BACKWARD not in forward_axes:
            return f"no reference is taken with {BACKWARD} forward"
        return None if len(forward_axes) > 1 else f"all references are taken with {BACKWARD} forward"


def _find_affected(references: References, parameters: Parameters) -> Mask:
    """Mark the references (m,) with the offset; where no axis flies forward, as before in the interval if it is carried on."""
    if references.heading is None:
        out = references.forward == BACKWARD
    else:
        within = np.deg2rad(float(parameters.get("within_deg", WITHIN_DEG)))
        # A reference that is nearer to flying sideways belongs to that mode.
        out = np.isin(references.forward, REVERSED_MODES) & (np.cos(references.heading) < -np.cos(within) - 1e-9)
    if parameters.get("holds") == "on":
        for row in range(1, len(out)):
            if references.forward[row] == "" and references.interval[row] == references.interval[row - 1]:
                out[row] = out[row - 1]
    return out


EFFECT = _ReferenceModeOffset(
    name="reference_mode_offset",
    summary="reference offset in -x forward against other modes",
    says="the reference attitude is off by {size} about {axis} in -x forward",
    unit="deg",
    stage="reference",
    prior=(1e-5, 10.0),
    bounds=(-90.0, 90.0),
    parameters=(
        Parameter("holds", "", "off", "in an inertial hold after -x forward", choices=HOLDS),
        Parameter("within_deg", "deg", WITHIN_DEG, "heading from -x up to which it acts", 0.0, 180.0),
    ),
    meaning="The reference attitude is offset when flying -x forward, as when another sensor head takes over.",
)
