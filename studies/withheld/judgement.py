"""What an answer is worth: its stated causes beside the effects of the case.

A stated cause is right if it is there, or if its waveform leaves at most 2 % of the power of an effect that is there. The same
rule says what counts as outside the library: a withheld effect may be named as one that reproduces it. A random error without a
name, of which side and axis are stated, is right if an effect acts there, and finds those that its group holds.
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


def measure_left_power(world: World, one: Setting, cause: Cause) -> float:
    """Share of an effect's power that a stated cause leaves, with the cause's own numbers and any size."""
    effect = EFFECTS[cause["effect"]]
    shown = world.respond(world.change(one))
    given: dict[str, Value] = {p.name: p.default for p in effect.parameters if p.default is not None} | cause["parameters"]
    stated = Setting(effect.name, cause["axis"], cause["size"], given)
    try:
        changes = _list_column_changes(world, effect, stated) if effect.has_columns else [world.change(stated)]
        columns = np.stack([world.respond(change) for change in changes], axis=1)
    except InputError:
        return 1.0
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    taken = u[:, s > 1e-9 * max(float(s[0]), 1e-300)].T @ shown
    return float(1 - taken @ taken / max(float(shown @ shown), 1e-300))


def _list_column_changes(world: World, effect: Effect, stated: Setting) -> list[Change]:
    raw, reference = np.zeros_like(world.around.stream.raw), np.zeros((len(world.around.references.t_s), 3))
    if effect.on_references:
        columns = effect.reference_columns(world.around.references, stated.axis, stated.parameters)
        return [Change(raw, one) for one in np.moveaxis(columns, 2, 0)]
    columns = effect.columns(world.around.stream, stated.axis, stated.parameters)
    return [Change(one, reference) for one in np.moveaxis(columns, 2, 0)]


def judge_causes(drawn: DrawnCase, causes: Sequence[Cause]) -> list[dict[str, Any]]:
    """Compare each stated cause with the simulated effects; `hits` and `near` hold the effects' numbers.

    `hits`: effects that a named cause equals or reproduces but for `SAME_POWER`, or random ones that a cause stated by side has
    in its group. `near`: effects on the same side and axis. Effects with one symptom are one answer, stated by its group.
    """
    out = []
    for cause in causes:
        named = "effect" in cause
        names = list_effects_with_symptom_of(cause["effect"]) if named else []
        side = find_side(cause["effect"] if named else cause["group"][0].partition(":")[0])
        hits, near = [], []
        for number, effect in enumerate(drawn.settings):
            equal_axis = effect.axis is None or effect.axis == cause["axis"]
            if (equal_axis or cause["axis"] is None) and find_side(effect.effect) == side:
                near.append(number)
            equal = equal_axis and effect.effect in names
            alike = equal or (named and measure_left_power(drawn.world, effect, cause) <= SAME_POWER)
            random = effect.effect in EFFECTS and EFFECTS[effect.effect].is_process
            if alike or (not named and random and effect.label() in cause["group"]):
                hits.append(number)
        label = Setting(cause["effect"], cause["axis"], 0.0).label() if named else label_by_character(cause["group"][0])
        in_set = bool(hits) or any(effect.label() in cause["group"] for effect in drawn.settings)
        judged = {"named": named, "right": bool(hits if named else near), "in_set": in_set, "hits": hits, "near": near}
        out.append({"cause": label, "p": cause["group_probability" if len(names) > 1 else "probability"], **judged})
    return out


def decide_outcome(kind: str, present: bool, count: int, judged: Sequence[Mapping[str, Any]], verdict: str) -> str:
    """Say what becomes of a case.

    ``right``: all that is there is stated and nothing else, or no misfit is seen where there is none; of a mixed case all that
    is stated is there. ``part``: of several effects all that is stated is there, and one is missing. ``localised``: of an
    effect outside the library all causes have its side and axis. ``unknown``, ``missed``, ``alarm``; ``wrong``: the rest.
    """
    if kind == "none":
        return "alarm" if present else "right"
    if not present:
        return "missed"
    if verdict == "unknown" or not judged:
        return "unknown"
    right = all(one["right"] for one in judged)
    if right and (kind == "mixed" or {hit for one in judged for hit in one["hits"]} == set(range(count))):
        return "right"
    if kind in ("withheld", "unlisted"):
        return "localised" if all(one["near"] for one in judged) else "wrong"
    return "part" if right else "wrong"


def list_size_errors(drawn: DrawnCase, causes: Sequence[Cause]) -> list[float]:
    """(size − true size)/sigma of each cause that is there; sizes that are read off the samples are left out."""
    out = []
    for cause in causes:
        for one in drawn.settings:
            same = (cause.get("effect"), cause["axis"]) == (one.effect, one.axis)
            toward = one.parameters.get("toward")
            if same and cause["parameters"].get("toward", toward) == toward and cause["sigma"] > 1e-5 * abs(cause["size"]):
                out.append((cause["size"] - one.size) / cause["sigma"])
    return out


def score_truth(drawn: DrawnCase, scores: Mapping[str, float]) -> float:
    """Conformal score of what is put in; of an effect outside the library, that of unknown or of its side and axis."""
    if drawn.kind in ("none", "single", "pair"):
        random = [find_effect(one.effect).is_process for one in drawn.settings]
        labels = [one.label() for one in drawn.settings]
        stated = [label_by_character(label) if of_one else label for label, of_one in zip(labels, random, strict=True)]
        return scores.get(name_of(stated), MISSING)
    last = drawn.settings[-1]  # the one without a name is drawn last
    character = label_by_character(Setting(find_side(last.effect), last.axis, 0.0).label())
    return min(score for name, score in scores.items() if name == UNKNOWN or character in name.split(" + "))


def measure_true_share(drawn: DrawnCase, details: Details) -> float:
    """Share of the misfit that the stated causes close on further recordings of the same plan with the same effects.

    Noise and random effects are drawn anew. NaN where held-out data show next to no misfit, or samples are left out of these
    recordings.
    """
    gained = whole = dof = 0.0
    for draw in range(1, FURTHER_DRAWS + 1):
        model = prepare(drawn.world.record(drawn.settings, draw), DEFAULT, lambda text, share: None).model
        if any(one.columns.shape[0] != model.size for one in (*details.fitted, *details.beside)):
            continue
        held = predict_held_out(model, details.fitted, details.beside)
        squares = held.squares.sum(axis=0)
        gained, whole, dof = gained + float(squares[0] - squares[-1]), whole + float(squares[0]), dof + float(held.dof.sum())
    return gained / (whole - FLOOR * dof) if dof and whole > LEAST_MISFIT * FLOOR * dof else float("nan")
