"""Stretches of a recording that were not measured: found, listed, and left out by import, calibration and diagnosis alike.

- `mask`: the list of such stretches and the recording without them.
- `gyro_faults`: gyros that are clipped or that stop.
- `reference_faults`: reference attitudes that freeze or jump.
"""

from gyrocal.masking.gyro_faults import mark_interval_samples
from gyrocal.masking.mask import DataMask, find_mask
from gyrocal.masking.stretch import MaskedStretch

__all__ = ["DataMask", "MaskedStretch", "find_mask", "mark_interval_samples"]
