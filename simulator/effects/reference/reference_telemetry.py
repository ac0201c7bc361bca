"""References that are repeated or falsified. They carry no attitude; the mask of a recording (`gyrocal.masking`) omits them.

reference_freeze
    A camera or a filter that hangs puts out its last result again: references from begin_s to begin_s + size show the one
    before begin_s, within its interval.
reference_glitch
    A camera that swaps or loses markers, a star tracker that matches wrong stars. Groups come at random, of one to three
    references each and never at an interval's ends, until they are this share of all; a group is off by size · U(0.5, 1.5) in a
    random direction.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, References, Setting
from simulator.effects.common import DEG, number
from simulator.truth.rotation import apply_rotation_errors

LONGEST_GLITCH_GROUP = 3  # references of a group


class _ReferenceFreeze(Effect):
    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        begin = number(setting.parameters, "begin_s")
        frozen = (references.t_s >= begin) & (references.t_s < begin + setting.size)
        out = quaternions.copy()
        for interval in np.unique(references.interval[frozen]):
            members = references.interval == interval
            before = np.flatnonzero(members & (references.t_s < begin))
            if before.size:
                out[members & frozen] = quaternions[before[np.argmax(references.t_s[before])]]
        return out


class _ReferenceGlitch(Effect):
    def replace_references(
        self, rng: np.random.Generator, quaternions: Array, references: References, setting: Setting
    ) -> Array:
        count = references.t_s.size
        fraction = number(setting.parameters, "fraction")
        at_ends = np.zeros(count, dtype=bool)
        for interval in np.unique(references.interval):
            members = np.flatnonzero(references.interval == interval)
            at_ends[members[[0, -1]]] = True
        errors = np.zeros((count, 3))
        groups = 2 * fraction / (LONGEST_GLITCH_GROUP + 1)  # two references a group on average
        for begin in np.flatnonzero(rng.random(count) < groups):
            direction = rng.standard_normal(3)
            e = setting.size * DEG * rng.uniform(0.5, 1.5) * direction / np.linalg.norm(direction)
            errors[begin : begin + int(rng.integers(1, LONGEST_GLITCH_GROUP + 1))] = e
        errors[at_ends] = 0.0
        out, rows = quaternions.copy(), errors.any(axis=1)
        out[rows] = apply_rotation_errors(quaternions[rows], errors[rows])
        return out


EFFECTS = [
    _ReferenceFreeze(
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
    ),
    _ReferenceGlitch(
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
    ),
]
