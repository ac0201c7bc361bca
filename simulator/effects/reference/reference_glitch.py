"""Single references, or up to three in a row, that are off by a large random rotation about all axes.

A camera that swaps or loses markers, a star tracker that matches wrong stars. Groups come at random, of one to three references
each, until they are this share of all; a group is off by size · U(0.5, 1.5) in a random direction. These references carry no
attitude, and the mask of a recording (`gyrocal.masking`) leaves them out.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, References, Setting
from simulator.effects.common import DEG, number
from simulator.truth.rotation import apply_rotation_errors

LONGEST_GLITCH_GROUP = 3  # references of a group


class ReferenceGlitch(Effect):
    """See the module."""

    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        """Groups that are off, never at an interval's ends."""
        count = references.t_s.size
        share = number(setting.parameters, "fraction")
        edge = np.zeros(count, dtype=bool)
        for interval in np.unique(references.interval):
            own = np.flatnonzero(references.interval == interval)
            edge[own[[0, -1]]] = True
        off = np.zeros((count, 3))
        begins = np.flatnonzero(rng.random(count) < 2 * share / (LONGEST_GLITCH_GROUP + 1))  # two references a group on average
        for begin in begins:
            direction = rng.standard_normal(3)
            e = setting.size * DEG * rng.uniform(0.5, 1.5) * direction / np.linalg.norm(direction)
            off[begin : begin + int(rng.integers(1, LONGEST_GLITCH_GROUP + 1))] = e
        off[edge] = 0.0
        out, rows = quaternions.copy(), off.any(axis=1)
        out[rows] = apply_rotation_errors(quaternions[rows], off[rows])
        return out


EFFECT = ReferenceGlitch(
    name="reference_glitch",
    summary="single references off by a large random rotation",
    says="single references are off by {size} on average",
    unit="deg",
    stage="reference_telemetry",
    prior=(1e-3, 180.0),
    bounds=(0.0, 180.0),
    axes=(),
    parameters=(Parameter("fraction", "", 0.01, "share of the references that are off", 0.0, 0.3),),
    meaning="Single references, or up to three in a row, are off by a large random rotation, as when markers are swapped.",
    sign="positive",
)
