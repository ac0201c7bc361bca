"""The plan as a whole: every part in turn, with progress and notes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

from diagnosis.model.calibration import describe_unobserved
from diagnosis.model.candidates import build_linear_model
from diagnosis.model.recording_model import RecordingModel
from diagnosis.plan.columns import build_signatures, linearise_noise_free
from diagnosis.plan.extras import append_intervals, evaluate_extra, list_maneuvers
from diagnosis.plan.result import Plan, Progress
from diagnosis.plan.separability import list_pairs
from diagnosis.plan.visibility import DetectionPower, find_visible_size, list_unavailable_effects
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.errors import InputError
from simulator.effects import EFFECTS
from simulator.scenario import Scenario


def plan(
    scenario: Scenario,
    *,
    effects: Sequence[str] | None = None,
    extras: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
    progress: Progress | None = None,
    seed: int = 0,
    settings: DiagnosisSettings = DEFAULT,
) -> Plan:
    """Predict the smallest detectable size of each effect in a recording of a scenario, and which effects look alike.

    Raises an `InputError` if an effect is unknown or an extra maneuver cannot follow the scenario.

    Parameters
    ----------
    scenario : the maneuver plan, with the gyro's and the references' noise
    effects : names of the effects to evaluate; all by default
    extras : extra maneuvers by name, each a list of interval sections; those of `list_maneuvers` by default, none if empty
    progress : called with a text and the share done
    seed : seed of the random draws
    settings : thresholds and priors of the later diagnosis
    """
    began = time.perf_counter()
    report = progress or (lambda text, share: None)
    for name in effects or ():
        if name not in EFFECTS:
            raise InputError(f"{name}: no such effect; there are {', '.join(EFFECTS)}")
    names = [name for name in EFFECTS if not effects or name in effects]
    extended_scenarios = {
        name: append_intervals(scenario, parts)
        for name, parts in (list_maneuvers(scenario) if extras is None else extras).items()
    }
    report("linear model", 0.0)
    model = linearise_noise_free(scenario)
    signatures = build_signatures(model, names)
    report("candidates", 0.05)
    power = DetectionPower(build_linear_model(model, list(EFFECTS.values()), settings=settings, scan=False), seed, settings)
    report("smallest visible sizes", 0.15)
    visible = []
    for number, signature in enumerate(signatures):
        report("smallest visible sizes", 0.15 + 0.55 * number / len(signatures))
        visible.append(find_visible_size(signature, power))
    visible += list_unavailable_effects(model, [EFFECTS[name] for name in names])
    report("pairs", 0.7)
    pairs = list_pairs(signatures, visible)
    evaluated = []
    for number, (name, extended) in enumerate(extended_scenarios.items()):
        report(f"extra: {name}", 0.7 + 0.3 * number / len(extended_scenarios))
        evaluated.append(evaluate_extra(name, scenario, extended, model, signatures, visible, pairs))
    order = {name: number for number, name in enumerate(EFFECTS)}
    return Plan(
        scenario=scenario.title,
        false_alarm_rate=settings.false_alarm_rate,
        threshold=power.threshold,
        degrees_of_freedom=model.degrees_of_freedom,
        effects=tuple(sorted(visible, key=lambda size: (order[size.effect], size.label))),
        pairs=tuple(pairs),
        extras=tuple(sorted(evaluated, key=lambda extra: (extra.ratio, -len(extra.resolved)))),
        notes=_write_plan_notes(scenario, model),
        runtime_s=time.perf_counter() - began,
    )


def _write_plan_notes(scenario: Scenario, model: RecordingModel) -> tuple[str, ...]:
    notes = []
    if scenario.reference.at == "ends":
        notes.append(
            f"References only at the ends of {len(model.blocks)} intervals: {model.degrees_of_freedom} degrees of freedom are "
            "left beside the calibration; what happens inside an interval shows only by its sum, and few effects can be told "
            "from one another"
        )
    notes += [
        *describe_unobserved(model),
        "Sizes of effects that show in the samples, or in the noise of the references, are not computed",
        "Not identifiable from any recording: a constant offset of all references, the same as a turn of G and the start "
        "attitudes; constant errors of G and b, which are calibrated away",
        "What follows a temperature is as with the simulator's own gyro temperature; a recording without housekeeping shows it "
        "only as something unknown",
    ]
    return tuple(notes)
