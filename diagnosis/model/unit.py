"""Several recordings of one sensor unit as one, and their common linear model.

What the recordings of a unit share are G and b and the sizes of the effects; each has its own start attitudes and noise. The
intervals of a recording are independent already, so recordings of a unit side by side are one recording with more intervals:
its linear model has the whitened rows of all, one under the other, with common nuisance parameters and common amplitudes.
Random processes and steps run on in time as they would within one recording.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import pairwise

import numpy as np
import pandas as pd
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.candidates import build_linear_model
from diagnosis.model.folds import build_folds
from diagnosis.model.groups import CandidateColumns
from diagnosis.model.linear import LinearModel, SelectedCandidate
from diagnosis.model.recording_model import RecordingModel
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.errors import InputError
from gyrocal.recording import Recording
from simulator.effects.base import Effect

Array = NDArray[np.float64]

UNIT_SPLIT = "a recording at a time"


@dataclass(frozen=True)
class UnitSettings:
    """Constants of `diagnosis.model.unit`."""

    apart_s: float = 600.0  # between recordings whose times overlap, such as those of trials that all begin at zero


SETTINGS = UnitSettings()


@dataclass(frozen=True)
class Unit:
    """Recordings of one sensor unit.

    Attributes
    ----------
    recording : all of them as one
    owner : name of the one that each of its intervals comes from
    """

    recording: Recording
    owner: tuple[str, ...]


def join_recordings(recordings: Mapping[str, Recording]) -> Unit:
    """Recordings of one sensor unit side by side.

    Parameters
    ----------
    recordings : by name; intervals are named "recording: interval". Their epochs place them in time; where that would make
        them overlap, each follows the one before after `APART_S`. The angle random walk is the root mean square of theirs

    Raises
    ------
    InputError
        The samples of two recordings differ in length, or their references are of other sensors.
    """
    parts = list(recordings.values())
    first = parts[0]
    if any(abs(part.gyro.sample_s - first.gyro.sample_s) > 1e-9 for part in parts):
        raise InputError("recordings of one unit must have samples of one length")
    sensors = [[one.name for one in part.attitudes.sensors] for part in parts]
    if any(names != sensors[0] for names in sensors):
        raise InputError("references of recordings of one unit must be of the same star trackers, or all of one sensor")
    shifts = _compute_time_shifts(parts)
    gyro = replace(
        first.gyro,
        t_s=np.concatenate([part.gyro.t_s + shift for part, shift in zip(parts, shifts, strict=True)]),
        rates=np.concatenate([part.gyro.rates for part in parts]),
        arw=float(np.sqrt(np.mean([part.gyro.arw**2 for part in parts]))),
    )
    attitudes = replace(
        first.attitudes,
        t_s=np.concatenate([part.attitudes.t_s + shift for part, shift in zip(parts, shifts, strict=True)]),
        quaternions=np.concatenate([part.attitudes.quaternions for part in parts]),
        sigma=np.concatenate([part.attitudes.sigma for part in parts]),
        sensor=None if first.attitudes.sensor is None else np.concatenate([part.attitudes.sensor for part in parts]),
    )
    intervals, owner = [], []
    for (name, part), shift in zip(recordings.items(), shifts, strict=True):
        for one in part.intervals:
            moved = replace(one, name=f"{name}: {one.name}", start_s=one.start_s + shift, stop_s=one.stop_s + shift)
            intervals.append(moved)
            owner.append(name)
    tables = {
        name: pd.concat(
            [part.tables[name].assign(t_s=part.tables[name]["t_s"] + shift) for part, shift in zip(parts, shifts, strict=True)],
            ignore_index=True,
        )
        for name in first.tables
        if all(name in part.tables for part in parts)
    }
    whole = replace(
        first,
        title=" + ".join(recordings),
        gyro=gyro,
        attitudes=attitudes,
        intervals=tuple(intervals),
        tables=tables,
        sensors=None,
    )
    return Unit(whole, tuple(owner))


def _compute_time_shifts(parts: Sequence[Recording]) -> list[float]:
    """Compute the shift added to the times of each recording, s."""
    epochs = [datetime.fromisoformat(part.epoch) for part in parts]
    shifts = [(epoch - epochs[0]).total_seconds() for epoch in epochs]
    spans = [(part.gyro.t_s[0] + s, part.gyro.t_s[-1] + part.gyro.sample_s + s) for part, s in zip(parts, shifts, strict=True)]
    if all(low >= stop for (_, stop), (low, _) in pairwise(spans)):
        return shifts
    shifts, stop = [], float(parts[0].gyro.t_s[0])
    for part in parts:
        shifts.append(stop - float(part.gyro.t_s[0]))
        stop += float(np.ptp(part.gyro.t_s)) + SETTINGS.apart_s
    return shifts


def build_unit_model(
    model: RecordingModel,
    owner: Sequence[str],
    effects: Sequence[Effect],
    further: Iterable[CandidateColumns] = (),
    settings: DiagnosisSettings = DEFAULT,
    rivals: bool = True,
    own_bias: bool = False,
) -> LinearModel:
    """The common linear model of a unit's recordings; whole recordings are held out.

    Parameters
    ----------
    model : the joined recording, linearised
    owner : which recording each of its intervals comes from
    effects, further, settings, rivals : as in `diagnosis.model.candidates.build_linear_model`
    own_bias : whether each recording has a bias of its own
    """
    linear = build_linear_model(model, effects, further, settings, rivals)
    names = np.array(owner)[[block.interval for block in model.blocks]]
    part = np.unique(names, return_inverse=True)[1][model.observation_block]
    own = build_own_biases(model, names) if own_bias else np.empty((model.size, 0))
    basis = scipy.linalg.orth(model.project_out_nuisance(own)) if own_bias else own

    def project_with_biases(columns: Array) -> Array:
        seen = model.project_out_nuisance(columns)
        return np.asarray(seen - basis @ (basis.T @ seen))

    def refine(current: LinearModel, member: SelectedCandidate) -> LinearModel:
        finer = linear.refine(current, member)
        return finer if finer is current else replace(finer, X=project_with_biases(finer.W[:, :]))

    return replace(
        linear,
        y=project_with_biases(linear.y),
        X=project_with_biases(linear.W[:, :]),
        projected=project_with_biases,
        dof=linear.dof - basis.shape[1],
        split=UNIT_SPLIT,
        folds=lambda W: build_folds(model, W, part, own),
        refine=refine,
    )


def build_own_biases(model: RecordingModel, names: NDArray[np.str_]) -> Array:
    """(N, 3 recordings) whitened columns of a bias of each recording."""
    kinds = np.unique(names)
    error = np.zeros((model.t_s.size, 3, 3 * kinds.size))
    for block, name in zip(model.blocks, names, strict=True):
        place = 3 * int(np.searchsorted(kinds, name))
        error[block.steps, :, place : place + 3] = np.eye(3)
    return model.whiten(model.observe_rate_error(error))
