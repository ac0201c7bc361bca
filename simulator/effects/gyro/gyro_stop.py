"""Gyro that stops at a level for a while and resumes: the reading is size from begin_s to end_s, whatever the motion.

A converter or a supply that drops out, or a driver that puts out the zero level. Such a stretch carries no rate, and a
diagnosis takes it out. It differs

- from a steady rate by the references, which the gyro's turn does not fit there and fits before and after;
- from a saturation in that the true rate is not beyond the largest reading;
- from a dead zone in that the gyro reads rates as small elsewhere;
- from repeated samples in that the level does not go on from the reading before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal.jit_cache import compile_cached
from simulator.effects.base import AXIS_NAMES, Array, Detection, Effect, Fault, Parameter, Setting, Stream, Surroundings, Value
from simulator.effects.common import DEG, number, select_axes
from simulator.effects.innovations import Innovations, compute_innovations

FEWEST_SAMPLES = 8  # of a stretch
FEWEST_STEPS = 20  # of references, to know their scatter
LEVEL_SIGMAS, LEVEL_STEPS = 8.0, 2.5  # range of readings at a level: of the white noise, and in steps of a converter
MISFIT = 12.0  # sigmas of the turn that the stretch misses
FITTING = 0.25  # of the misfit in the stretch, below which that before and after it lies
NEIGHBOUR_STEPS = 5  # steps before and after that are looked at
READ = 3  # steps elsewhere that show rates as small
SHARED = 0.7  # of the stretch of another axis, which is then the same
GOES_ON = 3  # readings before a stretch that say how it would go on
CERTAIN = 30.0  # log odds
STOP_P_VALUE = 1e-30


@dataclass(frozen=True)
class Stretch:
    """Samples low to high of one axis at a level, rad/s."""

    axis: int
    low: int
    high: int
    level: float

    def times(self, stream: Stream) -> tuple[float, float]:
        """Begin and end, s since the epoch."""
        t_s, half = stream.t_s, 0.5 * stream.duration_s
        return float(t_s[self.low] - half[self.low]), float(t_s[self.high - 1] + half[self.high - 1])


class GyroStop(Effect):
    """See the module."""

    def apply(self, rng: np.random.Generator, samples: Array, stream: Stream, setting: Setting) -> Array:
        """The level in the samples that begin inside the stretch."""
        begin = stream.t_s - 0.5 * stream.duration_s
        inside = (begin >= number(setting.parameters, "begin_s")) & (begin < number(setting.parameters, "end_s"))
        out = samples.copy()
        for column in select_axes(setting.axis):
            out[inside, column] = setting.size * DEG
        return out

    def find_faults(self, around: Surroundings) -> Sequence[Fault]:
        """Find stretches at a level that the references contradict; one fault for those of all axes, else one per axis."""
        if around.stream.raw.shape[1] != len(AXIS_NAMES):
            return ()
        seen = compute_innovations(around)
        if len(seen.values) < FEWEST_STEPS:
            return ()
        levels = [one for axis in range(3) for one in find_levels(around, axis)]
        stops = [one for one in levels if _is_stop(around, seen, one)]
        common = [one for one in stops if all(_is_shared(one, levels, axis) for axis in range(3))]
        groups = [
            (None, common),
            *((AXIS_NAMES[k], [one for one in stops if one not in common and one.axis == k]) for k in range(3)),
        ]
        return [self._build_fault(around, axis, own) for axis, own in groups if own]

    def _build_fault(self, around: Surroundings, axis: str | None, stretches: Sequence[Stretch]) -> Fault:
        stream = around.stream
        lost = np.zeros(stream.t_s.size, dtype=bool)
        for one in stretches:
            lost[max(one.low - 1, 0) : one.high + 1] = True
        longest = max(stretches, key=lambda one: one.high - one.low)
        begin, end = longest.times(stream)
        level = float(np.rad2deg(np.mean([one.level for one in stretches])))
        sigma = float(np.rad2deg(_compute_tolerance(around, longest.axis))) / LEVEL_SIGMAS
        whose = "all gyros stop" if axis is None else f"gyro {axis} stops"
        text = f"{whose} at a level, {level:.4g} deg/s, from {begin:.2f} to {end:.2f} s, while the references turn"
        parameters: dict[str, Value] = {"begin_s": begin, "end_s": end}
        found = Detection(self.name, axis, level, self.unit, sigma, parameters, CERTAIN, STOP_P_VALUE, text)
        return Fault(found, lost, np.zeros(around.references.t_s.size, dtype=bool))


def find_levels(around: Surroundings, axis: int) -> list[Stretch]:
    """Find the stretches of an axis in which the reading stays within the range of its noise, inside the intervals."""
    x, tolerance = around.stream.raw[:, axis], _compute_tolerance(around, axis)
    out = []
    for part in around.stream.intervals:
        for low, high in _find_runs(np.ascontiguousarray(x[part]), tolerance):
            if high - low >= FEWEST_SAMPLES:
                out.append(Stretch(axis, part.start + int(low), part.start + int(high), float(np.median(x[part][low:high]))))
    return out


def _compute_tolerance(around: Surroundings, axis: int) -> float:
    """Range of the readings at a level, rad/s."""
    steps = np.abs(np.diff(around.stream.raw[:, axis]))
    step = float(steps[steps > 0].min(initial=np.inf))
    sigma = around.arw / np.sqrt(around.sample_s)
    return float(max(LEVEL_SIGMAS * sigma, LEVEL_STEPS * step if np.isfinite(step) else 0.0, 1e-12))


def _is_stop(around: Surroundings, seen: Innovations, one: Stretch) -> bool:
    """Whether the references contradict a level, and nothing else makes it."""
    stream, t_s = around.stream, around.references.t_s
    begin, end = one.times(stream)
    start, stop = t_s[seen.first], t_s[seen.second]
    inside = np.flatnonzero((start >= begin) & (stop <= end))
    if not inside.size:
        return False
    missed, sigma = seen.values[inside, one.axis], float(seen.sigma[inside, one.axis].max())
    turned = np.abs(np.cumsum(missed)).max() / sigma
    error = missed / seen.duration_s[inside]  # of the rate that the gyro shows
    # A reference that is false for a moment contradicts a few steps only.
    if turned < MISFIT or np.median(np.abs(error)) < 2 * _compute_tolerance(around, one.axis):
        return False
    # It works before and after, in the same interval; a step lies across each end.
    alike = around.references.interval[seen.second] == around.references.interval[seen.second[inside[0]]]
    places = np.arange(len(alike))
    before = np.flatnonzero(alike & (places < inside[0] - 1))[-NEIGHBOUR_STEPS:]
    after = np.flatnonzero(alike & (places > inside[-1] + 1))[:NEIGHBOUR_STEPS]
    allowed = FITTING * float(np.sqrt(np.mean(missed**2)))
    sides = [np.abs(seen.values[side, one.axis]) for side in (before, after)]
    if any(not side.size or float(np.median(side)) > allowed for side in sides):
        return False
    return not (_is_saturated(around, one, error) or _is_dead_zone(around, seen, one, error) or _is_extrapolated(around, one))


def _is_saturated(around: Surroundings, one: Stretch, error: Array) -> bool:
    """Whether the level is the largest or smallest reading, and the true rate mostly beyond it."""
    x, tolerance = around.stream.raw[:, one.axis], _compute_tolerance(around, one.axis)
    beyond = -float(np.median(error))  # true rate less the level
    return bool((beyond > 0 and one.level >= x.max() - tolerance) or (beyond < 0 and one.level <= x.min() + tolerance))


def _is_dead_zone(around: Surroundings, seen: Innovations, one: Stretch, error: Array) -> bool:
    """Whether the level is zero and no rate as small as the true one is read anywhere."""
    tolerance = _compute_tolerance(around, one.axis)
    if abs(one.level) > tolerance:
        return False
    widest = float(np.abs(error).max())
    rate = np.abs(seen.turned[:, one.axis] / seen.duration_s)
    fits = np.abs(seen.values[:, one.axis]) < 4 * seen.sigma[:, one.axis]
    return bool(np.sum(fits & (rate > tolerance) & (rate < widest)) < READ)


def _is_extrapolated(around: Surroundings, one: Stretch) -> bool:
    """Whether the level is where the readings before would go, as that of repeated samples is."""
    raw, place = around.stream.raw, one.low - 1
    inner = raw[one.low + 2 : one.high - 2]
    if (inner[1:] != inner[:-1]).any():  # repeats agree exactly
        return False
    while place > 0 and (raw[place] == raw[place - 1]).all():  # itself a repeat
        place -= 1
    if place < GOES_ON - 1:
        return False
    last, gap = raw[place - GOES_ON + 1 : place + 1, one.axis], one.low - place
    change, bend = gap * float(last[-1] - last[0]) / (GOES_ON - 1), gap**2 * abs(float(np.diff(last, 2)[-1]))
    within = 1.5 * _compute_tolerance(around, one.axis) + 2 * abs(change) + 2 * bend
    return bool(abs(float(last[-1]) + change - one.level) < within)


def _is_shared(one: Stretch, levels: Sequence[Stretch], axis: int) -> bool:
    """Whether an axis is at a level in most of a stretch."""
    shared = sum(max(min(one.high, other.high) - max(one.low, other.low), 0) for other in levels if other.axis == axis)
    return shared >= SHARED * (one.high - one.low)


@compile_cached
def _find_runs(x, tolerance):  # type: ignore[no-untyped-def]
    """First and last + 1 of stretches (r, 2) in which all readings lie within a range."""
    out = np.empty((x.size, 2), dtype=np.int64)
    count, i = 0, 0
    while i < x.size:
        low, high, j = x[i], x[i], i + 1
        while j < x.size:
            low, high = min(low, x[j]), max(high, x[j])
            if high - low > tolerance:
                break
            j += 1
        out[count, 0], out[count, 1] = i, j
        count, i = count + 1, j
    return out[:count]


EFFECT = GyroStop(
    name="gyro_stop",
    summary="the gyro stops at a level for a while and resumes",
    says="{whose} readings stop at {size} for a while",
    unit="deg/s",
    stage="telemetry",
    prior=(1e-6, 1e3),
    bounds=(-1e5, 1e5),
    axis_optional=True,
    parameters=(
        Parameter("begin_s", "s", None, "time at which it stops, since the epoch", -1e12, 1e12),
        Parameter("end_s", "s", None, "time at which it resumes", -1e12, 1e12),
    ),
    meaning="The gyro's reading stops at a level for a while, whatever the motion, and resumes; the size is the level.",
)
