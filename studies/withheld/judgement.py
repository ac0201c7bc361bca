"""Judge an answer: compare its stated causes with the simulated effects of the case.

A stated cause is right if it is simulated, or if its waveform leaves at most 2 % of the power of a simulated effect. The same
rule holds for effects outside the library: a withheld effect may be named as a listed one that reproduces it. A random error
stated only by side and axis is right if an effect acts there, and finds the random effects that are in its group.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from diagnosis.answer import label_by_character
from diagnosis.budget import FLOOR, predict_held_out
from diagnosis.inference.conformal import MISSING, UNKNOWN, name_of
from diagnosis.model.prepare import prepare
from diagnosis.result import Details
from diagnosis.settings import DEFAULT
from gyrocal.errors import InputError
from simulator.effects import EFFECTS, Effect, Setting
from simulator.effects.base import Value
from studies.withheld.drawing import DrawnCase, list_effects_with_symptom_of
from studies.withheld.snr import Change
from studies.withheld.world import World, find_effect, find_side

SAME_POWER = 0.02  # share of an effect's power that a cause may leave to be right in its place
LEAST_MISFIT = 1.05  # of the floor, from which a share of the misfit is measured
FURTHER_DRAWS = 4  # recordings with other noise on which a share is measured

Cause = Mapping[str, Any]


def measure_unexplained_power(world: World, setting: Setting, cause: Cause) -> float:
    """Compute the share of an effect's power that a stated cause leaves unexplained, with the cause's numbers and any size."""
    effect = EFFECTS[cause["effect"]]
    response = world.respond(world.change(setting))
    parameters: dict[str, Value] = {p.name: p.default for p in effect.parameters if p.default is not None} | cause["parameters"]
    stated = Setting(effect.name, cause["axis"], cause["size"], parameters)
    try:
        changes = _list_column_changes(world, effect, stated) if effect.has_columns else [world.change(stated)]
        columns = np.stack([world.respond(change) for change in changes], axis=1)
    except InputError:
        return 1.0
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    explained = u[:, s > 1e-9 * max(float(s[0]), 1e-300)].T @ response
    return float(1 - explained @ explained / max(float(response @ response), 1e-300))


def _list_column_changes(world: World, effect: Effect, stated: Setting) -> list[Change]:
    raw, reference = np.zeros_like(world.around.stream.raw), np.zeros((len(world.around.references.t_s), 3))
    if effect.on_references:
        columns = effect.reference_columns(world.around.references, stated.axis, stated.parameters)
        return [Change(raw, column) for column in np.moveaxis(columns, 2, 0)]
    columns = effect.columns(world.around.stream, stated.axis, stated.parameters)
    return [Change(column, reference) for column in np.moveaxis(columns, 2, 0)]


def judge_causes(drawn: DrawnCase, causes: Sequence[Cause]) -> list[dict[str, Any]]:
    """Compare each stated cause with the simulated effects; `hits` and `near` hold the effects' numbers.

    `hits`: effects that a named cause equals or reproduces but for `SAME_POWER`, or random ones that a cause stated by side has
    in its group. `near`: effects on the same side and axis. Effects with one symptom are one answer, stated by its group.
    """
    judgements = []
    for cause in causes:
        named = "effect" in cause
        names = list_effects_with_symptom_of(cause["effect"]) if named else []
        side = find_side(cause["effect"] if named else cause["group"][0].partition(":")[0])
        hits, near = [], []
        for number, effect in enumerate(drawn.settings):
            equal_axis = effect.axis is None or effect.axis == cause["axis"]
            if (equal_axis or cause["axis"] is None) and find_side(effect.effect) == side:
                near.append(number)
            has_name_and_axis = equal_axis and effect.effect in names
            is_reproduced = has_name_and_axis or (named and measure_unexplained_power(drawn.world, effect, cause) <= SAME_POWER)
            random = effect.effect in EFFECTS and EFFECTS[effect.effect].is_process
            if is_reproduced or (not named and random and effect.label() in cause["group"]):
                hits.append(number)
        label = Setting(cause["effect"], cause["axis"], 0.0).label() if named else label_by_character(cause["group"][0])
        in_set = bool(hits) or any(effect.label() in cause["group"] for effect in drawn.settings)
        judged = {"named": named, "right": bool(hits if named else near), "in_set": in_set, "hits": hits, "near": near}
        judgements.append({"cause": label, "p": cause["group_probability" if len(names) > 1 else "probability"], **judged})
    return judgements


def decide_outcome(kind: str, present: bool, count: int, judged: Sequence[Mapping[str, Any]], verdict: str) -> str:
    """Decide the outcome of a case.

    ``right``: the stated causes are the simulated effects, or no misfit is seen where there is none; in a mixed case all stated
    causes are simulated. ``part``: all stated causes are simulated, but an effect is missing. ``localised``: all causes have
    the side and axis of an effect outside the library. ``unknown``, ``missed``, ``alarm``; ``wrong``: the rest.
    """
    if kind == "none":
        return "alarm" if present else "right"
    if not present:
        return "missed"
    if verdict == "unknown" or not judged:
        return "unknown"
    right = all(cause["right"] for cause in judged)
    if right and (kind == "mixed" or {hit for cause in judged for hit in cause["hits"]} == set(range(count))):
        return "right"
    if kind in ("withheld", "unlisted"):
        return "localised" if all(cause["near"] for cause in judged) else "wrong"
    return "part" if right else "wrong"


def list_size_errors(drawn: DrawnCase, causes: Sequence[Cause]) -> list[float]:
    """List (size − true size)/sigma of each cause that is simulated; exact sizes, read off the samples, are left out."""
    out = []
    for cause in causes:
        for setting in drawn.settings:
            same = (cause.get("effect"), cause["axis"]) == (setting.effect, setting.axis)
            toward = setting.parameters.get("toward")
            if same and cause["parameters"].get("toward", toward) == toward and cause["sigma"] > 1e-5 * abs(cause["size"]):
                out.append((cause["size"] - setting.size) / cause["sigma"])
    return out


def score_truth(drawn: DrawnCase, scores: Mapping[str, float]) -> float:
    """Return the conformal score of the simulated effects; outside the library, that of unknown or of its side and axis."""
    if drawn.kind in ("none", "single", "pair"):
        is_random = [find_effect(setting.effect).is_process for setting in drawn.settings]
        labels = [setting.label() for setting in drawn.settings]
        stated = [label_by_character(label) if random else label for label, random in zip(labels, is_random, strict=True)]
        return scores.get(name_of(stated), MISSING)
    last = drawn.settings[-1]  # the effect outside the library is drawn last
    character = label_by_character(Setting(find_side(last.effect), last.axis, 0.0).label())
    return min(score for name, score in scores.items() if name == UNKNOWN or character in name.split(" + "))


def measure_true_share(drawn: DrawnCase, details: Details) -> float:
    """Measure the share of the misfit that the stated causes close on further recordings of the same plan and effects.

    Noise and random effects are drawn again. NaN where held-out data show hardly any misfit, or samples are left out of these
    recordings.
    """
    closed = misfit = dof = 0.0
    for draw in range(1, FURTHER_DRAWS + 1):
        model = prepare(drawn.world.record(drawn.settings, draw), DEFAULT, lambda text, share: None).model
        if any(effect.columns.shape[0] != model.size for effect in (*details.fitted, *details.unnamed)):
            continue
        prediction = predict_held_out(model, details.fitted, details.unnamed)
        squares = prediction.squares.sum(axis=0)
        closed, misfit = closed + float(squares[0] - squares[-1]), misfit + float(squares[0])
        dof += float(prediction.dof.sum())
    return closed / (misfit - FLOOR * dof) if dof and misfit > LEAST_MISFIT * FLOOR * dof else float("nan")
