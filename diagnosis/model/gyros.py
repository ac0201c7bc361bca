"""The linear model of several gyros: their parity beside the attitude, and every effect gyro by gyro.

Where gyro i reads high by f(t), the body rates G ω_raw are high by G_i f, which the attitude shows, and the parity by V_i f,
which shows without any attitude. Both are observations of one linear model: attitude rows, then parity rows, whose noise is
uncorrelated (`gyrocal.recording.gyros`). What is not of one gyro – errors of the references, late tags of all of them – adds
nothing to the parity. Without reference attitudes there are parity rows only.

Four gyros have one parity residual, in which constant errors of any of them look alike; five or more tell them apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from diagnosis.model import folds, groups, processes, steps
from diagnosis.model.candidates import placed
from diagnosis.model.groups import Group
from diagnosis.model.linear import Fold, LinearModel, Member, Option
from diagnosis.model.parity import ParityModel
from diagnosis.model.places import Place
from diagnosis.model.recording import RecordingModel
from diagnosis.settings import DiagnosisSettings
from gyrocal.calibration.observability import PLAUSIBLE_BIAS, PLAUSIBLE_G
from gyrocal.recording import Recording
from simulator.effects import References, Stream, Surroundings
from simulator.effects.base import Effect, ProcessTimes, Value
from simulator.effects.common import markov
from simulator.effects.gyros import acts_on_one, columns_of
from simulator.effects.recorded import housekeeping_at

Array = NDArray[np.float64]

SPLIT = "an eighth of each interval at a time"


@dataclass(frozen=True)
class ArrayModel:
    """Attitude and parity of a recording.

    Attributes
    ----------
    recording : of the gyros
    parity : its parity
    body : of its body rates, None without reference attitudes
    gains : (intervals, 3, gyros) G that made those in each interval
    """

    recording: Recording
    parity: ParityModel
    body: RecordingModel | None
    gains: Array

    @property
    def attitude_rows(self) -> int:
        """Number of observations that are attitudes; they come first."""
        return 0 if self.body is None else self.body.size

    @property
    def size(self) -> int:
        """Number of observations."""
        return self.attitude_rows + self.parity.size

    @cached_property
    def y(self) -> Array:
        """(N,) whitened observations, nuisance parameters projected out."""
        return np.concatenate([np.empty(0) if self.body is None else self.body.y, self.parity.y])

    @property
    def degrees_of_freedom(self) -> int:
        """Observations less nuisance parameters."""
        return self.parity.degrees_of_freedom + (0 if self.body is None else self.body.degrees_of_freedom)

    def projected(self, columns: Array) -> Array:
        """Whitened columns without the part of the nuisance parameters."""
        own = self.parity.projected(columns[self.attitude_rows :])
        if self.body is None:
            return own
        return np.concatenate([self.body.projected(columns[: self.attitude_rows]), own])

    def stacked(self, attitude: Array | None, parity: Array | None, width: int) -> Array:
        """Columns of attitude and parity, one under the other; zeros for what is None."""
        return np.vstack([
            np.zeros((self.attitude_rows, width)) if attitude is None else attitude,
            np.zeros((self.parity.size, width)) if parity is None else parity,
        ])  # fmt: skip

    @cached_property
    def around(self) -> Surroundings:
        """What the recording offers to effects on a gyro."""
        recording, nothing = self.recording, np.empty(0)
        if self.body is None:
            references = References(
                nothing, np.empty((0, 4)), np.empty(0, dtype=np.intp), np.empty(0, dtype="<U2"), self._period_s
            )
        else:
            references = self.body.references
        sigma = np.empty((0, 3)) if self.body is None else self.body.around.reference_sigma
        return Surroundings(self.stream, references, recording.gyro.arw, recording.gyro.sample_s, sigma)

    @property
    def _period_s(self) -> float:
        return self.recording.orbit.period_s if self.recording.orbit is not None else float("nan")

    @cached_property
    def stream(self) -> Stream:
        """The samples as effects see them."""
        one, intervals = self.parity, self.recording.intervals
        span = (min(i.start_s for i in intervals), max(i.stop_s for i in intervals))
        return self._stream(one.t_s, one.dt, one.rates, one.samples, span, housekeeping_at(self.recording, one.t_s))

    @cached_property
    def body_stream(self) -> Stream:
        """The steps of the attitude as effects see them."""
        assert self.body is not None
        own = self.body.stream
        return self._stream(own.t_s, own.duration_s, own.rates, own.intervals, own.span_s, own.housekeeping)

    def _stream(
        self,
        t_s: Array,
        dt: Array,
        rates: Array,
        parts: tuple[slice, ...],
        span: tuple[float, float],
        more: Mapping[str, Array],
    ) -> Stream:
        gyros = self.parity.gyros
        raw = rates @ gyros.K.T + gyros.c
        return Stream(t_s, dt, rates, raw, parts, self._period_s, span, more, gyros.names, gyros.K)

    @cached_property
    def step_gains(self) -> Array:
        """(steps, 3, gyros) of the attitude's steps."""
        assert self.body is not None
        return np.concatenate([
            np.broadcast_to(self.gains[block.interval], (block.steps.stop - block.steps.start, *self.gains.shape[1:]))
            for block in self.body.blocks
        ])  # fmt: skip

    # ---- columns of one gyro ---------------------------------------------------------------------------------------------

    def columns(self, effect: Effect, gyro: int, parameters: Mapping[str, Value]) -> Array:
        """(N, k) whitened columns of an effect on one gyro, per unit of each amplitude."""
        high = columns_of(effect, self.stream, gyro, parameters)
        parity = self.parity.reading(gyro, self.parity.means(high))
        if self.body is None:
            return self.stacked(None, parity, high.shape[1])
        seen = columns_of(effect, self.body_stream, gyro, parameters)
        turned = self.step_gains[:, :, gyro, None] * seen[:, None, :]
        return self.stacked(self.body.whitened(self.body.reading(turned)), parity, high.shape[1])

    def switched(self, effect: Effect, gyro: int, parameters: Mapping[str, Value], times: Array) -> Array:
        """(N, s) whitened columns of an effect on one gyro that is switched on at each of some times."""
        begin = self.stream.t_s[0] - self.stream.duration_s[0] - steps.ALREADY_ON
        always = {**parameters, "time_s": float(begin)}
        high = columns_of(effect, self.stream, gyro, always)[:, 0]
        parity = self.parity.reading(gyro, self.parity.means_from(high, times))
        if self.body is None:
            return self.stacked(None, parity, times.size)
        seen = columns_of(effect, self.body_stream, gyro, always)[:, 0]
        firsts = np.searchsorted(self.body.t_s, times)
        turned = self.step_gains[:, :, gyro] * seen[:, None]
        return self.stacked(self.body.whitened(self.body.reading_steps(turned, firsts)), parity, times.size)

    @cached_property
    def process_times(self) -> ProcessTimes:
        """Times at which a random process of a gyro is taken: the attitude's cells, or the parity's blocks without attitude."""
        if self.body is None:
            one = self.parity
            return ProcessTimes(one.middle_s, np.cumsum(one.duration_s) - 0.5 * one.duration_s, one.interval)
        cells = self.body.cells
        interval = np.array([block.interval for block in self.body.blocks])[cells.interval]
        return ProcessTimes(cells.t_s, cells.run_s, interval)

    @cached_property
    def held(self) -> Array:
        """(B, times) share of each block of the parity in which each value of a process holds."""
        one = self.parity
        if self.body is None:
            return np.eye(one.first.size)
        at = self.process_times
        own = np.empty(one.t_s.size, dtype=np.intp)
        for number, part in enumerate(one.samples):  # the value nearest in time, of the same interval where there is one
            there = np.flatnonzero(at.interval == number)
            there = there if there.size else np.arange(at.t_s.size)
            own[part] = there[np.searchsorted(0.5 * (at.t_s[there][1:] + at.t_s[there][:-1]), one.t_s[part])]
        block = np.repeat(np.arange(one.first.size), np.diff(np.append(one.first, one.t_s.size)))
        out = np.zeros((one.first.size, at.t_s.size))
        np.add.at(out, (block, own), one.dt)
        return out / one.duration_s[:, None]

    @cached_property
    def rival_covariances(self) -> tuple[list[Array], Array]:
        """Covariances of unlisted errors: correlated over three times, and a level in each interval."""
        at = self.process_times
        longest = max(float(np.ptp(at.t_s[at.interval == k])) for k in np.unique(at.interval))
        together = processes.same(at.interval)
        taus = (longest / 60, longest / 20, longest / 6)
        return [together * markov(at.t_s, tau) for tau in taus], together

    def unit_columns(self, gyro: int) -> Array:
        """(N, times) whitened observations of a unit error of one gyro at each time of a process."""
        own = self.parity.reading(gyro, self.held)
        if self.body is None:
            return own
        weights = -self.gains[self.process_times.interval, :, gyro]  # a reading that is high makes a rate error −G_i
        cells = sum((self.body.cell_columns[axis] * weights[:, axis] for axis in range(3)), np.zeros((1, 1)))
        return np.vstack([cells, own])


