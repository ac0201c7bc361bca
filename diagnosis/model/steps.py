"""The moment at which an effect is switched on: the times that are tried, and the ones that explain most given the rest.

A step is tried at some times beforehand. On a body that never rests another moment makes another column, so that none of
those times may be near enough to show at all. Therefore every switched effect is then tried at many times of the recording at
once. With y the observations, x the column of a step at one of them, and S = 1 + C Cᵀ the covariance of y beside the columns C
of what else is thought to be there, the log of the likelihood ratio of a step of any size is

    (xᵀS⁻¹y)² / (2 xᵀS⁻¹x),        S⁻¹ = 1 − C (1 + CᵀC)⁻¹ Cᵀ,

the latter by the matrix inversion lemma. Where it peaks, the step gets further options, close enough together to be told apart.
Their prior is that of the time they span.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from diagnosis.model.linear import LinearModel, ParameterChoice, Parameters, SelectedCandidate, Wanted
from diagnosis.model.recording_model import RecordingModel
from gyrocal.arrays import Array, Indices
from simulator.effects.base import Effect, Value

StepTimes = tuple[Array, Array, Array, Indices]  # of `step_times`

LONGEST_STEP_GAP = 300.0  # s between the times a step is tried at, before refinement
MOST_STEP_TIMES = 14  # times a step is tried at inside an interval
FINE_STEP_TIMES = 48  # times around one that was found
BETWEEN_INTERVALS = 0.5  # prior of a step in a gap between intervals
ALREADY_ON = 1.0  # s before the first sample, when a switched column is on throughout
SCANNED_TIMES = 600  # that a step is looked for at, over the recording
MOST_MOMENTS = 5  # steps that get further options; each makes every later search slower
ROUNDING = 6  # decimals of a duration in s
PEAK = 8.0  # log of a likelihood ratio to the highest, down to which a peak reaches


def step_times(model: RecordingModel) -> StepTimes:
    """List the times a step is tried at, their widths where unknown, their prior weights, and their first steps.

    The time of a step between two intervals cannot be seen, so the middle of the gap stands for all of it.
    """
    times, widths, weights, firsts = [], [], [], []
    stream, t_s = model.stream, model.stream.t_s
    parts = [part for part in stream.intervals if part.stop > part.start]
    durations = [round(float(stream.duration_s[part].sum()), ROUNDING) for part in parts]
    gaps = len(parts) - 1
    for number, (part, duration) in enumerate(zip(parts, durations, strict=True)):
        if number:
            end, begin = float(t_s[parts[number - 1].stop - 1]), float(t_s[part.start])
            times.append(0.5 * (end + begin))
            widths.append((begin - end) / np.sqrt(12))
            weights.append(BETWEEN_INTERVALS / gaps)
            firsts.append(part.start)
        count = int(np.clip(duration / LONGEST_STEP_GAP, 3, MOST_STEP_TIMES))
        inside = part.start + (np.arange(1, count + 1) / (count + 1) * (part.stop - part.start)).astype(int)
        times += t_s[inside].tolist()
        widths += [0.0] * count
        weights += [(1 - BETWEEN_INTERVALS if gaps else 1.0) * duration / sum(durations) / count] * count
        firsts += inside.tolist()
    return np.array(times), np.array(widths), np.array(weights), np.array(firsts)


def build_switched_columns(
    model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value], firsts: Indices
) -> Array:
    """Build whitened columns (N, s) of an effect that is switched on at each of several steps."""
    stream = model.stream
    begin = float(stream.t_s[0]) - ALREADY_ON - float(stream.duration_s[0])
    on = effect.columns(stream, axis, {**parameters, "time_s": begin})[:, :, 0]
    return model.whiten(model.observe_reading_steps(on, firsts))


def add_finer_times(model: RecordingModel, linear: LinearModel, member: SelectedCandidate, effect: Effect) -> LinearModel:
    """Add times for a step of any element to a linear model, close together around a member's time.

    They take half the prior of the times between which they lie; a gap between intervals keeps its prior.
    """
    entry, parameters = linear.candidate(member), linear.option(member).parameters
    if "time_s" not in parameters:
        return linear
    times = sorted({float(o.parameters["time_s"]) for o in entry.options})
    place = times.index(float(parameters["time_s"]))
    low, high = times[max(place - 2, 0)], times[min(place + 2, len(times) - 1)]
    firsts = np.unique(np.searchsorted(model.stream.t_s, np.linspace(low, high, FINE_STEP_TIMES)))
    firsts = firsts[(firsts > 0) & (firsts < model.stream.t_s.size)]
    if not firsts.size:
        return linear
    known = [o for o in entry.options if not float(o.parameters["time_sigma_s"])]
    inside = [o for o in known if low <= float(o.parameters["time_s"]) <= high]
    # Of elements of one row, the one whose tried time is nearest to the true one would win over the true one.
    for fixed in _list_fixed_parameters(option.parameters for option in entry.options):
        givers = [coarse_option for coarse_option in inside if _drop_time(coarse_option.parameters) == fixed]
        if givers:
            linear = _add_times(model, linear, effect, member.candidate, fixed, firsts, givers, 0.5)
    return linear


def _add_times(
    model: RecordingModel,
    linear: LinearModel,
    effect: Effect,
    place: int,
    fixed: Parameters,
    firsts: Indices,
    givers: Sequence[ParameterChoice],
    share: float,
) -> LinearModel:
    """Add options of a step at further times, which take a share of the prior of the options `givers`."""
    entry, start = linear.candidates[place], linear.W.shape[1]
    W = build_switched_columns(model, effect, entry.axis, fixed, firsts)
    weight = float(np.log(share * sum(np.exp(giver.log_weight) for giver in givers) / firsts.size))
    finer = [
        ParameterChoice(start + k, 1, weight, {**fixed, "time_s": float(model.stream.t_s[first]), "time_sigma_s": 0.0})
        for k, first in enumerate(firsts)
    ]
    log_share_left = float(np.log1p(-share))
    coarse = [
        replace(option, log_weight=option.log_weight + log_share_left) if option in givers else option
        for option in entry.options
    ]
    return linear.replace_options(place, [*coarse, *finer], W, model.project_out_nuisance(W))


@dataclass(frozen=True)
class StepPeak:
    """Time at which a step explains most of the residual of some members."""

    height: float  # log of its likelihood ratio there
    candidate: int  # of the linear model
    fixed: Parameters  # parameters other than its time
    low: int  # low, high: steps of the recording between which the peak lies
    high: int


class ResidualProducts:
    """Products of observations (N,) and columns (N, k) with S⁻¹, given some members."""

    def __init__(self, linear: LinearModel, members: Sequence[SelectedCandidate]):
        places, scales, shifts = linear.build_design(members)
        self._C = linear.X[:, places] * scales
        self._factor = scipy.linalg.cho_factor(np.eye(places.size) + self._C.T @ self._C) if places.size else None
        self.y = self.apply_inverse(linear.y - linear.X[:, shifts].sum(axis=1))

    def apply_inverse(self, values: Array) -> Array:
        """Multiply observations or columns by S⁻¹."""
        if self._factor is None:
            return values
        return np.asarray(values - self._C @ scipy.linalg.cho_solve(self._factor, self._C.T @ values))

    def log_ratio(self, X: Array) -> Array:
        """Compute the log (k,) of the likelihood ratio of each column with an amplitude of any size."""
        power = np.einsum("nk,nk->k", X, X)
        if self._factor is not None:
            inner = self._C.T @ X
            power = power - np.einsum("rk,rk->k", inner, scipy.linalg.cho_solve(self._factor, inner))
        is_visible = power > 0
        return np.where(is_visible, 0.5 * (X.T @ self.y) ** 2 / np.where(is_visible, power, 1.0), 0.0)


def add_step_times(
    model: RecordingModel, linear: LinearModel, effects: Mapping[str, Effect], wanted: Sequence[Wanted]
) -> LinearModel:
    """Add further times to a linear model for the steps that explain most beside some sets of members.

    A wanted set of members has the log of the likelihood ratio that a step must exceed beside it.
    """
    residual_products = [ResidualProducts(linear, members) for members, _ in wanted]
    members_by_set = [{member.candidate for member in members} for members, _ in wanted]
    firsts = np.unique(np.linspace(1, model.t_s.size - 1, min(SCANNED_TIMES, model.t_s.size - 1)).astype(np.intp))
    peaks_by_set: list[list[StepPeak]] = [[] for _ in wanted]
    for candidate, entry in enumerate(linear.candidates):
        effect = effects.get(entry.effect) if entry.listed else None
        if effect is None or not effect.switched:
            continue
        for fixed in _list_fixed_parameters(option.parameters for option in entry.options):
            X = model.project_out_nuisance(build_switched_columns(model, effect, entry.axis, fixed, firsts))
            for number, products in enumerate(residual_products):
                if candidate not in members_by_set[number]:
                    peaks_by_set[number].append(_find_ratio_peak(products.log_ratio(X), firsts, candidate, fixed))
    ranked = [
        (peak.height / max(least, 1.0), peak)
        for (_, least), peaks in zip(wanted, peaks_by_set, strict=True)
        for peak in peaks
        if peak.height > max(least, 0.0)
    ]
    chosen: dict[tuple[object, ...], StepPeak] = {}
    for _, peak in sorted(ranked, key=lambda pair: -pair[0]):
        chosen.setdefault((peak.candidate, *peak.fixed.items(), peak.low, peak.high), peak)
    for peak in list(chosen.values())[:MOST_MOMENTS]:
        linear = _add_peak_times(model, linear, effects[linear.candidates[peak.candidate].effect], peak)
    return linear


def _add_peak_times(model: RecordingModel, linear: LinearModel, effect: Effect, peak: StepPeak) -> LinearModel:
    """Add further times around a peak to a linear model."""
    givers = [
        option
        for option in linear.candidates[peak.candidate].options
        if _drop_time(option.parameters) == peak.fixed and not float(option.parameters["time_sigma_s"])
    ]
    if not givers:
        return linear
    firsts = np.unique(np.linspace(peak.low, peak.high, FINE_STEP_TIMES).astype(np.intp))
    share = min(0.5, (peak.high - peak.low) / model.t_s.size)
    return _add_times(model, linear, effect, peak.candidate, peak.fixed, firsts, givers, share)


def _drop_time(parameters: Parameters) -> Parameters:
    return {name: value for name, value in parameters.items() if not name.startswith("time_")}


def _list_fixed_parameters(parameters: Iterable[Parameters]) -> list[Parameters]:
    """List the distinct sets of parameters that remain without the step's time."""
    distinct: list[Parameters] = []
    for fixed in map(_drop_time, parameters):
        if fixed not in distinct:
            distinct.append(fixed)
    return distinct


def _find_ratio_peak(ratio: Array, firsts: Indices, candidate: int, fixed: Parameters) -> StepPeak:
    """Find the highest peak of a likelihood ratio, and its extent, one time further to each side."""
    top = int(np.argmax(ratio))
    below = np.flatnonzero(ratio < ratio[top] - PEAK)
    low = int(below[below < top].max(initial=0))
    high = int(below[below > top].min(initial=ratio.size - 1))
    return StepPeak(float(ratio[top]), candidate, fixed, int(firsts[low]), int(firsts[high]))
