"""Effects: what a real gyro or attitude sensor does and the baseline simulator does not, one per file.

Each has a name, a unit, a plausible range and the form in which simulator and diagnosis use it (`simulator.effects.base`).
`EFFECTS` holds all of them by name, `parse` makes a `Setting` from text and `setting` from its parts. A positive size makes
the gyro read high.
"""

from simulator.effects.base import Effect, Parameter, References, Setting, Stream
from simulator.effects.recorded import forward_axes, references_of, stream_of
from simulator.effects.registry import EFFECTS, described, parse, setting

__all__ = [
    "EFFECTS",
    "Effect",
    "Parameter",
    "References",
    "Setting",
    "Stream",
    "described",
    "forward_axes",
    "parse",
    "references_of",
    "setting",
    "stream_of",
]