# ---- candidates ----------------------------------------------------------------------------------------------------------


def array_model(model: ArrayModel, effects: Sequence[Effect], settings: DiagnosisSettings) -> LinearModel:
    """The linear model of several gyros: effects of each, of the references, and unlisted rivals of both."""
    of_gyros = [effect for effect in effects if effect.axes and acts_on_one(effect)]
    offered = list(gyro_groups(model, of_gyros))
    if model.body is not None:
        common = [effect for effect in effects if effect.on_references or not effect.axes]
        widths = [*groups.listed(model.body, common, None), *groups.unlisted_groups(model.body, {}, common)]
        offered += [replace(one, columns=[model.stacked(part, None, part.shape[1]) for part in one.columns]) for one in widths]
    by_name = {effect.name: effect for effect in of_gyros}
    found, W = placed(offered, model.projected, settings, model.size)

    def refine(linear: LinearModel, member: Member) -> LinearModel:
        entry = linear.candidate(member)
        effect = by_name.get(entry.effect)
        return linear if effect is None or not effect.switched else finer_times(model, linear, member, by_name)

    return LinearModel(
        y=model.y,
        X=model.projected(W),
        W=W,
        candidates=found,
        dof=model.degrees_of_freedom,
        projected=model.projected,
        most_effects=settings.largest_set,
        split=SPLIT,
        folds=lambda W: array_folds(model, W),
        refine=refine,
    )


