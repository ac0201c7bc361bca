"""The measuring chain with effects in it, from noise-free rates and true attitudes to what is recorded.

Rates pass the stages of `simulator.effects.base.STAGES` in their order; white noise is one of them. References: the sum of
white noise (times its excess), columns and correlated errors, e, turns the true attitude to exp([e×]) A. Of several effects at
one stage that changes the samples themselves, the one registered first acts first.

Each effect draws from a stream of its own, named after its label, so that adding one leaves the draws of all else as they
were. Of two with the same label, such as two steps on one axis, the second has "#2" after its name.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import STAGES, Array, Effect, Setting, Surroundings
from simulator.effects.registry import REGISTRY
from simulator.sensors.gyro import add_white_noise
from simulator.streams import generator
from simulator.truth.rotation import apply_rotation_errors


@dataclass(frozen=True)
class ActiveEffect:
    """An effect at work: its definition, its numbers and its random stream."""

    effect: Effect
    setting: Setting
    rng: np.random.Generator


def prepare_effects(settings: Sequence[Setting], seed: int, case: int) -> list[ActiveEffect]:
    """Prepare effects with their random streams."""
    label_counts: Counter[str] = Counter()
    out = []
    for setting in settings:
        label = setting.label()
        label_counts[label] += 1
        name = label if label_counts[label] == 1 else f"{label}#{label_counts[label]}"
        effect = REGISTRY[setting.effect]
        if effect.stage == "sensor":
            raise InputError(f"{label}: acts on raw sensor tables, not on rates and references")
        out.append(ActiveEffect(effect, setting, generator(seed, case, f"effect:{name}")))
    return out


def simulate_readings(around: Surroundings, active: Sequence[ActiveEffect], rng: np.random.Generator | None) -> Array:
    """Simulate raw samples as recorded, (n, 3) rad/s; rng is the source of the white noise, None for none."""
    raw = around.stream.raw
    for stage in STAGES:
        if stage.name == "white_noise":
            raw = raw + _draw_white_noise(around, active, rng)
            continue
        for entry in _select_stage(active, stage.name):
            raw = _apply_method(entry, raw, around, stage.calls)
    return raw


def _apply_method(entry: ActiveEffect, raw: Array, around: Surroundings, method: str) -> Array:
    """Apply one effect to raw readings."""
    if method == "columns":
        return raw + _evaluate_columns(entry, around)
    if method == "wander":
        return raw + entry.effect.wander(entry.rng, around.stream, entry.setting)
    if method == "retimed":
        return entry.effect.retimed(raw, around.stream, entry.setting)
    if method == "apply":
        return entry.effect.apply(entry.rng, raw, around.stream, entry.setting)
    return raw


def _draw_white_noise(around: Surroundings, active: Sequence[ActiveEffect], rng: np.random.Generator | None) -> Array:
    if rng is None:
        return np.zeros(3)
    noise = add_white_noise(rng, np.zeros_like(around.stream.raw), around.arw, around.stream.duration_s)
    return noise * _multiply_noise_factors(active, "white_noise")


def simulate_references(around: Surroundings, active: Sequence[ActiveEffect], rng: np.random.Generator | None) -> Array:
    """Simulate reference attitudes as recorded, (m, 4); rng is the source of the white errors, None for none."""
    references = around.references
    error = np.zeros((len(references.t_s), 3))
    if rng is not None:
        factor = _multiply_noise_factors(active, "reference_noise")
        error = rng.standard_normal(error.shape) * around.reference_sigma * factor
        if around.reference_axes is not None:
            error = np.einsum("mij,mj->mi", around.reference_axes, error)
    for entry in active:
        if entry.effect.stage == "reference":
            error = error + _evaluate_columns(entry, around)
        elif entry.effect.stage == "random_reference":
            error = error + entry.effect.reference_wander(entry.rng, references, entry.setting)
    quaternions = apply_rotation_errors(references.quaternions, error) if error.any() else references.quaternions
    for entry in _select_stage(active, "reference_telemetry"):
        quaternions = entry.effect.replace_references(entry.rng, quaternions, references, entry.setting)
    return quaternions


def _select_stage(active: Sequence[ActiveEffect], stage: str) -> list[ActiveEffect]:
    """Select the effects at one stage; those that change samples come in the order of the registry, others after them."""
    at_stage = [entry for entry in active if entry.effect.stage == stage]
    if len(at_stage) > 1 and at_stage[0].effect.implements("apply"):
        order = list(REGISTRY)
        at_stage.sort(key=lambda entry: order.index(entry.effect.name) if entry.effect.name in order else len(order))
    return at_stage


def _multiply_noise_factors(active: Sequence[ActiveEffect], stage: str) -> Array:
    """Multiply the factors of each axis' white noise by all effects at a stage, (3,)."""
    factor = np.ones(3)
    for entry in _select_stage(active, stage):
        factor *= entry.effect.noise_factor(entry.setting)
    return factor


def _evaluate_columns(entry: ActiveEffect, around: Surroundings) -> Array:
    """Multiply columns by amplitudes; an `InputError` for an effect that does nothing here."""
    effect, setting = entry.effect, entry.setting
    _check_step_time(entry, around)
    try:
        if effect.on_references:
            columns = effect.reference_columns(around.references, setting.axis, setting.parameters)
        else:
            columns = effect.columns(around.stream, setting.axis, setting.parameters)
    except KeyError as error:  # an effect that takes a housekeeping column by its name
        reason = effect.missing(around)
        if reason is None:
            raise
        raise InputError(f"{setting.label()}: does nothing here; {reason}") from error
    if not np.isfinite(columns).all() or not columns.any():
        reason = effect.missing(around) or "what it follows is zero throughout"
        raise InputError(f"{setting.label()}: does nothing here; {reason}")
    return np.asarray(columns @ effect.amplitudes(setting))


def _check_step_time(entry: ActiveEffect, around: Surroundings) -> None:
    """Refuse a step before the first sample or after the last."""
    if not entry.effect.switched:
        return
    time, (first, last) = float(entry.setting.parameters["time_s"]), around.stream.span_s
    if not first < time < last:
        raise InputError(
            f"{entry.setting.label()}: does nothing here; time_s {time:g} is not within the recording's {first:g} to {last:g} s"
        )
