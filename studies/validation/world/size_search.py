"""Giving an effect numbers and a size with which it shows as strongly as is wanted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gyrocal.errors import InputError
from simulator.effects import Effect, Setting, setting
from simulator.effects.base import Value
from simulator.effects.common import log_uniform
from studies.validation.world.families import Family
from studies.validation.world.world import World

EVIDENCE_TOLERANCE = 0.1  # of the logarithm of the evidence; where an effect jumps, anything in the range will do
STEPS, TRIES = 9, 4


def search_settings(world: World, effect: Effect) -> Iterator[tuple[Setting, float]]:
    """Settings of an effect that can act here, with their evidence.

    An effect that draws its own size keeps it where its evidence is in the range, or where no other size leads there.
    """
    if effect.missing(world.surroundings) is not None:
        return
    rng, snr = world.rng(f"draw:{effect.name}"), world.spec.snr
    sizes = max(effect.prior[0], effect.bounds[0]), min(effect.prior[1], effect.bounds[1])
    for _ in range(TRIES):
        target = log_uniform(rng, *snr)
        axis, parameters = effect.draw(rng, world.surroundings)
        sign = 1.0 if effect.sign == "positive" or effect.bounds[0] >= 0 or rng.random() < 0.5 else -1.0
        size = effect.draw_size(rng, world.surroundings, axis)

        def make_setting(size: float, axis: str | None = axis, parameters: dict[str, Value] = parameters) -> Setting:
            return _normalise_amplitudes(effect, effect.completed(_build_setting(effect, axis, size, parameters)))

        def strength(size: float, made: Callable[[float], Setting] = make_setting) -> float:
            return world.strength(made(size))

        try:
            own = None if size is None else (size, strength(size))
            fits = own is not None and snr[0] <= own[1] <= snr[1]
            found = own if fits else search_size(strength, sign, target, sizes, snr)
            if found is None and own is not None and own[1] > snr[1]:
                found = own
        except InputError:  # it does nothing here with these numbers
            continue
        if found is not None:
            yield make_setting(found[0]), found[1]


def _build_setting(effect: Effect, axis: str | None, size: float, parameters: dict[str, Value]) -> Setting:
    """A setting; that of a family outside the library has all its numbers drawn."""
    if isinstance(effect, Family):
        return Setting(effect.name, axis, size, parameters)
    return setting(effect.name, axis, size, parameters)


def _normalise_amplitudes(effect: Effect, one: Setting) -> Setting:
    """With what its amplitudes hold as they give it, such as a positive size where a phase has the sign."""
    if not effect.has_columns:
        return one
    size, held = effect.from_amplitudes(effect.amplitudes(one))
    return replace(one, size=size, parameters={**one.parameters, **held})


def search_size(
    strength: Callable[[float], float], sign: float, target: float, sizes: tuple[float, float], snr: tuple[float, float]
) -> tuple[float, float] | None:
    """Size, and its evidence, near a target: secants in the logarithms, from a small size."""
    size, last = sizes[0], None
    for _ in range(STEPS):
        norm = strength(sign * size)
        if norm > 0 and abs(np.log(norm / target)) < EVIDENCE_TOLERANCE:
            return sign * size, norm
        slope = 1.0
        if last and norm > 0 and last[1] > 0 and norm != last[1] and size != last[0]:
            slope = float(np.clip(np.log(norm / last[1]) / np.log(size / last[0]), 0.3, 3.0))
        step = float(np.clip(np.log(target / norm) / slope, -16.0, 16.0)) if norm > 0 else np.log(30.0)
        last = (size, norm)
        size = float(np.clip(size * np.exp(step), *sizes))
        if size == last[0]:
            break
    norm = last[1] if last else 0.0
    inside = last is not None and snr[0] <= norm <= snr[1]
    return (sign * last[0], norm) if inside and last else None