def gyro_groups(model: ArrayModel, effects: Sequence[Effect]) -> Iterator[Group]:
    """Effects with columns or a covariance on each gyro, and the unlisted errors of each."""
    here = [effect for effect in effects if effect.missing(model.around) is None]
    random = {effect.name: _covariances(model, effect) for effect in here if effect.is_process}
    for gyro, name in enumerate(model.parity.gyros.names):
        unit = model.unit_columns(gyro)
        place = Place.of(unit, unit.T @ model.projected(unit))
        for effect in here:
            if effect.has_columns:
                yield _switched(model, effect, gyro) if effect.switched else _plain(model, effect, gyro)
            elif effect.is_process:
                columns = [processes.usual(place, K) for K in random[effect.name]]
                trials = effect.trials(model.around)
                parameters = [dict(trial.parameters) for trial in trials]
                made = groups.group_of(effect, name, columns, parameters, [trial.weight for trial in trials])
                yield replace(made, process=True)
        for words, covariances in _rivals(model, gyro):
            columns = [processes.usual(place, K) for K in covariances]
            shares = np.full(len(columns), 1 / len(columns))
            yield Group(words, name, False, columns, [{}] * len(columns), shares, (0.0, np.inf), "", True)


def _covariances(model: ArrayModel, effect: Effect) -> list[Array]:
    return [effect.covariance(model.process_times, trial.parameters) for trial in effect.trials(model.around)]


