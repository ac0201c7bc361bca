"""A star tracker's boresight drifts with a temperature: e_s = (a_x, a_y, 0) (T − mean T), T a housekeeping column.

The column may be named; else one whose name ends in temperature_c is taken, a tracker's before others.
"""

from dataclasses import dataclass

import numpy as np

from simulator.arrays import Flags
from simulator.effects.base import Array, Parameter, Parameters, References, Surroundings, Trackers
from simulator.effects.common import RAD_PER_ARCSEC
from simulator.effects.directed_effect import DirectedEffect
from simulator.effects.housekeeping_columns import find_temperature, make_temperature_parameter, no_temperature
from simulator.effects.tracker.base import TrackerColumns


@dataclass(frozen=True)
class TrackerThermal(TrackerColumns, DirectedEffect):
    """See the module."""

    def own_columns(self, references: References, seen: Trackers, own: Flags, parameters: Parameters) -> Array:
        """T − mean T across the boresight."""
        T = find_temperature(seen.housekeeping, parameters, "tracker", self.name)[own]
        return RAD_PER_ARCSEC * (T - T.mean())[:, None, None] * np.eye(3)[None, :, :2]

    def missing(self, around: Surroundings) -> str | None:
        """It needs a temperature."""
        seen = around.references.trackers
        return super().missing(around) if seen is None else no_temperature(seen.housekeeping)


EFFECT = TrackerThermal(
    name="tracker_thermal",
    summary="a star tracker's boresight drifts with a temperature",
    says="the boresight of star tracker {axis} drifts by {size} with a temperature",
    unit="arcsec per K",
    stage="reference",
    prior=(1e-3, 100.0),
    bounds=(-3600.0, 3600.0),
    parameters=(
        make_temperature_parameter("a tracker's"),
        Parameter("a_x", "arcsec per K", 1.0, "about the tracker's x; only the direction of the two counts"),
        Parameter("a_y", "arcsec per K", 0.0, "about y"),
    ),
    meaning="The star tracker's boresight turns in proportion to a temperature of the housekeeping data.",
)
