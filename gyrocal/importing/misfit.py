"""Where in time rates and attitudes differ, and which simple fault explains the difference.

The mean rates of windows by attitudes and gyro differ by e = w_ref − w. Each fault below is fitted to e by least squares, those
at an unknown time at every one of `TIMES`. The fault that leaves least is named if it leaves at most `EXPLAINED` of e, and one
with fewer numbers if it leaves nearly as little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from gyrocal.arrays import Array, Mask
from gyrocal.importing.motion import Motion
from gyrocal.importing.units import format_degrees

EXPLAINED = 0.5  # of e without the fault: RMS left
AS_GOOD = 1.5  # times the least that is left
TIMES = 60
LEVELS = 40  # of clipping
LEAST_CLIPPED = 0.005  # of the windows on an axis
HALF = 0.5  # of the misfit's square, whose shortest time is said


class Fault(NamedTuple):
    """A fault and how much of the misfit it leaves."""

    kind: str  # "bias", "scale", "step", "jump", "factors" or "clipping"
    words: str  # what it is, with its numbers
    left: float  # RMS of e with the fault over that of e
    bias: Array | None = None  # (3,) rad/s that is missing, of a constant bias


def explain_misfit(windows: Motion) -> Fault | None:
    """Find the simplest fault that explains most of the misfit; None if there is none."""
    gyro, inside = windows.gyro()
    reference, gyro = windows.attitudes()[inside], gyro[inside]
    e = reference - gyro
    raw = float(np.sqrt(np.sum(e * e)))
    if len(e) < 8 or not raw > 0:
        return None
    bias = e.mean(axis=0)
    beside = float(np.sqrt(np.sum(np.square(e - bias)))) / raw
    found = [Fault("bias", f"a bias of {format_degrees(bias)} deg/s", beside, bias)]
    for kind, words, values in _list_faults(windows, reference, gyro, inside):
        left = float(np.sqrt(np.sum(values * values))) / raw
        # A constant bias is there whatever else is: beside it the others must explain what it leaves.
        if left <= EXPLAINED * beside:
            found.append(Fault(kind, words, left))
    least = min(one.left for one in found)
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


def _list_faults(windows: Motion, reference: Array, gyro: Array, inside: Mask) -> Iterator[tuple[str, str, Array]]:
    """Kind and words of each fault beside a bias, that with the fewest numbers first, and what it leaves (n, 3) of e."""
    middle = (0.5 * (windows.start_s + windows.stop_s))[inside]
    r0, g0 = reference - reference.mean(axis=0), gyro - gyro.mean(axis=0)
    rest = (reference - gyro) - (reference - gyro).mean(axis=0)
    scale = float(np.sum(r0 * g0) / max(np.sum(g0 * g0), 1e-300))
    yield "scale", f"the rates times {scale:.4g}", r0 - scale * g0
    h = 0.25 * float(np.median(windows.stop_s - windows.start_s))
    slope = (windows.gyro(h)[0][inside] - windows.gyro(-h)[0][inside]) / (2 * h)

    def fit_bias(part: Mask) -> tuple[Array, Array]:
        bias = rest[part].mean(axis=0)
        return bias, rest[part] - bias

    def fit_offset(part: Mask) -> tuple[float, Array]:
        tau = np.sum(rest[part] * slope[part]) / max(np.sum(np.square(slope[part])), 1e-300)
        return tau, rest[part] - tau * slope[part]

    def fit_factor(part: Mask) -> tuple[float, Array]:
        r, g = (one[part] - one[part].mean(axis=0) for one in (reference, gyro))
        factor = np.sum(r * g) / max(np.sum(g * g), 1e-300)
        return factor, r - factor * g

    if np.unique(middle).size > 8:
        when, a, b, left = _find_time(fit_bias, middle)
        yield "step", f"a step of the bias by {format_degrees(b - a)} deg/s at {when:.6g} s", left
        when, a, b, left = _find_time(fit_offset, middle)
        yield "jump", f"a clock that jumped by {b - a:+.3g} s at {when:.6g} s (time offset {a:+.3g} s before)", left
        when, a, b, left = _find_time(fit_factor, middle)
        words = f"rates that are to be taken times {a:.4g} before {when:.6g} s and times {b:.4g} after it"
        yield "factors", words, left
    yield "clipping", *_find_clipping(reference, gyro)


def _find_time(fit: Callable[[Mask], tuple[Any, Array]], middle: Array) -> tuple[float, Any, Any, Array]:
    """The time at which fits of both parts leave least, what each fit finds, and what they leave."""
    found = []
    for when in np.linspace(middle[0], middle[-1], TIMES + 2)[1:-1]:
        before = middle < when
        (a, left), (b, right) = fit(before), fit(~before)
        found.append((float(when), a, b, np.concatenate([left, right])))
    return min(found, key=lambda one: float(np.sum(np.square(one[3]))))


def _find_clipping(reference: Array, gyro: Array) -> tuple[str, Array]:
    """The axis and level at which readings of the gyro that stop best explain the misfit, in words, and what is left."""
    least, words, best = np.inf, "", reference
    e = reference - gyro
    for k, name in enumerate("xyz"):
        size = np.abs(reference[:, k])
        for level in np.quantile(size, np.linspace(0.5, 1 - LEAST_CLIPPED, LEVELS)):
            over = size > level
            expected = np.sign(reference[:, k]) * np.maximum(size - level, 0.0)
            values = e.copy()
            values[:, k] -= expected
            values -= np.median(values, axis=0)
            if np.sum(values * values) < least:
                least, best = float(np.sum(values * values)), values
                words = (
                    f"clipping of the gyro about {name} at {np.rad2deg(level):.3g} deg/s, which the attitudes exceed in "
                    f"{100 * over.mean():.0f} % of the windows"
                )
    return words, best
