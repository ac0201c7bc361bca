"""The hypotheses, in families of equal prior weight, and the evidence of each.

Pairs of families have a tenth of that weight. There are: nothing; the yaw of interval 2, 6 or both the other way; the other
sign of the -y forward rate; other slew timings, of any set of the four maneuvers each its own, or common to all; another
noise level; and *unknown*, a random residual in all numbers, in one interval or in one number, its size mixed over log-spaced
scales. Timings are integrated over; nothing is fitted.

The yaw and rate hypotheses keep the baseline's timings; Θ in the noise part is that of the assumed timings.
"""

from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from studies.natanson import flight
from studies.natanson.flight_diagnosis.draws import common_draws, joined, own_draws, residuals_of
from studies.natanson.flight_diagnosis.numbers import Prepared, log_normal, prepare
from studies.natanson.flight_diagnosis.table import Baseline, Table
from studies.natanson.flight_diagnosis.timings import TIMED
from studies.natanson.flight_gap import MINUS_Y

Array = NDArray[np.float64]
Families = frozenset[str]

YAW, RATE, TIMING, NOISE, UNKNOWN = "yaw direction", "-y rate sign", "slew timing", "noise level", "unknown"
FAMILIES = (YAW, RATE, TIMING, NOISE, UNKNOWN)
PAIR_WEIGHT = 0.1  # prior of two families at once over that of one
UNKNOWN_DEG = np.geomspace(0.001, 1.0, 7)


def evidence(case: Prepared, d: Array, log_weight: Array | float = 0.0, extra: Array | float = 0.0) -> float:
    """Log evidence of d (n, 18) at n draws of log weight (n,), with extra variances (18,) in deg²."""
    covariance = case.covariance + np.diag(np.broadcast_to(extra, 18))
    return float(logsumexp(log_normal(d, covariance) + log_weight) - np.log(len(d)))


def _patterns(scales: Array, single: bool) -> list[tuple[str, float, Array]]:
    """Unknown residuals: name, log prior within the family, and variances (18,)."""
    kinds: list[list[tuple[str, Array]]] = [
        [("all numbers", np.ones(18))],
        [(f"interval {k + 1}", np.repeat(np.arange(6) == k, 3).astype(float)) for k in range(6)],
    ]
    if single:
        kinds.append([(f"interval {i // 3 + 1} {flight.ROTATIONS[i % 3]}", np.eye(18)[i]) for i in range(18)])
    return [
        (name, -np.log(len(kinds) * len(kind) * len(scales)), scale**2 * where)
        for kind in kinds
        for name, where in kind
        for scale in scales
    ]


@dataclass(frozen=True)
class Hypothesis:
    """One member of one or two families.

    Attributes
    ----------
    families : what it is made of; empty for the baseline as it is
    label : for people
    log_weight : log of prior times evidence
    flips : intervals whose slews are reversed
    timed : intervals with timings of their own, or "common"
    extra : (18,) variances of an unknown residual, deg²
    """

    families: Families
    label: str
    log_weight: float
    flips: tuple[int, ...] = ()
    timed: tuple[int, ...] | str = ()
    extra: Array = field(default_factory=lambda: np.zeros(18))


FLIPS: tuple[tuple[int, ...], ...] = ((), (1,), (5,), (1, 5), (3,), (1, 3), (3, 5), (1, 3, 5))
_YAW_MEMBERS = 3


def flip_families(flips: tuple[int, ...]) -> tuple[Families, str, float]:
    """Families, label and log prior within them."""
    yaws = [k for k in flips if k != MINUS_Y]
    families = frozenset(([YAW] if yaws else []) + ([RATE] if MINUS_Y in flips else []))
    labels = ([f"yaw reversed in {' and '.join(str(k + 1) for k in yaws)}"] if yaws else []) + (
        ["rate sign reversed in 4"] if MINUS_Y in flips else []
    )
    return families, ", ".join(labels), -np.log(_YAW_MEMBERS) if yaws else 0.0


def _timing_sets() -> list[tuple[tuple[int, ...] | str, float]]:
    """Sets of intervals with timings of their own, and common ones; log prior: each number of intervals as likely."""
    sets: list[tuple[tuple[int, ...] | str, float]] = [("common", -np.log(5))]
    for size in range(1, 5):
        members = list(combinations(TIMED, size))
        sets += [(tuple(sorted(member)), -np.log(5 * len(members))) for member in members]
    return sets


def _timing_label(timed: tuple[int, ...] | str) -> str:
    return "timings common to all" if isinstance(timed, str) else f"timing of {', '.join(str(k + 1) for k in timed)}"


def hypotheses(table: Table, baseline: Baseline) -> list[Hypothesis]:
    """All of them, weighed."""
    out: list[Hypothesis] = []

    def add(families: Families, label: str, log_prior: float, motion_part: float, case: Prepared, **recipe: Any) -> None:
        curve, one = case.noise
        for noisy in (False, True):
            both = families | {NOISE} if noisy else families
            if len(both) > 2:
                continue
            prior = log_prior + (np.log(PAIR_WEIGHT) if len(both) == 2 else 0.0)
            noise_part = float(logsumexp(curve) - np.log(len(curve))) if noisy else one
            name = ", ".join(part for part in (label, "noise level" if noisy else "") if part)
            out.append(Hypothesis(both, name or "baseline", prior + motion_part + noise_part, case.flips, **recipe))

    for flips in FLIPS:
        families, label, log_prior = flip_families(flips)
        case = prepare(table, baseline, flips)
        add(families, label, log_prior, evidence(case, case.d[None]), case)
        if len(families) > 1:
            continue
        for name, within, extra in _patterns(UNKNOWN_DEG, single=True):
            text = f"{label}, unknown in {name}".removeprefix(", ")
            add(families | {UNKNOWN}, text, log_prior + within, evidence(case, case.d[None], extra=extra), case, extra=extra)
        own = {k: own_draws(case, k) for k in TIMED}
        for timed, within in _timing_sets():
            draws = common_draws(case) if isinstance(timed, str) else joined([own[k] for k in timed])
            text = f"{label}, {_timing_label(timed)}".removeprefix(", ")
            d = residuals_of(case, draws)
            add(families | {TIMING}, text, log_prior + within, evidence(case, d, draws.log_weight), case, timed=timed)
            if flips:
                continue
            for name, inside, extra in _patterns(UNKNOWN_DEG, single=False):
                both = f"{text}, unknown in {name}"
                weight = evidence(case, d, draws.log_weight, extra)
                add(frozenset((TIMING, UNKNOWN)), both, within + inside, weight, case, timed=timed, extra=extra)
    return out
