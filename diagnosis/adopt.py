"""The scenario that a diagnosis stands for: the recording's own plan, flown with the effects that were named.

Only a verdict that names effects puts any in: of a group the first, whose size and calibration are stated. Effects that have
columns bring the joint posterior of their amplitudes; of one that the samples show, or of a random process, the size has
a sigma and correlates with nothing. Nonlinear parameters, such as the time of a step, are held as found.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagnosis.answer import Amplitudes, Cause
from diagnosis.result import Diagnosis
from gyrocal.recording import Recording
from simulator.adopted_scenario import format_adopted, hash_recording
from simulator.effects import REGISTRY, Setting, setting

Array = NDArray[np.float64]

NAMING = ("named", "group", "partial")  # verdicts whose causes are put into a scenario


@dataclass(frozen=True)
class Adoption:
    """What is put into the simulator."""

    effects: tuple[Setting, ...]  # with their sizes; none without a named cause
    covariance: Array  # (k, k) of their amplitudes, effect after effect
    left_out: tuple[str, ...]  # causes that a replay cannot fly, such as those of raw sensor tables
    reason: str  # why there are no effects, or ""
    # of each cause that the recording cannot tell from others, its label and theirs
    instead: tuple[tuple[str, tuple[str, ...]], ...] = ()

    def sentence(self) -> str:
        """Describe what was written."""
        if not self.effects:
            return f"a scenario without effects: {self.reason}"
        note = f"; {', '.join(self.left_out)} left out, which acts on raw sensor tables" if self.left_out else ""
        for label, others in self.instead:
            note += f"; this recording cannot tell {label} from {' or '.join(others)}, of which a copy of the file may have one"
        return f"a scenario with {', '.join(one.label() for one in self.effects)}{note}"


def adopt_causes(diagnosis: Diagnosis) -> Adoption:
    """The effects that a diagnosis names, and the posterior of their amplitudes."""
    if diagnosis.verdict not in NAMING:
        reason = "there is no gap" if diagnosis.verdict == "none" else f"the cause is {diagnosis.verdict}"
        return Adoption((), np.empty((0, 0)), (), reason)
    flyable = [cause for cause in diagnosis.causes if REGISTRY[cause.effect].stage != "sensor"]
    left_out = tuple(cause.label for cause in diagnosis.causes if cause not in flyable)
    parts = [_locate_amplitudes(cause, diagnosis.amplitudes) for cause in flyable]
    effects = tuple(one for one, _, _ in parts)
    independent = len(diagnosis.amplitudes.labels)
    rows = [row for _, places, _ in parts for row in places or [independent]]
    covariance = np.pad(diagnosis.amplitudes.covariance, (0, 1))[np.ix_(rows, rows)]
    alone = [sigma for _, places, sigma in parts if not places]
    covariance[np.array(rows) == independent, np.array(rows) == independent] = np.square(alone)
    reason = "" if effects else "its causes act on raw sensor tables, which a replay keeps as they are"
    others = [(cause.label, tuple(one for one in cause.group if one != cause.label)) for cause in flyable]
    return Adoption(effects, covariance, left_out, reason, tuple(one for one in others if one[1]))


def write_adopted_scenario(diagnosis: Diagnosis, recording: Recording, folder: Path, out: Path) -> tuple[str, Adoption]:
    """The scenario as TOML, and what is in it.

    Parameters
    ----------
    diagnosis : of the recording
    recording : as diagnosed
    folder : the recording's
    out : the file that the text is for; it names the recording's folder relative to its own
    """
    adoption = adopt_causes(diagnosis)
    where = os.path.relpath(folder.resolve(), out.resolve().parent)
    title = f"{recording.title}, {' with '.join(['simulated again', *(one.label() for one in adoption.effects)])}"
    G, bias = diagnosis.G, diagnosis.bias
    return format_adopted(title, where, hash_recording(recording), G, bias, adoption.effects, adoption.covariance), adoption


def _locate_amplitudes(cause: Cause, found: Amplitudes) -> tuple[Setting, list[int], float]:
    """The setting of a cause, the places of its amplitudes among those found, and its sigma where there are none."""
    effect = REGISTRY[cause.effect]
    known = {parameter.name for parameter in effect.parameters}
    parameters = {name: value for name, value in cause.parameters.items() if name in known}
    made = setting(cause.effect, cause.axis, cause.size, parameters)
    places = [k for k, label in enumerate(found.labels) if label == cause.label]
    if len(places) != effect.amplitudes(made).size:
        return made, [], cause.sigma
    size, held = effect.from_amplitudes(found.values[places])
    return setting(cause.effect, cause.axis, size, {**parameters, **held}), places, cause.sigma
