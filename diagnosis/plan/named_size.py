"""Smallest named size: checked on draws, by the search and the attribution that the diagnosis itself runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.inference.attribution import infer_attribution
from diagnosis.inference.search import Search
from diagnosis.plan.columns import Signature
from diagnosis.plan.result import Progress, Visible
from diagnosis.plan.settings import SETTINGS
from diagnosis.plan.visibility import DetectionPower

Array = NDArray[np.float64]


def find_named_sizes(seen: list[Visible], every: Sequence[Signature], power: DetectionPower, tell: Progress) -> list[Visible]:
    """Find the smallest named sizes of effects that are seen in the attitude, and add them to the answers."""
    rng = np.random.default_rng(power.rng.integers(2**63))
    drawn = {one.label: one.draw(rng, SETTINGS.named_draws) for one in every}
    out = []
    for number, one in enumerate(seen):
        tell(f"smallest named size: {one.label}", 0.55 + 0.15 * number / len(seen))
        if one.label in drawn and one.verdict == "visible" and np.isfinite(one.size):
            one = replace(one, named=find_named_size(one, drawn[one.label], power))
        out.append(one)
    return out


def find_named_size(one: Visible, x: Array, power: DetectionPower) -> float:
    """Find the smallest multiple of the visible size at which nine draws of ten name the effect and nothing else.

    Parameters
    ----------
    one : the effect
    x : (N, d) or (N, 1) drawn signatures of unit size

    Returns
    -------
    Infinite if ten times the visible size is not enough.
    """
    label = one.effect if one.axis is None else f"{one.effect}:{one.axis}"
    observed = np.broadcast_to(x, (len(x), SETTINGS.named_draws))

    def enough(factor: float) -> bool:
        missed = 0
        for k in range(SETTINGS.named_draws):
            linear = replace(power.linear, y=power.noise[:, k] + factor * one.size * observed[:, k])
            answer = infer_attribution(linear, Search(linear, power.settings).explanations(), power.settings)
            right = answer.verdict == "named" and [slot.group[0][0] for slot in answer.slots] == [label]
            missed += not right
            if missed > (1 - SETTINGS.power) * SETTINGS.named_draws:
                return False
        return True

    low, high = 0, len(SETTINGS.factors)  # the first that is enough lies in [low, high]
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(SETTINGS.factors[middle]) else (middle + 1, high)
    return SETTINGS.factors[low] * one.size if low < len(SETTINGS.factors) else float("inf")
