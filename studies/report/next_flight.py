"""What to fly after a diagnosis: which extra maneuver tells most of what was found, by the linear model of a plan."""

from __future__ import annotations

from diagnosis.plan import Extra, Plan, plan
from diagnosis.plan.result import Progress
from diagnosis.result import Diagnosis
from simulator.effects import EFFECTS
from simulator.scenario import Scenario

HELPS = 0.9  # ratio of the smallest visible size with the maneuver over that without, below which it is worth naming


def list_suspected_effects(diagnosis: Diagnosis) -> list[str]:
    """Labels of what may be at work: the causes with what cannot be told from them, or else the next best explanations."""
    labels = [member for cause in diagnosis.causes for member in (cause.label, *cause.group)]
    labels = labels or [label for effects, _ in diagnosis.alternatives for label in effects]
    return [label for label in dict.fromkeys(labels) if label.partition(":")[0] in EFFECTS]


def plan_next_flight(diagnosis: Diagnosis, scenario: Scenario, progress: Progress | None = None, seed: int = 0) -> Plan | None:
    """The plan of a scenario for what may be at work; None if that is nothing that a plan knows."""
    names = list(dict.fromkeys(label.partition(":")[0] for label in list_suspected_effects(diagnosis)))
    return plan(scenario, effects=names, progress=progress, seed=seed) if names else None


def describe_next_flight(diagnosis: Diagnosis, found: Plan | None = None) -> str:
    """Describe the recommended next flight, or where it can be asked for.

    Parameters
    ----------
    diagnosis : the answer
    found : of `plan_next_flight`, if a scenario was given
    """
    if diagnosis.verdict == "none":
        return "No further recording is needed."
    if found is None or not found.extras:
        return "gyrocal diagnose --plan SCENARIO, with the scenario of this recording, states which extra maneuver helps most."
    labels = list_suspected_effects(diagnosis)
    pairs = {frozenset((a, b)) for a in labels for b in labels if a != b}
    apart = [(len(pairs & {frozenset(pair) for pair in one.resolved}), one) for one in found.extras]
    most, best = max(apart, key=lambda one: (one[0], -one[1].ratio))
    if most:
        return f"{best.name} ({best.hours:.1f} h): it separates causes that this recording cannot separate."
    ratio, helpful = min(((_find_best_ratio(one, labels), one) for one in found.extras), key=lambda one: one[0])
    if ratio > HELPS:
        return "No extra maneuver on the list makes the cause much better visible."
    visible = f"the smallest visible size of the cause is then {ratio:.2g} times that of this recording"
    return f"{helpful.name} ({helpful.hours:.1f} h): {visible}."


def _find_best_ratio(extra: Extra, labels: list[str]) -> float:
    """The best ratio of what may be at work; a label of the plan may say more, as in effect:z<y."""
    own = [ratio for name, ratio in extra.by_effect.items() if name.partition("<")[0] in labels]
    return min(own, default=1.0)
