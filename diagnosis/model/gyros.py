"""The linear model of several gyros: their parity beside the attitude, and every effect gyro by gyro.

Where gyro i reads high by f(t), the body rates G ω_raw are high by G_i f, which the attitude shows, and the parity by V_i f,
which shows without any attitude. Both are observations of one linear model: attitude rows, then parity rows, whose noise is
uncorrelated (`gyrocal.recording.gyros`). What is not of one gyro – errors of the references, late tags of all of them – adds
nothing to the parity. Without reference attitudes there are parity rows only.

Four gyros have one parity residual, in which constant errors of any of them look alike; five or more tell them apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import folds, groups, processes
from diagnosis.model.array_model import ArrayModel
from diagnosis.model.candidates import place_candidates
from diagnosis.model.groups import CandidateColumns
from diagnosis.model.linear import Fold, LinearModel, SelectedCandidate
from diagnosis.model.process_projection import ProcessProjection
from diagnosis.model.steps import add_finer_times
from diagnosis.settings import DiagnosisSettings
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from simulator.effects.base import Effect
from simulator.effects.common import markov
from simulator.effects.gyros import is_axis_independent

Array = NDArray[np.float64]

BY_ROW = ("train_y", "train_X", "left_y", "left_X", "owner")  # of a fold


# ---- candidates ----------------------------------------------------------------------------------------------------------


def build_array_model(model: ArrayModel, effects: Sequence[Effect], settings: DiagnosisSettings) -> LinearModel:
    """Build the linear model of several gyros: effects of each, of the references, and unlisted rivals of both."""
    of_gyros = {effect.name: effect for effect in effects if effect.axes and is_axis_independent(effect)}
    offered = list(list_gyro_groups(model, list(of_gyros.values())))
    if model.body is not None:
        common = [effect for effect in effects if effect.on_references or not effect.axes]
        below = ((0, model.parity.size), (0, 0))  # no parity shows these
        for one in (
            *groups.list_effect_groups(model.body, common, None),
            *groups.list_alternative_groups(model.body, {}, common),
        ):
            offered.append(replace(one, columns=[np.pad(part, below) for part in one.columns]))
    found, W = place_candidates(offered, model.project_out_nuisance, settings, model.size)
    return LinearModel(
        y=model.y,
        X=model.project_out_nuisance(W),
        W=W,
        candidates=found,
        dof=model.degrees_of_freedom,
        projected=model.project_out_nuisance,
        most_effects=settings.largest_set,
        split=folds.RECORDING_SPLIT,
        folds=lambda W: fold_array(model, W),
        refine=lambda linear, member: refine_steps(model, linear, member, of_gyros),
    )


def list_gyro_groups(model: ArrayModel, effects: Sequence[Effect]) -> Iterator[CandidateColumns]:
    """List effects with columns or a covariance on each gyro, and the unlisted errors of each."""
    around, at = model.surroundings, model.process_times
    here = [effect for effect in effects if effect.missing(around) is None]
    random = [effect for effect in here if effect.is_process]
    covariances = [[effect.covariance(at, trial.parameters) for trial in effect.trials(around)] for effect in random]
    longest = max(float(np.ptp(at.t_s[at.interval == k])) for k in np.unique(at.interval))
    levels = processes.match_labels(at.interval)
    fast = [levels * markov(at.t_s, longest / part) for part in (60, 20, 6)]
    for gyro, name in enumerate(model.stream.gyros):
        for effect in here:
            if effect.has_columns:
                yield (groups.build_switched_group if effect.switched else groups.build_plain_group)(
                    model, effect, name, around
                )
        unit = model.build_unit_columns(gyro)
        place = ProcessProjection.build_projection(unit, unit.T @ model.project_out_nuisance(unit))
        for effect, own in zip(random, covariances, strict=True):
            trials, columns = effect.trials(around), [processes.build_usual_columns(place, K) for K in own]
            parameters, weights = [dict(trial.parameters) for trial in trials], [trial.weight for trial in trials]
            yield replace(groups.build_group(effect, name, columns, parameters, weights), process=True)
        rate = np.interp(at.t_s, model.stream.t_s, model.stream.raw[:, gyro])
        along = np.outer(rate, rate)
        for words, kinds in (
            ("random error of a gyro, correlated in time", fast),
            ("bias of a gyro differs between intervals", [levels]),
            ("scale factor of a gyro differs between intervals", [levels * along]),
            ("scale factor of a gyro wanders", [fast[2] * along]),
        ):
            yield groups.build_rival(words, name, [processes.build_usual_columns(place, K) for K in kinds], True)


def refine_steps(
    model: ArrayModel, linear: LinearModel, member: SelectedCandidate, effects: Mapping[str, Effect]
) -> LinearModel:
    """Add times of a step around the one at which a member is held, to every step of every gyro.

    Steps of different gyros may look alike. One alone with finer times would win over the others for no other reason.
    """
    time_s = linear.option(member).parameters.get("time_s")
    if time_s is None:
        return linear
    for number, entry in enumerate(linear.candidates):
        effect = effects.get(entry.effect)
        if effect is not None and effect.switched:
            nearest = np.argmin([abs(float(option.parameters["time_s"]) - float(time_s)) for option in entry.options])
            linear = add_finer_times(model, linear, SelectedCandidate(number, int(nearest), 0), effect)
    return linear


# ---- held-out data -------------------------------------------------------------------------------------------------------


def fold_array(model: ArrayModel, W: Array) -> Iterator[Fold]:
    """Split attitude and parity, which are independent under M0, into common folds."""
    rows = model.attitude_rows
    of_attitude = folds.build_folds(model.body, W[:rows]) if model.body is not None else iter(())
    for pair in zip_longest(of_attitude, _fold_parity(model, W[rows:])):
        found = [one for one in pair if one is not None]
        names = {name for one in found for name in one.dof}
        joined = {part: np.concatenate([getattr(one, part) for one in found]) for part in BY_ROW}
        yield Fold(**joined, dof={name: sum(one.dof.get(name, 0.0) for one in found) for name in names})


def _fold_parity(model: ArrayModel, W: Array) -> Iterator[Fold]:
    parity = model.parity
    names = np.array([interval.name for interval in model.recording.intervals])
    scale = folds.SETTINGS.broad * np.tile([PLAUSIBLE_G] * 3 + [PLAUSIBLE_BIAS], parity.rows.shape[1])
    nuisance = parity.nuisance_columns * scale
    sigma = np.eye(parity.size) + nuisance @ nuisance.T
    part = np.empty(parity.interval.size, dtype=np.intp)
    for number in np.unique(parity.interval):
        own = np.flatnonzero(parity.interval == number)
        part[own] = (np.arange(own.size) * folds.SETTINGS.parts // own.size + number) % folds.SETTINGS.parts
    for number in np.unique(part):
        out = (part == number)[parity.block]
        if not out.all():
            yield folds.build_normal_fold(sigma, parity.observed, W, out, names[parity.interval[parity.block]])
