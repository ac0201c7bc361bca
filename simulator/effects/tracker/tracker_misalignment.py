"""A star tracker is turned from its stated mounting: M_true = exp([m×]) M, a constant error e_s = m about its own axes.

The first tracker defines the axes of the body: its m is zero. Where the mounting is estimated it is no effect but a parameter.
"""

from dataclasses import dataclass

import numpy as np

from simulator.arrays import Flags
from simulator.effects.base import Array, Parameter, Parameters, References, Trackers
from simulator.effects.common import RAD_PER_ARCSEC
from simulator.effects.directed_effect import DirectedEffect
from simulator.effects.tracker.base import TrackerColumns


@dataclass(frozen=True)
class TrackerMisalignment(TrackerColumns, DirectedEffect):
    """See the module."""

    def trackers(self, seen: Trackers) -> tuple[str, ...]:
        """All but the first."""
        return seen.names[1:]

    def own_columns(self, references: References, seen: Trackers, own: Flags, parameters: Parameters) -> Array:
        """One about each axis."""
        return np.broadcast_to(RAD_PER_ARCSEC * np.eye(3), (int(own.sum()), 3, 3))


EFFECT = TrackerMisalignment(
    name="tracker_misalignment",
    summary="a star tracker is turned from its stated mounting",
    says="star tracker {axis} is turned by {size} from its stated mounting",
    unit="arcsec",
    stage="reference",
    prior=(0.05, 7200.0),
    bounds=(-36000.0, 36000.0),
    parameters=(
        Parameter("m_x_arcsec", "arcsec", 1.0, "about the tracker's x; only the direction of the three counts"),
        Parameter("m_y_arcsec", "arcsec", 0.0, "about y"),
        Parameter("m_z_arcsec", "arcsec", 0.0, "about z, the boresight"),
    ),
    meaning="The star tracker is turned by a constant angle from the mounting that the recording states.",
)
