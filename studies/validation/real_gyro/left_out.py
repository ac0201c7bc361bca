"""What is left out, and what the diagnoses of the others find."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from diagnosis.diagnose import diagnose
from diagnosis.result import Diagnosis
from diagnosis.settings import DEFAULT
from gyrocal import InputError
from studies.validation.real_gyro.prediction import CUT, LADDER, LAG, LATE, Rung
from studies.validation.real_gyro.trials import Loaded

SUPPORT = 0.5  # share of the other trials whose diagnosis must find the gyro late, or its readings cut
SURE = DEFAULT.named  # probability of a late gyro over all explanations, from which on it is found, as any cause is


@dataclass(frozen=True)
class Fold:
    """What is left out, what is fitted, and whether the others' diagnoses find the gyro late, and its readings cut."""

    tested: Loaded
    others: tuple[Loaded, ...]
    late: bool
    cut: bool

    def rungs(self) -> Iterator[tuple[str, Rung]]:
        """Name of each rung, and what is undone at it.

        What was not found is not undone; which samples are stale each trial's own tests say.
        """
        for rung in LADDER:
            yield rung.name, replace(rung, late=rung.late if self.late else "", cut=rung.cut and self.cut)


def late_probability(diagnosis: Diagnosis) -> float:
    """Probability that the gyro is late, over all explanations, unlisted ones included.

    Late tags and a lag are the same to first order; which of the two it is, held-out prediction decides.
    """
    table = diagnosis.details.explanations
    late = [any(label in (LATE.name, LAG.name) for label in effects.split(" + ")) for effects in table["effects"]]
    return float(table["probability"].to_numpy()[late].sum()) if len(table) else 0.0


def is_late(diagnosis: Diagnosis) -> bool:
    """Whether the gyro is surely late, whatever else is at work."""
    return late_probability(diagnosis) >= SURE


def is_cut(diagnosis: Diagnosis) -> bool:
    """Whether readings are cut toward zero."""
    return any(cause.effect == CUT for cause in diagnosis.causes)


def folds(trials: Sequence[Loaded], diagnoses: Mapping[str, Diagnosis]) -> list[Fold]:
    """Each trial left out; of a single trial each motion, which takes a diagnosis of the other motions alone."""

    def fold(tested: Loaded, others: tuple[Loaded, ...], found: Sequence[Diagnosis]) -> Fold:
        late, cut = ([test(one) for one in found] for test in (is_late, is_cut))
        return Fold(tested, others, sum(late) >= SUPPORT * len(found), sum(cut) >= SUPPORT * len(found))

    if len(trials) > 1:
        parts = [(one, tuple(other for other in trials if other is not one)) for one in trials]
        return [fold(one, others, [diagnoses[other.number] for other in others]) for one, others in parts]
    (single,) = trials
    if len(single.motions) < 2:
        raise InputError(f"{single.trial.name}: a unit of one trial needs two motions or more, to leave one out")
    out = []
    for name in single.motions:
        rest = single.only([interval.name for interval in single.recording.intervals if interval.name != name])
        out.append(fold(single.only([name]), (rest,), [diagnose(rest.recording)]))
    return out