def _plain(model: ArrayModel, effect: Effect, gyro: int) -> Group:
    trials = effect.trials(model.around)
    columns = [model.columns(effect, gyro, trial.parameters) for trial in trials]
    parameters = [dict(trial.parameters) for trial in trials]
    name = model.parity.gyros.names[gyro]
    return groups.group_of(effect, name, columns, parameters, [trial.weight for trial in trials])


def _switched(model: ArrayModel, effect: Effect, gyro: int) -> Group:
    times, widths, weights = step_times(model)
    columns, parameters, shares = [], [], []
    for trial in effect.trials(model.around):
        block = model.switched(effect, gyro, trial.parameters, times)
        columns += [block[:, [k]] for k in range(times.size)]
        parameters += [
            {**trial.parameters, "time_s": float(time), "time_sigma_s": float(width)}
            for time, width in zip(times, widths, strict=True)
        ]
        shares += (trial.weight * weights).tolist()
    return groups.group_of(effect, model.parity.gyros.names[gyro], columns, parameters, shares)


def _rivals(model: ArrayModel, gyro: int) -> Iterator[tuple[str, list[Array]]]:
    """Errors of one gyro that are on no list: of any course in time, following its rate, or of a level in each interval."""
    fast, levels = model.rival_covariances
    own = model.stream.rates @ model.parity.gyros.K[gyro]
    rate = np.interp(model.process_times.t_s, model.stream.t_s, own)
    along = np.outer(rate, rate)
    yield "random error of a gyro, correlated in time", fast
    yield "bias of a gyro differs between intervals", [levels]
    yield "scale factor of a gyro differs between intervals", [levels * along]
    yield "scale factor of a gyro wanders", [fast[2] * along]


# ---- the time of a step --------------------------------------------------------------------------------------------------


def step_times(model: ArrayModel) -> tuple[Array, Array, Array]:
    """Times that a step is tried at, how far each may be off, and their prior weights; as `steps.step_times`."""
    intervals = model.recording.intervals
    spans = sorted((one.start_s, one.stop_s) for one in intervals)
    total, gaps = sum(stop - start for start, stop in spans), len(spans) - 1
    times, widths, weights = [], [], []
    for number, (start, stop) in enumerate(spans):
        if number:
            end = spans[number - 1][1]
            times.append(0.5 * (end + start))
            widths.append((start - end) / np.sqrt(12))
            weights.append(steps.BETWEEN_INTERVALS / gaps)
        duration = stop - start
        count = int(np.clip(duration / steps.LONGEST_STEP_GAP, 3, steps.MOST_STEP_TIMES))
        times += (start + np.arange(1, count + 1) / (count + 1) * duration).tolist()
        widths += [0.0] * count
        weights += [(1 - steps.BETWEEN_INTERVALS if gaps else 1.0) * duration / total / count] * count
    return np.array(times), np.array(widths), np.array(weights)


def finer_times(model: ArrayModel, linear: LinearModel, member: Member, effects: Mapping[str, Effect]) -> LinearModel:
    """More times of a step around the one at which a member is held, of every step of every gyro; as `with_finer_times` there.

    Steps of different gyros may look alike. One alone with finer times would win over the others for no other reason.
    """
    entry, parameters = linear.candidate(member), linear.option(member).parameters
    fixed = _fixed(linear.option(member))
    times = sorted(float(o.parameters["time_s"]) for o in entry.options if _fixed(o) == fixed)
    place = times.index(float(parameters["time_s"]))
    low, high = times[max(place - 2, 0)], times[min(place + 2, len(times) - 1)]
    finer = np.linspace(low, high, steps.FINE_STEP_TIMES)
    held = np.zeros(finer.size, dtype=bool)
    for one in model.recording.intervals:
        held |= (finer > one.start_s) & (finer < one.stop_s)
    if not held.any():
        return linear
    for number, other in enumerate(linear.candidates):
        effect = effects.get(other.effect)
        if effect is not None and effect.switched:
            linear = _with_times(model, linear, number, effect, (low, high), finer[held])
    return linear


