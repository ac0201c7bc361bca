"""The extra maneuver that best separates two effects.

An effect of size a with the signature x (per unit size, whitened and projected) keeps the length a‖x‖ √(1 − ρ²) beside an
alternative effect that reproduces the share ρ² of it (`diagnosis.plan.separability`). The best plan has the largest
‖x‖ √(1 − ρ²), and hence needs the smallest size a. Over the axes of the first effect the largest needed size counts, and
against each of them the axis of the second effect with the largest share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.steps import StepTimes, step_times
from diagnosis.plan.columns import build_signatures, linearise_noise_free
from diagnosis.plan.extras import append_intervals
from diagnosis.plan.result import Progress
from diagnosis.plan.separability import compute_confusion_shares, compute_separating_snr
from diagnosis.plan.settings import SETTINGS
from gyrocal.errors import InputError
from simulator.effects import EFFECTS
from simulator.scenario import Scenario

OWN_PLAN = "the scenario itself"


@dataclass(frozen=True)
class Separation:
    """How a plan separates two effects.

    Attributes
    ----------
    plan : name of the extra maneuver, or `OWN_PLAN`
    effect, other : labels of the axes that are separated worst
    share : ρ² of the first that the second reproduces
    size : of the first effect that separates it with a probability of 0.95; infinite if none does
    """

    plan: str
    effect: str
    other: str
    share: float
    size: float


def list_separations(
    scenario: Scenario,
    effect: str,
    other: str,
    extras: Mapping[str, Sequence[Mapping[str, Any]]],
    progress: Progress | None = None,
) -> list[Separation]:
    """List how the scenario, and the scenario with each extra maneuver, separates two effects: the best plan first.

    Raises
    ------
    InputError
        An effect is random, or the scenario cannot show it.
    """
    tell = progress or (lambda text, share: None)
    check_shapes(effect, other)
    model = linearise_noise_free(scenario)
    steps, out = step_times(model), [evaluate_separation(OWN_PLAN, model, effect, other, None)]
    for number, (name, sections) in enumerate(extras.items()):
        tell(f"extra: {name}", number / len(extras))
        longer = linearise_noise_free(append_intervals(scenario, sections))
        out.append(evaluate_separation(name, longer, effect, other, steps))
    return sorted(out, key=lambda one: one.size)


def check_shapes(*effects: str) -> None:
    """Check that effects have a shape.

    Raises
    ------
    InputError
        One is random.
    """
    for name in effects:
        if EFFECTS[name].is_process:
            raise InputError(f"{name}: is a random effect; --separate is for two that have a fixed shape; leave it out")


def evaluate_separation(name: str, model: RecordingModel, effect: str, other: str, steps: StepTimes | None) -> Separation:
    """Evaluate one plan, with steps at the given times."""
    every = build_signatures(model, [effect, other], steps)
    first, second = ([k for k, one in enumerate(every) if one.effect == wanted] for wanted in (effect, other))
    if not first or not second:
        raise InputError(f"{other if first else effect}: the scenario cannot show it; gyrocal plan tells why")
    share = compute_confusion_shares(every)[0][np.ix_(first, second)]
    middle = [(every[k], every[k].middle) for k in first]
    norms = np.array([one.norms[m] * (one.share[m] > SETTINGS.gone) for one, m in middle])
    worst = share.max(axis=1)
    size = np.divide(compute_separating_snr(worst), norms, out=np.full(norms.shape, np.inf), where=norms > 0)
    k = int(size.argmax())
    return Separation(name, every[first[k]].label, every[second[int(share[k].argmax())]].label, float(worst[k]), float(size[k]))
