"""The effects that are undone, rung by rung, and how each is undone in the samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gyrocal import Recording
from simulator.effects.gyro import rate_truncation, stale_samples, time_offset
from studies.validation.real_gyro.trials import Loaded

Array = NDArray[np.float64]

LATE, TRUNCATED, STALE = (module.EFFECT.name for module in (time_offset, rate_truncation, stale_samples))
LADDER = (LATE, TRUNCATED, STALE)


@dataclass(frozen=True)
class Found:
    """What the diagnoses of some trials name.

    Attributes
    ----------
    effects : of the ladder, in its order
    step : of the truncation, rad/s; 0 without it
    mean_run, fraction : of the stale samples
    """

    effects: tuple[str, ...]
    step: float = 0.0
    mean_run: float = 1.0
    fraction: float = 0.0


def rungs(found: Found) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Name of each rung and the effects in it; one that was not found adds nothing."""
    yield "M0", ()
    so_far: tuple[str, ...] = ()
    for effect in LADDER:
        so_far = (*so_far, effect) if effect in found.effects else so_far
        yield f"+ {effect}", so_far


def untruncated(rates: Array, step: float) -> Array:
    """Rates cut toward zero, put in the middle of what they stand for: half a step further from zero, but for zero itself."""
    return rates + 0.5 * step * np.sign(np.rint(rates / step))


def repeats(rates: Array) -> NDArray[np.bool_]:
    """(n,) samples that repeat the one before on all axes."""
    out = np.zeros(len(rates), dtype=bool)
    out[1:] = (rates[1:] == rates[:-1]).all(axis=1)
    return out


def filled(rates: Array, bad: NDArray[np.bool_]) -> Array:
    """Rates with the line between the neighbours in place of bad samples."""
    t = np.arange(len(rates))
    out = rates.copy()
    for axis in range(3):
        out[bad, axis] = np.interp(t[bad], t[~bad], rates[~bad, axis])
    return out


def repaired(loaded: Loaded, rung: Sequence[str], found: Found) -> Recording:
    """Samples with the rung's effects undone and the mean of the first rest taken off; tags untouched.

    A sample that repeats the one before on all axes is replaced by the line between its neighbours. At rest some do so by
    chance; the line then takes the place of noise.
    """
    recording = loaded.recording
    rates = recording.gyro.rates
    bad = repeats(rates)
    if TRUNCATED in rung:
        rates = untruncated(rates, found.step)
    if STALE in rung:
        rates = filled(rates, bad)
    rates = rates - rates[loaded.first_rest].mean(axis=0)
    return replace(recording, gyro=replace(recording.gyro, rates=np.ascontiguousarray(rates)))


def delayed(recording: Recording, offset: float, lag: bool) -> Recording:
    """The recording with its delay undone: tags earlier by a time offset, or a first-order lag inverted, both in s."""
    gyro = recording.gyro
    if not lag:
        return replace(recording, gyro=replace(gyro, t_s=gyro.t_s - offset))
    return replace(recording, gyro=replace(gyro, rates=gyro.rates + offset * np.gradient(gyro.rates, gyro.sample_s, axis=0)))
