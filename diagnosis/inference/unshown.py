"""What a gyro inside its dead zone does not show, and what must therefore not be taken for something else.

The motion that a dead zone swallows is real, irregular, and about one axis. In the attitude it looks like a random process or
a bias of any shape about that axis; in the samples its edges add harmonics of the body's slow motion and, as jumps between
zero and ±d, a variance of d²/3 at most. Explanations that differ only in such parts are therefore one.
"""

from __future__ import annotations

from collections.abc import Set

import numpy as np
from scipy.special import logsumexp

from diagnosis.detectors.report import StreamCause
from diagnosis.inference.candidates import Bank
from diagnosis.inference.search import Explanation, Member
from simulator.effects import EFFECTS

HARMONICS_HZ = 0.25  # below it, lines of an axis with a dead zone are taken for the zone's


def without_unshown(bank: Bank, explanations: list[Explanation], axes: Set[str]) -> tuple[list[Explanation], float]:
    """Explanations without the parts that hidden motion about some axes may be, and the probability that nothing is left.

    Parameters
    ----------
    bank : of the candidates
    explanations : found by the search, the best first
    axes : of the gyros with a dead zone

    Returns
    -------
    explanations
        Merged where they became the same, the best first; with the members and the evidence of the best that was merged.
    float
        Probability of the explanations of which nothing is left.
    """
    if not axes:
        return explanations, 0.0
    merged: dict[frozenset[int], list[Explanation]] = {}
    for explanation in explanations:
        kept = tuple(member for member in explanation.members if not _hidden_motion(bank, member, axes))
        one = Explanation(kept, explanation.log_evidence, explanation.log_posterior)
        merged.setdefault(one.key, []).append(one)
    whole = logsumexp([explanation.log_posterior for explanation in explanations])
    gone = merged.pop(frozenset(), [])
    nothing = float(np.exp(logsumexp([one.log_posterior for one in gone]) - whole)) if gone else 0.0
    out = [
        Explanation(ones[0].members, ones[0].log_evidence, float(logsumexp([one.log_posterior for one in ones])))
        for ones in merged.values()
    ]
    return sorted(out, key=lambda explanation: -explanation.log_posterior), nothing


def _hidden_motion(bank: Bank, member: Member, axes: Set[str]) -> bool:
    candidate = bank.candidates[member.candidate]
    if not candidate.listed:
        return candidate.label.rpartition(":")[2] in axes
    return candidate.axis in axes and EFFECTS[candidate.effect].is_process


def is_of_the_zone(cause: StreamCause, half_width: float, noise: float) -> bool:
    """Whether an effect in the samples is one that the edges of a dead zone about its axis make.

    Parameters
    ----------
    cause : seen in the samples, about the axis of the zone
    half_width, noise : of the zone, and stated for a sample; in the same unit
    """
    if cause.effect == "vibration":
        return float(cause.parameters["apparent_hz"]) < HARMONICS_HZ
    return cause.effect == "noise_excess" and 0 < cause.size**2 - 1 < (half_width / noise) ** 2 / 3
