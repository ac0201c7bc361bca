"""Where in time rates and attitudes differ, and which simple fault explains the difference.

The mean rates of windows by attitudes and gyro differ by e = w_ref − w. Each fault below is fitted to e by least squares, those
at an unknown time at every one of `TIMES`. The fault that leaves least is named if it leaves at most `EXPLAINED` of e, and one
with fewer numbers if it leaves nearly as little.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrocal.importing.motion import Motion
from gyrocal.importing.units import format_degrees

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EXPLAINED = 0.5  # of e without the fault: RMS left
AS_GOOD = 1.5  # times the least that is left
TIMES = 60
LEVELS = 40  # of clipping
LEAST_CLIPPED = 0.005  # of the windows on an axis
HALF = 0.5  # of the misfit's square, whose shortest time is said


@dataclass(frozen=True)
class Fault:
    """A fault and how much of the misfit it leaves."""

    kind: str  # "bias", "scale", "step", "jump", "factors" or "clipping"
    words: str  # what it is, with its numbers
    left: float  # RMS of e with the fault over that of e
    bias: Array | None = None  # (3,) rad/s that is missing, of a constant bias


def explain_misfit(windows: Motion) -> Fault | None:
    """Find the simplest fault that explains most of the misfit; None if there is none."""
    found = _list_faults(windows)
    least = min((one.left for one in found), default=np.inf)
    if least > EXPLAINED:
        return None
    return next(one for one in found if one.left <= max(AS_GOOD * least, least + 0.02))


def locate_misfit(windows: Motion) -> str:
    """The shortest stretch of time with half of the misfit's square, in words."""
    gyro, inside = windows.gyro()
    e = (windows.attitudes() - gyro)[inside]
    start, stop = windows.start_s[inside], windows.stop_s[inside]
    square = np.sum(np.square(e - np.median(e, axis=0)), axis=1)
    if not square.sum() > 0:
        return ""
    total = np.concatenate([[0.0], np.cumsum(square)]) / square.sum()
    ends = np.minimum(np.searchsorted(total, total[:-1] + HALF), square.size)
    good = total[ends] >= total[:-1] + HALF - 1e-9
    length = np.where(good, stop[np.maximum(ends - 1, 0)] - start, np.inf)
    k = int(np.argmin(length))
    first, last = float(start[k]), float(stop[max(ends[k] - 1, 0)])
    whole = float(stop[-1] - start[0])
    return f"half of the misfit lies between {first:.6g} and {last:.6g} s, {100 * (last - first) / whole:.0f} % of the time"


def _list_faults(windows: Motion) -> list[Fault]:
    """All faults, that with the fewest numbers first."""
    gyro, inside = windows.gyro()
    reference, gyro = windows.attitudes()[inside], gyro[inside]
    middle = (0.5 * (windows.start_s + windows.stop_s))[inside]
    e = reference - gyro
    raw = float(np.sqrt(np.sum(e * e)))
    if len(e) < 8 or not raw > 0:
        return []
    bias = e.mean(axis=0)
    rest = e - bias
    whole = float(np.sqrt(np.sum(rest * rest)))

    def compute_rest(values: Array) -> float:
        return float(np.sqrt(np.sum(values * values))) / raw

    out = [Fault("bias", f"a bias of {format_degrees(bias)} deg/s", compute_rest(rest), bias)]
    r0, g0 = reference - reference.mean(axis=0), gyro - gyro.mean(axis=0)
    scale = float(np.sum(r0 * g0) / max(np.sum(g0 * g0), 1e-300))
    out.append(Fault("scale", f"the rates times {scale:.4g}", compute_rest(r0 - scale * g0)))
    step = _find_step(rest, middle)
    if step is not None:
        when, jump, values = step
        words = f"a step of the bias by {format_degrees(jump)} deg/s at {when:.6g} s"
        out.append(Fault("step", words, compute_rest(values)))
    h = 0.25 * float(np.median(windows.stop_s - windows.start_s))
    later, sooner = windows.gyro(h)[0][inside], windows.gyro(-h)[0][inside]
    clock = _find_jump(rest, (later - sooner) / (2 * h), middle)
    if clock is not None:
        when, (before, after), values = clock
        words = f"a clock that jumped by {after - before:+.3g} s at {when:.6g} s (time offset {before:+.3g} s before)"
        out.append(Fault("jump", words, compute_rest(values)))
    changed = _find_change_of_factor(reference, gyro, middle)
    if changed is not None:
        when, (before, after), values = changed
        words = f"rates that are to be taken times {before:.4g} before {when:.6g} s and times {after:.4g} after it"
        out.append(Fault("factors", words, compute_rest(values)))
    clipped = _find_clipping(reference, gyro)
    if clipped is not None:
        out.append(Fault("clipping", clipped[0], compute_rest(clipped[1])))
    # A constant bias is there whatever else is: beside it the others must explain what it leaves.
    return [one for one in out if one.kind == "bias" or one.left <= EXPLAINED * whole / raw]


