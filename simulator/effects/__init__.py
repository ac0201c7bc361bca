"""Effects: what a real gyro or attitude sensor does and the baseline simulator does not, one per file.

Each owns itself (`simulator.effects.base`): where in the measuring chain it acts and what it does there, and how a diagnosis
tries it. `REGISTRY` holds all of them by name, `EFFECTS` those on gyro and references, `SENSOR_EFFECTS` in
`simulator.effects.sensor` those on sun and Earth sensors. `parse` makes a `Setting` from text and `setting` from its parts. A
positive size makes the gyro read high.
"""

from simulator.effects.base import (
    STAGES,
    Detection,
    Effect,
    Parameter,
    ProcessTimes,
    References,
    SampleView,
    Setting,
    Stream,
    Surroundings,
    Trial,
)
from simulator.effects.builtin import BUILT_IN
from simulator.effects.flight_mode import find_flight_directions
from simulator.effects.recording_view import extract_references, extract_stream, extract_surroundings
from simulator.effects.registry import ALL_EFFECTS, EFFECTS, REGISTRY, Registry
from simulator.effects.settings import parse, setting, tabulate_setting

__all__ = [
    "ALL_EFFECTS",
    "BUILT_IN",
    "EFFECTS",
    "REGISTRY",
    "STAGES",
    "Detection",
    "Effect",
    "Parameter",
    "ProcessTimes",
    "References",
    "Registry",
    "SampleView",
    "Setting",
    "Stream",
    "Surroundings",
    "Trial",
    "extract_references",
    "extract_stream",
    "extract_surroundings",
    "find_flight_directions",
    "parse",
    "setting",
    "tabulate_setting",
]
