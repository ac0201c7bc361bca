"""What is left out, and which effects the diagnoses of the others name.

The effects are those named by at least half of the others' diagnoses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from diagnosis.diagnose import diagnose
from diagnosis.result import Diagnosis
from gyrocal import InputError
from simulator.effects.gyro import rate_lag
from studies.validation.real_gyro.ladder import LADDER, LATE, STALE, TRUNCATED, Found
from studies.validation.real_gyro.trials import Loaded

TIMING = (LATE, rate_lag.EFFECT.name)  # the same to first order; which of the two it is, held-out prediction decides
SUPPORT = 0.5  # share of the other trials whose diagnosis must name an effect
NAMED = 0.95  # probability of a timing effect over all explanations, to be named


def timing_probability(diagnosis: Diagnosis) -> float:
    """Probability that the gyro is late in one way or the other, over all explanations, unlisted ones included."""
    table = diagnosis.details.explanations
    own = [any(label in TIMING for label in effects.split(" + ")) for effects in table["effects"]]
    return float(table["probability"].to_numpy()[own].sum()) if len(table) else 0.0


def supported(diagnosis: Diagnosis) -> set[str]:
    """Effects of the ladder that a diagnosis names."""
    out = {cause.effect for cause in diagnosis.causes} & set(LADDER)
    if timing_probability(diagnosis) >= NAMED:
        out.add(LATE)
    return out


def found_by(diagnoses: Sequence[Diagnosis]) -> Found:
    """The effects that enough of the diagnoses name."""
    names = [supported(one) for one in diagnoses]
    effects = tuple(effect for effect in LADDER if sum(effect in own for own in names) >= SUPPORT * len(diagnoses))
    causes = [cause for one in diagnoses for cause in one.causes]
    steps = [cause.size for cause in causes if cause.effect == TRUNCATED]
    stale = [cause for cause in causes if cause.effect == STALE]
    return Found(
        effects,
        step=float(np.deg2rad(np.median(steps))) if TRUNCATED in effects else 0.0,
        mean_run=float(np.mean([cause.size for cause in stale])) if stale else 1.0,
        fraction=float(np.mean([float(cause.parameters["fraction"]) for cause in stale])) if stale else 0.0,
    )


@dataclass(frozen=True)
class Fold:
    """What is left out, what is fitted, and what the others' diagnoses found."""

    tested: Loaded
    others: tuple[Loaded, ...]
    found: Found


def folds(trials: Sequence[Loaded], diagnoses: Mapping[str, Diagnosis]) -> list[Fold]:
    """Each trial left out; of a single trial each motion, which takes a diagnosis of the other motions alone."""
    if len(trials) > 1:
        return [
            Fold(
                one,
                tuple(other for other in trials if other.number != one.number),
                found_by([diagnoses[other.number] for other in trials if other.number != one.number]),
            )
            for one in trials
        ]
    (single,) = trials
    if len(single.motions) < 2:
        raise InputError(f"{single.trial.name}: a unit of one trial needs two motions or more, to leave one out")
    out = []
    for name in single.motions:
        rest = single.only([interval.name for interval in single.recording.intervals if interval.name != name])
        out.append(Fold(single.only([name]), (rest,), found_by([diagnose(rest.recording)])))
    return out
