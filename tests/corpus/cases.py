"""One bad input: a command line, and what is done to a good recording before it is run."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

REFUSED, JUDGED, FREE = "refused", "judged", "free"


def nothing(folder: Path) -> None:
    """Leave the recording as it is."""


@dataclass(frozen=True)
class Bad:
    """A bad input.

    Attributes
    ----------
    family : kind of input
    name : what is wrong
    arguments : of the command line; REC is the recording, OUT a new folder, TMP the folder of both
    damage : what is done to TMP before, where the recording lies in TMP/REC
    expected : REFUSED must end in one line and status 2; JUDGED may also be answered, if the calibration is right within
        its sigmas or its misfit is told; FREE may also be answered, for what is unusual and not wrong
    scenario : that the good recording is of
    """

    family: str
    name: str
    arguments: tuple[str, ...]
    damage: Callable[[Path], object] = nothing
    expected: str = REFUSED
    scenario: str = "trmm_series"
