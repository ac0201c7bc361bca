"""Unlisted effects in families, grouped by physics; nothing of the diagnosis imports them, and no registry holds them.

They were written from the physics of gyros, attitude sensors and telemetry, and not from a list of what a diagnosis names. Each
file can be given to ``--effects`` as it is.
"""

from studies.validation.world.families import (
    attitude,
    mechanical,
    onboard,
    optical,
    sightings,
    signal_processing,
    telemetry,
    thermal,
)
from studies.validation.world.families.base import Family

FAMILY_MODULES = (thermal, mechanical, optical, signal_processing, telemetry, attitude, onboard, sightings)
FAMILIES: dict[str, Family] = {one.name: one for module in FAMILY_MODULES for one in module.EFFECTS}

__all__ = ["FAMILIES", "Family"]
