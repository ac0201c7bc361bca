"""The study's case: everything that is said of one sensor unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from diagnosis.diagnose import diagnose
from diagnosis.inference.closure import closure, fixed
from diagnosis.model.groups import Group
from diagnosis.model.linear import Member
from diagnosis.model.recording import RecordingModel
from diagnosis.model.unit import unit_model
from diagnosis.result import Diagnosis
from simulator.effects.gyro import scale_asymmetry, scale_quadratic
from studies.montecarlo.manifest import digest
from studies.montecarlo.study import Streams, Study
from studies.validation.real_gyro.floor import sample_effects, simulated
from studies.validation.real_gyro.left_out import Fold, folds, is_cut, late_probability
from studies.validation.real_gyro.prediction import CUT, LADDER, LAG, LAGGED, Fit, Prediction, fitted, predicted, together
from studies.validation.real_gyro.trials import Loaded, RealConfig, Row, load
from studies.validation.real_gyro.turns import turn_rows

SWEEP = 4  # samples before and after one, for the rate to have swept through
SWEPT = 6  # counts in that time
TRIED = tuple(module.EFFECT for module in (scale_asymmetry, scale_quadratic))
FORCE = "bias that follows specific force"
GRAVITY = 9.80665  # m/s²
FORCE_SIZES = (1e-7, 1e-2)  # rad/s per g


def case(config: RealConfig, number: int, streams: Streams) -> list[Row]:
    """All that is said of one unit, a row a number; the column `kind` says of what kind."""
    unit = config.points()[number]
    trials = {name: load(config, name) for name in config.units[unit]}
    diagnoses = {name: diagnose(one.recording, seed=config.entropy) for name, one in trials.items()}
    parted = folds(list(trials.values()), diagnoses)
    rows: list[Row] = []
    for name, one in trials.items():
        rows += [trial_row(config, one, diagnoses[name]), diagnosis_row(name, diagnoses[name], "as recorded")]
    last: dict[str, list[Fit]] = {}
    for fold in parted:
        rows += fold_rows(fold, last)
    for name, found in last.items():
        gyro = trials[name].recording.gyro
        delay = float(np.mean([one.delay for one in found]))
        if delay:
            again = replace(trials[name].recording, gyro=replace(gyro, t_s=gyro.t_s - delay))
            rows.append(diagnosis_row(name, diagnose(again, seed=config.entropy), "time offset undone"))
    rows += floor_rows(config, trials, diagnoses, parted, last)
    rows += tried_rows(list(trials.values()), parted)
    return [{"unit": unit, **row} for row in rows]


STUDY = Study("studies.validation.real_gyro:STUDY", RealConfig, case)


# ---- rows ----------------------------------------------------------------------------------------------------------------


def trial_row(config: RealConfig, one: Loaded, diagnosis: Diagnosis) -> Row:
    """The trial by itself: its file's digest, noise and mean rate, its delay, and what its samples show.

    While the rate sweeps through zero, the bin of zero holds twice what its neighbours do if readings are cut toward zero, and
    as much if they are rounded.
    """
    trial, rates = one.trial, one.trial.rates
    steps = [np.deg2rad(cause.size) for cause in diagnosis.causes if cause.effect == CUT]
    counts = np.rint(rates / (steps[0] if steps else np.inf))
    sweeping = np.abs(np.roll(counts, -SWEEP, axis=0) - np.roll(counts, SWEEP, axis=0)) > SWEPT
    zero, *beside = (np.count_nonzero(sweeping & trial.moving[:, None] & (counts == k)) for k in (0, -1, 1))
    own = fitted([one], replace(LADDER[-1], cut=is_cut(diagnosis)))
    return {
        "kind": "trial",
        "trial": one.number,
        "text": digest(config.files(one.number)[0].read_bytes()),
        "samples": float(len(rates)),
        "rate_deg_s": float(np.rad2deg(np.sqrt(np.square(rates[trial.moving]).sum(axis=1).mean()))),
        "stated_sigma_deg": float(np.rad2deg(np.sqrt(np.mean(np.square(one.recording.attitudes.sigma))))),
        "stated_arw_deg_per_sqrt_s": float(np.rad2deg(one.recording.gyro.arw)),
        "delay_ms": 1e3 * own.delay,
        "formal_sigma_ms": 1e3 * own.delay_sigma,
        "zero_over_neighbours": zero / np.mean(beside) if steps else np.nan,
        "repeats_in_motion": float(np.count_nonzero(one.repeats & trial.moving)),
        "repeats_at_rest": float(np.count_nonzero(one.repeats & ~trial.moving)),
    }


def diagnosis_row(number: str, found: Diagnosis, turn: str) -> Row:
    """What a diagnosis of one trial says."""
    best = found.details.explanations
    return {
        "kind": "diagnosis",
        "trial": number,
        "turn": turn,
        "verdict": found.verdict,
        "late_probability": late_probability(found),
        "unlisted_probability": found.unknown_probability,
        "causes": "; ".join(f"{one.label} {one.size:.4g} ± {one.sigma:.2g} {one.unit}" for one in found.causes),
        "likeliest": f"{best['effects'].iloc[0]} ({best['probability'].iloc[0]:.2f})" if len(best) else "",
    }


def fold_rows(fold: Fold, last: dict[str, list[Fit]]) -> list[Row]:
    """Predictions of one trial left out, rung by rung, and with a lag in the delay's place; the last fit is added to `last`."""
    rows: list[Row] = []
    number = fold.tested.number
    for name, rung in fold.rungs():
        found = fitted(fold.others, rung)
        predictions = predicted(fold.tested, found, rung)
        rows += held_rows(number, "held", name, predictions)
        rows += [row for row in _series_rows(number, name, predictions) if name in (LADDER[0].name, LADDER[-1].name)]
        rows.append(
            {"kind": "fit", "trial": number, "name": name, "late": fold.late, "cut": fold.cut, "delay_ms": 1e3 * found.delay}
        )
    last.setdefault(number, []).append(found)
    rows += turn_rows(fold.tested, found, rung)
    if fold.late:
        lagged = replace(rung, late=LAG.name)
        rows += held_rows(number, "held", LAGGED, predicted(fold.tested, fitted(fold.others, lagged), lagged))
    return rows


