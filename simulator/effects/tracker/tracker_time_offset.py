"""A star tracker's tags are late: the reference tagged t shows the attitude at t − size, e = size · ω.

dA/dt = −[ω×] A, so A(t − τ) = exp([ω τ×]) A(t) to first order in the change of ω over τ.
"""

from dataclasses import dataclass

import numpy as np

from simulator.arrays import Flags
from simulator.effects.base import Array, Parameters, References, Trackers
from simulator.effects.tracker.base import TrackerColumns


@dataclass(frozen=True)
class TrackerTimeOffset(TrackerColumns):
    """See the module."""

    def own_columns(self, references: References, seen: Trackers, own: Flags, parameters: Parameters) -> Array:
        """The rate about the tracker's axes."""
        return np.asarray(np.einsum("mij,mj->mi", seen.to_axes[own], seen.rates[own])[:, :, None])


EFFECT = TrackerTimeOffset(
    name="tracker_time_offset",
    summary="a star tracker's time tags are late",
    says="the time tags of star tracker {axis} are {size} {way}",
    ways=("late", "early"),
    unit="s",
    stage="reference",
    prior=(1e-4, 10.0),
    bounds=(-10.0, 10.0),
    meaning="The star tracker's tags are late: what is tagged t was seen at t − size.",
)
