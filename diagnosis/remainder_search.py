"""Identify effects in the presence of a remainder.

Where no explanation by listed effects fits the stated noise, the sizes of the remainder (`diagnosis.model.remainder`) and the
explanation are found in turn: the remainder beside the effects of the best explanation, first that of the search without a
remainder, then the posterior of all explanations with the remainder in the noise. Random processes of the gyro compete with the
other effects, since a walk over the whole recording may look like a drift. They are not identified here, since the remainder
describes them; those that the search without a remainder has identified stay on the list.

An effect is stated, at its probability, if

* it is likelier than not in the presence of the remainder, alone or with the group it belongs to. The remainder is estimated
  with and without it, so that an effect has to explain more than a larger remainder would;
* it closes a share of the misfit on held-out data (`diagnosis.budget`).

Sizes that differ between parts of the recording (`diagnosis.replication`) are reported, and do not exclude the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.special
from numpy.typing import NDArray
from scipy.special import expit

from diagnosis.answer import Closure, Regressor, RemainderSummary
from diagnosis.budget import Step, convert, measure_causes, predict_held_out, select_closing, summarise_closure
from diagnosis.inference.amplitudes import FittedEffect, estimate_amplitudes, refine_explanation
from diagnosis.inference.attribution import CredibleGroup, find_slots, scale_slot
from diagnosis.inference.search import BASELINE_EXPLANATION, Explanation, Search
from diagnosis.model.calibration import calibrate_with_effects
from diagnosis.model.candidates import assemble_linear_model, build_linear_model
from diagnosis.model.linear import ColumnStore, LinearModel, SelectedCandidate
from diagnosis.model.misfit import build_basis
from diagnosis.model.prepare import Progress
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.remainder import (
    Remainder,
    RemainderProcess,
    add_remainder,
    build_processes,
    estimate_remainder,
    summarise_remainder,
)
from diagnosis.settings import DiagnosisSettings
from simulator.effects.base import Effect

Array = NDArray[np.float64]

ROUNDS = 3  # of remainder and explanation in turn
MOST_EFFECTS = 4  # in one explanation
SIGNIFICANT = 1e-3  # p-value below which the remainder follows a regressor, all tests counted
MOST_REGRESSORS = 4  # that are reported


@dataclass(frozen=True)
class BesideRemainder:
    """Effects identified in the presence of a remainder.

    Attributes
    ----------
    model : the recording with the remainder in its noise
    remainder : the part of the misfit that no identified cause explains
    slots : stated effects and what could stand in their place, in the order of the budget
    fitted : their amplitudes; size and sigma are those over the parts of the recording
    budget : steps on held-out data
    closed : how far all causes together close the misfit; None without a cause
    change, covariance : of the calibration with the causes in the model, see
    `diagnosis.model.calibration.calibrate_with_effects`
    """

    model: RecordingModel
    remainder: RemainderSummary
    slots: tuple[CredibleGroup, ...]
    fitted: tuple[FittedEffect, ...]
    budget: tuple[Step, ...]
    closed: Closure | None
    change: Array
    covariance: Array


def identify_beside_remainder(
    model: RecordingModel,
    effects: Sequence[Effect],
    settings: DiagnosisSettings,
    tell: Progress,
    first: Sequence[FittedEffect] = (),
    stated: Sequence[tuple[CredibleGroup, FittedEffect]] = (),
) -> BesideRemainder:
    """Identify effects in the presence of a remainder.

    Parameters
    ----------
    model : the recording with the stated noise
    effects : listed effects
    settings : priors and thresholds
    tell : progress
    first : explanation by the search without a remainder; the remainder is first estimated beside its shapes
    stated : those effects of it that are stated, of which random processes are kept
    """
    rivals = [effect for effect in effects if not (effect.is_process and effect.on_references)]
    rules = replace(settings, largest_set=MOST_EFFECTS)
    processes = build_processes(model)
    shapes = [one for one in first if not one.process]
    columns = np.hstack([np.zeros((model.size, 0)), *(one.columns * one.prior_sigma for one in shapes)])
    labels = frozenset(one.label for one in shapes)
    remainder = estimate_remainder(model, processes, columns)
    noisy = add_remainder(model, remainder)
    linear = build_linear_model(noisy, rivals, rules)
    for number in range(ROUNDS):
        tell(f"remainder, round {number + 1}", 0.9 + 0.02 * number)
        if number:
            before, noisy = noisy, add_remainder(model, remainder)
            store = ColumnStore(noisy.nuisance)
            store.add(convert(before, noisy, linear.W[:, :]))
            linear = assemble_linear_model(noisy, linear.candidates, store, {effect.name: effect for effect in rivals}, rules)
        search = Search(linear, rules)
        explanations = sorted([*search.explanations(), BASELINE_EXPLANATION], key=lambda one: -one.log_posterior)
        best = explanations[0]
        shaped = [member for member in best.members if not linear.candidate(member).process]
        found = frozenset(linear.candidate(member).label for member in shaped)
        columns = _build_prior_columns(model, noisy, linear, shaped)
        if found == labels:
            break
        labels = found
        remainder = estimate_remainder(model, processes, columns, remainder)
    slots = [slot for slot in find_slots(linear, best, explanations, rules) if not linear.candidate(slot.member).process]
    slots = _weigh_larger_remainder(model, noisy, linear, best, slots, processes, remainder, rules)
    kept = [pair for pair in stated if pair[1].process]
    return _confirm_effects(model, noisy, linear, remainder, slots, kept, settings)


def _build_prior_columns(
    model: RecordingModel, noisy: RecordingModel, linear: LinearModel, members: Sequence[SelectedCandidate]
) -> Array:
    """(N, q) columns of some members in units of their priors, whitened by the stated noise."""
    parts = [np.zeros((model.size, 0))]
    for member in members:
        places, scale, _ = linear.build_design((member,))
        parts.append(linear.W[:, places] * scale)
    return convert(noisy, model, np.hstack(parts))


def _weigh_larger_remainder(
    model: RecordingModel,
    noisy: RecordingModel,
    linear: LinearModel,
    best: Explanation,
    slots: Sequence[CredibleGroup],
    processes: tuple[RemainderProcess, ...],
    remainder: Remainder,
    settings: DiagnosisSettings,
) -> list[CredibleGroup]:
    """Multiply the posterior of each effect by that against a larger remainder in its place."""
    whole = estimate_remainder(model, processes, _build_prior_columns(model, noisy, linear, best.members), remainder)
    out = []
    for slot in slots:
        others = [member for member in best.members if member != slot.member]
        less = estimate_remainder(model, processes, _build_prior_columns(model, noisy, linear, others), remainder)
        entry, option = linear.candidate(slot.member), linear.option(slot.member)
        odds = whole.log_likelihood - less.log_likelihood - float(np.log(entry.scales.size)) + option.log_weight
        out.append(scale_slot(slot, float(expit(odds + entry.log_prior + np.log(settings.another)))))
    return out


def _confirm_effects(
    model: RecordingModel,
    noisy: RecordingModel,
    linear: LinearModel,
    remainder: Remainder,
    slots: Sequence[CredibleGroup],
    kept: Sequence[tuple[CredibleGroup, FittedEffect]],
    settings: DiagnosisSettings,
) -> BesideRemainder:
    """State the effects that are likely and close a share of the misfit on held-out data, those kept of `first` among them."""
    likely = [slot for slot in slots if slot.group_probability >= settings.unknown]
    kept = [
        (slot, replace(one, columns=convert(model, noisy, one.columns), shift=convert(model, noisy, one.shift)))
        for slot, one in kept
    ]
    while True:
        fine, members = refine_explanation(linear, tuple(slot.member for slot in likely)) if likely else (linear, ())
        pairs = [*zip(likely, estimate_amplitudes(fine, members), strict=True), *kept]
        pairs.sort(key=lambda pair: -float(np.sum(noisy.project_out_nuisance(pair[1].contribution) ** 2)))
        stated, fitted = tuple(slot for slot, _ in pairs), [one for _, one in pairs]
        held, replications, budget = measure_causes(model, noisy, stated, fitted)
        closing = select_closing(stated, budget)
        if len(closing) == len(stated):
            break
        likely = [slot for slot in likely if slot in closing]
        kept = [pair for pair in kept if pair[0] in closing]
    change, covariance = calibrate_with_effects(noisy, fitted)
    sized = [
        replace(one, size=parts.mean, sigma=max(parts.sigma, one.sigma))
        for one, parts in zip(fitted, replications, strict=True)
    ]
    last = budget[-2]  # before the floor
    left = summarise_remainder(
        remainder, last.closed or 0.0, last.interval_90 or (0.0, 0.0), find_regressors(model, noisy, linear, fitted)
    )
    closed = summarise_closure(held) if fitted else None
    return BesideRemainder(noisy, left, stated, tuple(sized), budget, closed, change, covariance)


def find_regressors(
    model: RecordingModel, noisy: RecordingModel, linear: LinearModel, fitted: Sequence[FittedEffect]
) -> tuple[Regressor, ...]:
    """Find what the remainder follows: score tests of shapes outside the library, in the presence of the remainder.

    A shape is reported with the share of the held-out misfit that it closes beside the effects and the shapes before it, and
    only if the 90 % interval of that share is above zero.
    """
    left = noisy.y - sum((noisy.project_out_nuisance(one.contribution) for one in fitted), np.zeros(noisy.size))
    found: dict[str, tuple[float, FittedEffect]] = {}
    tests = [(one, option) for one in linear.candidates if not one.listed for option in one.options]
    for candidate, option in tests:
        Q = build_basis(linear.X[:, option.columns])
        statistic = float(np.sum((Q.T @ left) ** 2))
        p = min(1.0, float(scipy.special.chdtrc(Q.shape[1], statistic)) * len(tests))
        if p < SIGNIFICANT:
            a = np.asarray(np.linalg.lstsq(linear.X[:, option.columns], left, rcond=None)[0], dtype=np.float64)
            shape = FittedEffect(
                candidate.label, candidate.effect, candidate.axis, candidate.unit, 1.0, 0.0, {}, linear.W[:, option.columns], a,
                np.zeros(a.size), float(np.sqrt(np.mean(a**2))), False, np.zeros(noisy.size),
            )  # fmt: skip
            if p < found.get(candidate.label, (1.0, shape))[0]:
                found[candidate.label] = p, shape
    best = sorted(found.values(), key=lambda one: one[0])[:MOST_REGRESSORS]
    held = predict_held_out(model, noisy, [*fitted, *(shape for _, shape in best)]) if best else None
    out = []
    for number, (p, shape) in enumerate(best, len(fitted)):
        assert held is not None
        share, (low, _) = held.closed(number, number + 1)
        if low > 0:
            out.append(Regressor(shape.label, p, share))
    return tuple(out)
