"""A star tracker's boresight drifts with a temperature: e_s = (a_x, a_y, 0) (T − mean T), T a housekeeping column.

The column may be named; else one whose name ends in temperature_c is taken, a tracker's before others.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.effects.base import Array, Parameter, References, Surroundings, Trackers, Value
from simulator.effects.common import ARCSEC
from simulator.effects.directed import Directed
from simulator.effects.housekeeping import SUFFIX, temperature_column
from simulator.effects.tracker.base import TrackerColumns


@dataclass(frozen=True)
class TrackerThermal(TrackerColumns, Directed):
    """See the module."""

    def own_columns(
        self, references: References, seen: Trackers, own: NDArray[np.bool_], parameters: Mapping[str, Value]
    ) -> Array:
        """T − mean T across the boresight."""
        name = temperature_column(seen.housekeeping, str(parameters.get("column", "")), "tracker", self.name)
        T = seen.housekeeping[name][own]
        return ARCSEC * (T - T.mean())[:, None, None] * np.eye(3)[None, :, :2]

    def missing(self, around: Surroundings) -> str | None:
        """It needs a temperature."""
        seen = around.references.trackers
        if seen is not None and not any(name.endswith(SUFFIX) for name in seen.housekeeping):
            return f"the recording has no housekeeping column …{SUFFIX}"
        return super().missing(around)


EFFECT = TrackerThermal(
    name="tracker_thermal",
    summary="a star tracker's boresight drifts with a temperature",
    says="the boresight of star tracker {axis} drifts by {size} with a temperature",
    unit="arcsec per K",
    stage="reference",
    prior=(1e-3, 100.0),
    bounds=(-3600.0, 3600.0),
    parameters=(
        Parameter("column", "", "", "housekeeping column; a tracker's temperature if empty", choices=("*",)),
        Parameter("a_x", "arcsec per K", 1.0, "about the tracker's x; only the direction of the two counts"),
        Parameter("a_y", "arcsec per K", 0.0, "about y"),
    ),
    meaning="The star tracker's boresight turns in proportion to a temperature of the housekeeping data.",
)
