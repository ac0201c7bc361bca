"""A star tracker does not take out the aberration of light; the size is the share that is left in, one for all of it.

Seen with the velocity v, stars stand nearer to where it goes: u' = u + (v − (u·v) u)/c, a turn of the sky by u × v/c. Near the
boresight b a tracker takes that for the attitude A exp([(b × v/c)×]), so that e = A (b × v)/c; about its own axes, of which z
is the boresight, e_s = (−v_y, v_x, 0)/c. On a low orbit 5" turn with the velocity, and 20.5" with the Earth about the Sun.
"""

from dataclasses import dataclass

import numpy as np

from simulator.arrays import Flags
from simulator.effects.base import Array, Parameter, Parameters, References, Surroundings, Trackers
from simulator.effects.tracker.base import TrackerColumns
from simulator.truth.rotation import convert_to_matrix

ABERRATION_PARTS = ("both", "orbital", "annual")


@dataclass(frozen=True)
class TrackerAberration(TrackerColumns):
    """See the module."""

    def own_columns(self, references: References, seen: Trackers, own: Flags, parameters: Parameters) -> Array:
        """All of it."""
        part = parameters.get("part", ABERRATION_PARTS[0])
        v = np.zeros((int(own.sum()), 3))
        for name, velocity in (("orbital", seen.orbital), ("annual", seen.annual)):
            if part in ("both", name):
                v = v + velocity[own]
        x, y, _ = np.einsum("mij,mjk,mk->mi", seen.to_axes[own], convert_to_matrix(references.quaternions[own]), v).T
        return np.stack([-y, x, np.zeros(x.size)], axis=1)[:, :, None]

    def missing(self, around: Surroundings) -> str | None:
        """It needs the velocity."""
        seen = around.references.trackers
        if seen is not None and not np.isfinite(seen.orbital).all():
            return "the recording does not state raan_deg and argument_of_latitude_deg of its orbit"
        return super().missing(around)


EFFECT = TrackerAberration(
    name="tracker_aberration",
    summary="a star tracker does not take out the aberration of light",
    says="star tracker {axis} leaves {size} the aberration of light in",
    unit="of it",
    stage="reference",
    prior=(0.02, 5.0),
    bounds=(-10.0, 10.0),
    parameters=(
        Parameter(
            "part",
            "",
            ABERRATION_PARTS[0],
            "of the orbit, of the Earth about the Sun, or both",
            choices=ABERRATION_PARTS,
            tried=ABERRATION_PARTS,
        ),
    ),
    meaning="The star tracker's attitude errs by the aberration of light, or a share of it, which should have been taken out.",
)