def _find_step(rest: Array, middle: Array) -> tuple[float, Array, Array] | None:
    """Time of a step, its size (3,), and what it leaves."""

    def fit(before: Mask) -> tuple[Array, Array]:
        a, b = rest[before].mean(axis=0), rest[~before].mean(axis=0)
        return b - a, rest - np.where(before[:, None], a, b)

    return _find_time(fit, middle)


def _find_jump(rest: Array, slope: Array, middle: Array) -> tuple[float, Array, Array] | None:
    """Time of a jump of the clock, offsets before and after, and what it leaves."""

    def fit(before: Mask) -> tuple[Array, Array]:
        tau = np.array(
            [np.sum(rest[part] * slope[part]) / max(np.sum(np.square(slope[part])), 1e-300) for part in (before, ~before)]
        )
        return tau, rest - np.where(before, *tau)[:, None] * slope

    return _find_time(fit, middle)


def _find_change_of_factor(reference: Array, gyro: Array, middle: Array) -> tuple[float, Array, Array] | None:
    """Time at which the factor of the rates changes, the factors before and after, and what they leave."""

    def fit(before: Mask) -> tuple[Array, Array]:
        factors, left = np.ones(2), reference - reference.mean(axis=0)
        for k, part in enumerate((before, ~before)):
            r, g = (one[part] - one[part].mean(axis=0) for one in (reference, gyro))
            factors[k] = np.sum(r * g) / max(np.sum(g * g), 1e-300)
            left[part] = r - factors[k] * g
        return factors, left

    return _find_time(fit, middle)


def _find_time(fit: Callable[[Mask], tuple[Array, Array]], middle: Array) -> tuple[float, Array, Array] | None:
    """The time at which a fit of two parts leaves least, with what it finds and leaves."""
    found = [(float(when), *fit(middle < when)) for when in _list_times(middle)]
    return min(found, key=lambda one: float(np.sum(np.square(one[2]))), default=None)


def _list_times(middle: Array) -> Array:
    return np.linspace(middle[0], middle[-1], TIMES + 2)[1:-1] if np.unique(middle).size > 8 else np.zeros(0)


def _find_clipping(reference: Array, gyro: Array) -> tuple[str, Array] | None:
    """The axis and level at which readings of the gyro that stop best explain the misfit, in words, and what is left."""
    best: tuple[float, str, Array] | None = None
    e = reference - gyro
    for k, name in enumerate("xyz"):
        size = np.abs(reference[:, k])
        for level in np.quantile(size, np.linspace(0.5, 1 - LEAST_CLIPPED, LEVELS)):
            over = size > level
            expected = np.sign(reference[:, k]) * np.maximum(size - level, 0.0)
            values = e.copy()
            values[:, k] -= expected
            values -= np.median(values, axis=0)
            square = float(np.sum(values * values))
            if best is None or square < best[0]:
                words = (
                    f"clipping of the gyro about {name} at {np.rad2deg(level):.3g} deg/s, which the attitudes exceed in "
                    f"{100 * over.mean():.0f} % of the windows"
                )
                best = (square, words, values)
    return None if best is None else best[1:]