def held_rows(number: str, kind: str, name: str, predictions: Sequence[Prediction]) -> list[Row]:
    """A row for the prediction of each interval."""
    return [
        {
            "kind": kind,
            "trial": number,
            "name": name,
            "interval": one.interval,
            "end_deg2": one.squares[0],
            "series_deg2": one.squares[1],
        }
        for one in predictions
    ]


def _series_rows(number: str, name: str, predictions: Sequence[Prediction]) -> list[Row]:
    base = {"kind": "series", "trial": number, "name": name}
    return [
        {**base, "interval": one.interval, "t_s": float(t), **dict(zip(("x", "y", "z"), error.tolist(), strict=True))}
        for one in predictions
        for t, error in zip(one.t_s, one.error, strict=True)
    ]


def floor_rows(
    config: RealConfig,
    trials: Mapping[str, Loaded],
    diagnoses: Mapping[str, Diagnosis],
    parted: Sequence[Fold],
    last: Mapping[str, Sequence[Fit]],
) -> list[Row]:
    """What the last rung leaves on simulated trials, fitted on simulated others."""
    rows: list[Row] = []
    # Streams are named by effect: the place among all trials keeps those of one from those of another.
    every = [name for unit in config.points() for name in config.units[unit]]
    seeds = {name: config.entropy + every.index(name) for name in trials}
    rungs = {fold.tested.number: list(fold.rungs())[-1][1] for fold in parted}
    flown = {
        name: simulated(one, rungs[name], last[name][0], sample_effects(diagnoses[name]), seeds[name], config.floor_replays)
        for name, one in trials.items()
    }
    for count in range(config.floor_replays):
        for fold in parted:
            *_, (_, rung) = fold.rungs()
            tested, *others = (_like(flown[one.number][count], one) for one in (fold.tested, *fold.others))
            rows += held_rows(tested.number, "floor", str(count), predicted(tested, fitted(others, rung), rung))
    return rows


def _like(flown: Loaded, part: Loaded) -> Loaded:
    """The intervals of a simulated trial that a fold has."""
    return flown.only([interval.name for interval in part.recording.intervals])


# ---- further effects -----------------------------------------------------------------------------------------------------


def tried_rows(trials: Sequence[Loaded], parted: Sequence[Fold]) -> list[Row]:
    """How far further effects would close the gap of the last rung, measured on whole trials held out (of one, on motions)."""
    *_, (_, rung) = parted[0].rungs()
    model, owner = together(trials, rung, fitted(trials, rung))
    if len(trials) == 1:
        owner = tuple(interval.name for interval in model.recording.intervals)
    linear = unit_model(model, owner, TRIED, [_force(model)], rivals=False)
    rows: list[Row] = []
    for name in (*(effect.name for effect in TRIED), FORCE):
        labels = tuple(one.label for one in linear.candidates if one.effect == name)
        members = [Member(place, 0, 0) for label in labels if (place := linear.find(label)) is not None]
        closed = closure(linear, members, fixed(labels))
        if members and closed is not None:
            measured = {"before": closed.before, "after": closed.after, "closed": closed.closed}
            rows.append({"kind": "tried", "name": name, **measured})
    return rows


def _force(model: RecordingModel) -> Group:
    """A bias that follows the specific force on all axes, rad/s per g."""
    force = np.column_stack([model.stream.housekeeping[f"specific_force_{axis}_m_s2"] for axis in "xyz"]) / GRAVITY
    columns = model.whitened(model.reading(np.einsum("ij,nk->nijk", np.eye(3), force).reshape(-1, 3, 9)))
    return Group(FORCE, None, True, [columns], [{}], np.ones(1), FORCE_SIZES, "rad/s per g")
