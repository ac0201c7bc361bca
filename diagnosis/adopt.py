"""The scenario that a diagnosis stands for: the recording's own plan, flown with the causes that were found and the remainder.

Of a group the first cause is put in, whose size and calibration are stated. Effects that have columns bring the joint posterior
of their amplitudes; of one that the samples show, or of a random process, the size has a sigma and correlates with nothing.
Nonlinear parameters, such as the time of a step, are held as found. Random errors of the remainder are processes of the
scenario, and white noise beside them is that of the references. Families of errors outside the library cannot be simulated.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from diagnosis.answer import Amplitudes, Cause
from diagnosis.model.processes import BIAS_WANDERS, REFERENCES_WANDER, TAGS_WANDER
from diagnosis.result import Diagnosis
from gyrocal.arrays import Array
from gyrocal.recording import Recording
from simulator.adopted_scenario import format_adopted, hash_recording
from simulator.effects import REGISTRY, Setting, setting

NAMING = ("named", "group", "partial")  # verdicts whose causes are put into a scenario
PROCESSES = {  # random errors without a name: the effect that simulates them, and its unit in rad or s
    BIAS_WANDERS: ("bias_markov", np.deg2rad(1 / 3600)),
    REFERENCES_WANDER: ("reference_correlated", np.deg2rad(1)),
    TAGS_WANDER: ("clock_wander", 1.0),
}
NOISE_EXCESS = "reference_noise_excess"
LEAST_EXCESS = 0.1  # of the white noise, by which it differs from the stated one


@dataclass(frozen=True)
class Adoption:
    """What is put into the simulator."""

    effects: tuple[Setting, ...]  # with their sizes; none without a named cause
    covariance: Array  # (k, k) of their amplitudes, effect after effect
    left_out: tuple[str, ...]  # causes that a replay cannot fly, such as those of raw sensor tables
    reason: str  # why there are no effects, or ""
    # of each cause that the recording cannot tell from others, its label and theirs
    instead: tuple[tuple[str, tuple[str, ...]], ...] = ()
    remainder: tuple[Setting, ...] = ()  # effects for what no cause explains

    def sentence(self) -> str:
        """Describe what was written."""
        if not self.effects:
            return f"a scenario without effects: {self.reason}"
        rest = [remaining.label() for remaining in self.remainder]
        causes = [effect.label() for effect in self.effects][: len(self.effects) - len(rest)]
        note = f"{' and' if causes else ''} the remainder as {', '.join(rest)}" if rest else ""
        note += f"; {', '.join(self.left_out)} left out, which acts on raw sensor tables" if self.left_out else ""
        for label, others in self.instead:
            note += f"; this recording cannot tell {label} from {' or '.join(others)}, of which a copy of the file may have one"
        return f"a scenario with {', '.join(causes)}{note}"


def adopt_causes(diagnosis: Diagnosis) -> Adoption:
    """The effects that a diagnosis names and those of its remainder, and the posterior of their amplitudes."""
    if not diagnosis.present:
        return Adoption((), np.empty((0, 0)), (), "there is no gap")
    named = diagnosis.causes if diagnosis.verdict in NAMING else ()
    flyable = [cause for cause in named if REGISTRY[cause.effect].stage != "sensor"]
    left_out = tuple(cause.label for cause in named if cause not in flyable)
    parts = [_locate_amplitudes(cause, diagnosis.amplitudes) for cause in flyable]
    remainder = tuple(list_remainder_effects(diagnosis, {cause.effect for cause in flyable}))
    effects = (*(part for part, _, _ in parts), *(part for part, _ in remainder))
    parts += [(part, [], sigma) for part, sigma in remainder]
    independent = len(diagnosis.amplitudes.labels)
    counts = [REGISTRY[effect.effect].amplitudes(effect).size for effect in effects]
    rows = [row for (_, places, _), count in zip(parts, counts, strict=True) for row in places or [independent] * count]
    covariance = np.pad(diagnosis.amplitudes.covariance, (0, 1))[np.ix_(rows, rows)]
    alone = [sigma for (_, places, sigma), count in zip(parts, counts, strict=True) if not places for _ in range(count)]
    covariance[np.array(rows) == independent, np.array(rows) == independent] = np.square(alone)
    reason = f"the cause is {diagnosis.verdict}" if not named else ""
    reason = reason or ("" if effects else "its causes act on raw sensor tables, which a replay keeps as they are")
    written = [replace(cause, named=True).label for cause in flyable]
    others = [
        (label, tuple(part for part in cause.group if part != label)) for label, cause in zip(written, flyable, strict=True)
    ]
    instead = tuple(part for part in others if part[1])
    return Adoption(effects, covariance, left_out, reason, instead, tuple(part for part, _ in remainder))


def list_remainder_effects(diagnosis: Diagnosis, causes: set[str]) -> Iterator[tuple[Setting, float]]:
    """List the effects that simulate the remainder of a diagnosis with the sigmas of their sizes.

    Parameters
    ----------
    diagnosis : the answer
    causes : names of the effects that are put in as causes
    """
    for member in diagnosis.details.beside:
        name, unit = PROCESSES.get(member.effect, (member.effect, 1.0))
        if member.size > 0 and name in REGISTRY and (member.process or member.effect in REGISTRY):
            known = {parameter.name for parameter in REGISTRY[name].parameters}
            parameters = {key: value for key, value in member.parameters.items() if key in known}
            yield setting(name, member.axis, member.size / unit, parameters), member.sigma / unit
    factor = 1.0 if diagnosis.remainder is None else diagnosis.remainder.noise_factor
    if abs(factor - 1) > LEAST_EXCESS and NOISE_EXCESS not in causes:
        yield setting(NOISE_EXCESS, None, factor, {}), 0.0


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
    title = f"{recording.title}, {' with '.join(['simulated again', *(effect.label() for effect in adoption.effects)])}"
    G, bias = diagnosis.G, diagnosis.bias
    return format_adopted(title, where, hash_recording(recording), G, bias, adoption.effects, adoption.covariance), adoption


def _locate_amplitudes(cause: Cause, amplitudes: Amplitudes) -> tuple[Setting, list[int], float]:
    """The setting of a cause, the places of its amplitudes among those found, and its sigma where there are none."""
    effect = REGISTRY[cause.effect]
    known = {parameter.name for parameter in effect.parameters}
    parameters = {name: value for name, value in cause.parameters.items() if name in known}
    made = setting(cause.effect, cause.axis, cause.size, parameters)
    places = [k for k, label in enumerate(amplitudes.labels) if label == cause.label]
    if len(places) != effect.amplitudes(made).size:
        return made, [], cause.sigma
    size, held = effect.from_amplitudes(amplitudes.values[places])
    return setting(cause.effect, cause.axis, size, {**parameters, **held}), places, cause.sigma
