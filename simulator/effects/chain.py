"""The measuring chain with effects in it, from noise-free rates and true attitudes to what is recorded.

Rates: columns (bias, scale factor …) → random bias (walk, flicker) → timing (lag, then late tags) → dead zone → white noise
(times its excess) → vibration → spikes → saturation → quantization or truncation → stale telemetry. References: the sum of
white noise (times its excess), columns and correlated errors, e, turns the true attitude to exp([e×]) A.

Each effect draws from a stream of its own, named after its label, so that adding one leaves the draws of all else as they
were. Of two with the same label, such as two steps on one axis, the second has "#2" after its name.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal.errors import InputError
from simulator.effects.base import Array, Effect, References, Setting, Stream
from simulator.effects.registry import EFFECTS
from simulator.sensors.gyro import with_white_noise
from simulator.streams import generator
from simulator.truth.rotation import perturbed

TIMING = ("rate_lag", "time_offset")
BEFORE_NOISE = ("rate_deadzone",)
AFTER_NOISE = ("vibration", "spikes", "rate_saturation", "rate_quantization", "rate_truncation", "stale_samples")


@dataclass(frozen=True)
class Active:
    """An effect at work: its definition, its numbers and its random stream."""

    effect: Effect
    setting: Setting
    rng: np.random.Generator


def activated(settings: Sequence[Setting], seed: int, case: int) -> list[Active]:
    """Effects with their random streams."""
    seen: Counter[str] = Counter()
    out = []
    for setting in settings:
        label = setting.label()
        seen[label] += 1
        name = label if seen[label] == 1 else f"{label}#{seen[label]}"
        out.append(Active(EFFECTS[setting.effect], setting, generator(seed, case, f"effect:{name}")))
    return out


def readings(stream: Stream, active: Sequence[Active], arw: float, rng: np.random.Generator | None) -> Array:
    """Raw samples as recorded.

    Parameters
    ----------
    stream : the noise-free samples
    active : the effects; those on references are passed over
    arw : angle random walk, rad/√s
    rng : source of the white noise; None for none

    Returns
    -------
    (n, 3) rad/s
    """
    raw = stream.raw
    for one in _acting(active, "rates"):
        _check_step_time(one.setting, stream.span_s)
        columns = one.effect.columns(stream, one.setting.axis, one.setting.parameters)
        raw = raw + _seen(one, columns)
    for one in _acting(active, "noise"):
        if not _is_factor(one.effect):
            raw = raw + one.effect.wander(one.rng, stream, one.setting)
    for one in _ordered(active, TIMING):
        raw = one.effect.retimed(raw, stream, one.setting)
    for one in _ordered(active, BEFORE_NOISE):
        raw = one.effect.apply(one.rng, raw, stream, one.setting)
    if rng is not None:
        factor = _factor(active, "noise")
        noise = with_white_noise(rng, np.zeros_like(raw), arw, stream.duration_s)
        raw = raw + noise * factor
    for one in _ordered(active, AFTER_NOISE):
        raw = one.effect.apply(one.rng, raw, stream, one.setting)
    return raw


def referenced(references: References, active: Sequence[Active], sigma: Array, rng: np.random.Generator | None) -> Array:
    """Reference attitudes as recorded.

    Parameters
    ----------
    references : the true attitudes
    active : the effects; those on rates are passed over
    sigma : (3,) or (m, 3) stated standard deviations, rad
    rng : source of the white errors; None for none

    Returns
    -------
    (m, 4) quaternions
    """
    count = len(references.t_s)
    error = np.zeros((count, 3))
    if rng is not None:
        error = rng.standard_normal((count, 3)) * sigma * _factor(active, "references")
    for one in _acting(active, "references"):
        if one.effect.kind == "columns":
            columns = one.effect.reference_columns(references, one.setting.axis, one.setting.parameters)
            error = error + _seen(one, columns)
        elif not _is_factor(one.effect):
            error = error + one.effect.reference_wander(one.rng, references, one.setting)
    return perturbed(references.quaternions, error) if error.any() else references.quaternions


def _acting(active: Sequence[Active], on: str) -> list[Active]:
    return [one for one in active if one.effect.acts_on == on]


def _ordered(active: Sequence[Active], names: tuple[str, ...]) -> list[Active]:
    return sorted((one for one in active if one.effect.name in names), key=lambda one: names.index(one.effect.name))


def _is_factor(effect: Effect) -> bool:
    return effect.unit == "factor"


def _factor(active: Sequence[Active], on: str) -> Array:
    factor = np.ones(3)
    for one in _acting(active, on):
        if _is_factor(one.effect):
            factor = factor * one.effect.noise_factor(one.setting)
    return factor


def _seen(one: Active, columns: Array) -> Array:
    """Columns times amplitudes; an effect that could not act here is an error rather than silently nothing."""
    if not np.isfinite(columns).all():
        raise InputError(f"{one.setting.label()}: the recording does not state its orbit's period, which it needs")
    if not columns.any():
        raise InputError(f"{one.setting.label()}: does nothing here; {_why(one.setting)}")
    return np.asarray(columns @ one.effect.amplitudes(one.setting))


def _check_step_time(setting: Setting, span_s: tuple[float, float]) -> None:
    """A step before the first sample or after the last is none."""
    time = float(setting.parameters.get("time_s", 0.5 * (span_s[0] + span_s[1])))
    if not span_s[0] < time < span_s[1]:
        raise InputError(
            f"{setting.label()}: does nothing here; time_s {time:g} is not within the recording's "
            f"{span_s[0]:g} to {span_s[1]:g} s"
        )


def _why(setting: Setting) -> str:
    if setting.effect == "reference_mode_offset":
        return "no interval's activity says that -x is forward"
    return "what it follows is zero throughout"
