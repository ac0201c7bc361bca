"""Convert a diagnosis to a scenario: the recording's own plan, simulated with the identified causes and the remainder.

Of a group the first cause is used, whose size and calibration are stated. Effects with columns have the joint posterior of
their amplitudes; a cause of the samples or a random process has an independent sigma of its size. Nonlinear parameters, such as
the time of a step, are fixed at their estimates. Random errors of the remainder are processes of the scenario, and its white
noise is that of the references. Families of errors outside the library cannot be simulated.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

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


class SizedEffect(NamedTuple):
    """An effect of a scenario and the error of its size."""

    setting: Setting
    rows: list[int]  # of its amplitudes in the joint posterior; empty where its size is independent of these
    sigma: float  # of its size, used without rows


@dataclass(frozen=True)
class Adoption:
    """Effects that are put into the simulator."""

    effects: tuple[Setting, ...]  # with their sizes; none without a named cause
    covariance: Array  # (k, k) of their amplitudes, effect after effect
    left_out: tuple[str, ...]  # causes that a replay cannot simulate, such as those of raw sensor tables
    reason: str  # why there are no effects, or ""
    # label of each cause that the recording cannot distinguish from others, and the labels of these
    instead: tuple[tuple[str, tuple[str, ...]], ...] = ()
    remainder: tuple[Setting, ...] = ()  # effects that simulate the remainder

    def sentence(self) -> str:
        """Describe what was written."""
        if not self.effects:
            return f"a scenario without effects: {self.reason}"
        remainder = [effect.label() for effect in self.remainder]
        causes = [effect.label() for effect in self.effects][: len(self.effects) - len(remainder)]
        note = f"{' and' if causes else ''} the remainder as {', '.join(remainder)}" if remainder else ""
        note += f"; {', '.join(self.left_out)} left out, which acts on raw sensor tables" if self.left_out else ""
        for label, others in self.instead:
            note += f"; this recording cannot tell {label} from {' or '.join(others)}, of which a copy of the file may have one"
        return f"a scenario with {', '.join(causes)}{note}"


def adopt_causes(diagnosis: Diagnosis) -> Adoption:
    """Collect the effects that a diagnosis names and those of its remainder, with the posterior of their amplitudes."""
    if not diagnosis.present:
        return Adoption((), np.empty((0, 0)), (), "there is no gap")
    named = diagnosis.causes if diagnosis.verdict in NAMING else ()
    flyable = [cause for cause in named if REGISTRY[cause.effect].stage != "sensor"]
    left_out = tuple(cause.label for cause in named if cause not in flyable)
    causes = [_locate_amplitudes(cause, diagnosis.amplitudes) for cause in flyable]
    remainder = list(list_remainder_effects(diagnosis, {cause.effect for cause in flyable}))
    covariance = _build_covariance([*causes, *remainder], diagnosis.amplitudes)
    effects = tuple(effect.setting for effect in (*causes, *remainder))
    reason = f"the cause is {diagnosis.verdict}" if not named else ""
    reason = reason or ("" if effects else "its causes act on raw sensor tables, which a replay keeps as they are")
    written = [replace(cause, named=True).label for cause in flyable]
    rivals = [tuple(rival for rival in cause.group if rival != label) for label, cause in zip(written, flyable, strict=True)]
    instead = tuple((label, others) for label, others in zip(written, rivals, strict=True) if others)
    return Adoption(effects, covariance, left_out, reason, instead, tuple(effect.setting for effect in remainder))


def _build_covariance(effects: Sequence[SizedEffect], amplitudes: Amplitudes) -> Array:
    """Build the covariance (k, k) of all effects' amplitudes in order; those outside the joint posterior are independent."""
    independent = len(amplitudes.labels)  # index of a row of zeros, appended to the joint covariance
    rows: list[int] = []
    variances: list[float] = []
    for effect in effects:
        count = REGISTRY[effect.setting.effect].amplitudes(effect.setting).size
        rows += effect.rows or [independent] * count
        variances += [] if effect.rows else [effect.sigma**2] * count
    covariance = np.pad(amplitudes.covariance, (0, 1))[np.ix_(rows, rows)]
    is_independent = np.array(rows) == independent
    covariance[is_independent, is_independent] = variances
    return covariance


def list_remainder_effects(diagnosis: Diagnosis, causes: set[str]) -> Iterator[SizedEffect]:
    """List the effects that simulate the remainder of a diagnosis.

    Parameters
    ----------
    diagnosis : the answer
    causes : names of the effects that are put in as causes
    """
    for member in diagnosis.details.unnamed:
        name, unit = PROCESSES.get(member.effect, (member.effect, 1.0))
        if member.size > 0 and name in REGISTRY and (member.process or member.effect in REGISTRY):
            known = {parameter.name for parameter in REGISTRY[name].parameters}
            parameters = {key: value for key, value in member.parameters.items() if key in known}
            yield SizedEffect(setting(name, member.axis, member.size / unit, parameters), [], member.sigma / unit)
    factor = 1.0 if diagnosis.remainder is None else diagnosis.remainder.noise_factor
    if abs(factor - 1) > LEAST_EXCESS and NOISE_EXCESS not in causes:
        yield SizedEffect(setting(NOISE_EXCESS, None, factor, {}), [], 0.0)


def write_adopted_scenario(diagnosis: Diagnosis, recording: Recording, folder: Path, out: Path) -> tuple[str, Adoption]:
    """Write the scenario as TOML text; also return its effects.

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


def _locate_amplitudes(cause: Cause, amplitudes: Amplitudes) -> SizedEffect:
    """Convert a cause to an effect of a scenario; its size is that of its amplitudes in the joint posterior, if it has them."""
    effect = REGISTRY[cause.effect]
    known = {parameter.name for parameter in effect.parameters}
    parameters = {name: value for name, value in cause.parameters.items() if name in known}
    adopted = setting(cause.effect, cause.axis, cause.size, parameters)
    rows = [k for k, label in enumerate(amplitudes.labels) if label == cause.label]
    if len(rows) != effect.amplitudes(adopted).size:
        return SizedEffect(adopted, [], cause.sigma)
    size, fitted = effect.from_amplitudes(amplitudes.values[rows])
    return SizedEffect(setting(cause.effect, cause.axis, size, {**parameters, **fitted}), rows, cause.sigma)