def _with_times(
    model: ArrayModel, linear: LinearModel, number: int, effect: Effect, window: tuple[float, float], finer: Array
) -> LinearModel:
    """One candidate with finer times, which take half the prior of those in the window; a gap between intervals keeps its."""
    entry = linear.candidates[number]
    gyro = model.parity.gyros.names.index(str(entry.axis))
    coarse, more, columns, start = list(entry.options), [], [], linear.W.shape[1]
    for fixed in {tuple(sorted(_fixed(o).items())): _fixed(o) for o in entry.options}.values():
        inside = [
            k
            for k, o in enumerate(entry.options)
            if _fixed(o) == fixed
            and window[0] <= float(o.parameters["time_s"]) <= window[1]
            and not float(o.parameters["time_sigma_s"])
        ]
        if not inside:
            continue
        weight = float(np.log(sum(np.exp(entry.options[k].log_weight) for k in inside) / (2 * finer.size)))
        more += [
            Option(start + k, 1, weight, {**fixed, "time_s": float(time), "time_sigma_s": 0.0}) for k, time in enumerate(finer)
        ]
        start += finer.size
        columns.append(model.switched(effect, gyro, fixed, finer))
        for k in inside:
            coarse[k] = replace(coarse[k], log_weight=coarse[k].log_weight - np.log(2))
    if not columns:
        return linear
    W = np.hstack(columns)
    return linear.with_options(number, [*coarse, *more], W, model.projected(W))


def _fixed(option: Option) -> dict[str, float | str]:
    """The parameters of a step beside its time."""
    return {name: value for name, value in option.parameters.items() if not name.startswith("time_")}


# ---- held-out data -------------------------------------------------------------------------------------------------------


def array_folds(model: ArrayModel, W: Array) -> Iterator[Fold]:
    """Folds of attitude and parity together, which are independent under M0."""
    rows = model.attitude_rows
    of_attitude = folds.folds(model.body, W[:rows]) if model.body is not None else iter(())
    for one, other in zip_longest(of_attitude, _parity_folds(model, W[rows:])):
        if one is None or other is None:
            yield other if one is None else one
            continue
        yield Fold(
            train_y=np.concatenate([one.train_y, other.train_y]),
            train_X=np.vstack([one.train_X, other.train_X]),
            left_y=np.concatenate([one.left_y, other.left_y]),
            left_X=np.vstack([one.left_X, other.left_X]),
            owner=np.concatenate([one.owner, other.owner]),
            dof={name: one.dof.get(name, 0.0) + other.dof.get(name, 0.0) for name in {**one.dof, **other.dof}},
        )


def _parity_folds(model: ArrayModel, W: Array) -> Iterator[Fold]:
    parity = model.parity
    names = np.array([interval.name for interval in model.recording.intervals])
    scale = folds.BROAD * np.tile([PLAUSIBLE_G] * 3 + [PLAUSIBLE_BIAS], len(parity.gyros.names))
    w = np.column_stack([parity.means(parity.rates), np.ones(parity.first.size)])[parity.block]
    nuisance = (parity.rows[:, :, None] * w[:, None, :]).reshape(parity.size, -1) * scale
    sigma = np.eye(parity.size) + nuisance @ nuisance.T
    part = np.empty(parity.first.size, dtype=np.intp)
    for number in np.unique(parity.interval):
        own = np.flatnonzero(parity.interval == number)
        part[own] = (np.arange(own.size) * folds.PARTS // own.size + number) % folds.PARTS
    for number in np.unique(part):
        out = (part == number)[parity.block]
        if not out.all():
            yield folds.held_out(sigma, parity.observed, W, out, names[parity.interval[parity.block]])
