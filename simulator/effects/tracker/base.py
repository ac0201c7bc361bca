"""What effects of one of several star trackers have in common: the tracker's name stands in the place of an axis.

An effect says its error about the tracker's own axes, e_s; that of the body attitude is e = Mᵀ e_s, M the mounting. With two
trackers only their difference shows an error that does not move as a body could, and which of them errs is then not told: the
answer is a group of both. The gyro tells whose it is where the error changes faster than the gyro wanders.
"""

from dataclasses import dataclass

import numpy as np

from gyrocal.errors import InputError
from simulator.arrays import Flags
from simulator.effects.base import Array, Effect, Parameters, References, Surroundings, Trackers, mark_absent


def find_tracker_rows(references: References, name: str, effect: Effect) -> Flags:
    """(m,) which references are of a tracker; an `InputError` where there is none of that name."""
    seen = references.trackers
    if seen is None or name not in seen.names:
        there = "references of one sensor only" if seen is None else ", ".join(seen.names)
        raise InputError(f"{effect.name}:{name}: no star tracker {name}; there are {there}")
    return np.asarray(seen.sensor == seen.names.index(name))


@dataclass(frozen=True)
class TrackerEffect(Effect):
    """An effect of one tracker."""

    axes: tuple[str, ...] = ()
    of_trackers: bool = True

    def trackers(self, seen: Trackers) -> tuple[str, ...]:
        """Names of those that it may act on."""
        return seen.names

    def missing(self, around: Surroundings) -> str | None:
        """It needs several sensors."""
        return None if around.references.trackers is not None else "the references are not of several star trackers"


@dataclass(frozen=True)
class TrackerColumns(TrackerEffect):
    """An effect of one tracker that is a sum of columns."""

    @mark_absent
    def own_columns(self, references: References, seen: Trackers, own: Flags, parameters: Parameters) -> Array:
        """Error about the tracker's axes per unit of each amplitude, of its own references, (rows, 3, k) rad."""
        raise NotImplementedError(f"{self.name} has no columns")

    def reference_columns(self, references: References, axis: str | None, parameters: Parameters) -> Array:
        """Columns in body axes, zero for the other trackers' references."""
        own, seen = find_tracker_rows(references, str(axis), self), references.trackers
        assert seen is not None
        if axis not in self.trackers(seen):
            raise InputError(
                f"{self.name}:{axis}: {axis} defines the axes of the body; name another one of {', '.join(seen.names)}"
            )
        values = self.own_columns(references, seen, own, parameters)
        out = np.zeros((own.size, *values.shape[1:]))
        out[own] = np.einsum("mji,mjk->mik", seen.to_axes[own], values)
        return out
