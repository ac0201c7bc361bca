"""The floor: what the whole procedure leaves on simulated trials, M0 with the effects found on the recorded motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gyrocal import Attitudes, Interval
from simulator.effects import Setting, setting
from simulator.replay import replay, replayed
from studies.validation import broad
from studies.validation.real_gyro.fitting import Fitted, fit, predicted
from studies.validation.real_gyro.held_rows import held_rows
from studies.validation.real_gyro.ladder import STALE, TRUNCATED, Found, repaired, rungs, untruncated
from studies.validation.real_gyro.left_out import Fold
from studies.validation.real_gyro.trials import Loaded, RealConfig, Row

Array = NDArray[np.float64]


def simulated(one: Loaded, rung: Sequence[str], found: Found, fitted: Fitted, seed: int, counts: Sequence[int]) -> list[Loaded]:
    """A trial simulated again on its motion: M0 with the effects found, from other draws of the noise.

    The motion is that of the repaired rates over the whole trial. It is flown with the tags that are right, and the late ones
    are put back afterwards, which is exactly what a time offset does.
    """
    trial, own = one.trial, one.recording
    t = trial.t_s
    inside = trial.tracked & (t > t[0] + broad.SHORTEST_REST_S / 10) & (t < t[-1] - broad.SHORTEST_REST_S / 10)
    evenly = np.flatnonzero(inside)[:: trial.samples(1.0)]
    used = np.union1d(evenly, np.searchsorted(t, own.attitudes.t_s - 1e-9))
    sigma = np.full((used.size, 3), own.attitudes.sigma.mean(axis=0))
    places = np.searchsorted(t[used], own.attitudes.t_s - 1e-9)
    sigma[places] = own.attitudes.sigma
    rest = repaired(one, rung, found).gyro.rates
    level = _level(one, rung, found)
    whole = replace(
        own,
        gyro=replace(own.gyro, t_s=t - fitted.offset, rates=rest + level),
        attitudes=Attitudes(t[used], trial.quaternions[used], sigma),
        intervals=(Interval("whole", "", float(t[used[0]]), float(t[used[-1]])),),
    )
    bias = fitted.bias - fitted.G @ level
    motion = replayed(whole, fitted.G, bias)
    effects = _effects(rung, found)
    out = []
    for count in counts:
        flown = replay(whole, fitted.G, bias, effects, seed=seed, case=count, motion=motion)
        out.append(one.seen(replace(flown, gyro=replace(flown.gyro, t_s=t))))
    return out


def _level(one: Loaded, rung: Sequence[str], found: Found) -> Array:
    """Mean repaired rate of the first rest, (3,) rad/s."""
    rates = one.recording.gyro.rates[one.first_rest]
    return np.asarray((untruncated(rates, found.step) if TRUNCATED in rung else rates).mean(axis=0))


def _effects(rung: Sequence[str], found: Found) -> list[Setting]:
    """The stream effects of a rung, for the simulator; the time offset is in the tags."""
    out = []
    if TRUNCATED in rung:
        out.append(setting(TRUNCATED, None, float(np.rad2deg(found.step))))
    if STALE in rung and found.fraction > 0:
        out.append(setting(STALE, None, max(found.mean_run, 1.0), {"fraction": found.fraction}))
    return out


def floor_rows(
    config: RealConfig, trials: Sequence[Loaded], parted: Sequence[Fold], last: Mapping[str, list[tuple[Fold, Fitted]]]
) -> list[Row]:
    """What the last rung leaves on simulated trials, fitted on simulated others."""
    rows: list[Row] = []
    counts = range(config.floor_replays)
    flown: dict[str, list[Loaded]] = {}
    for one in trials:
        fold, fitted = last[one.number][0]
        rung = tuple(rungs(fold.found))[-1][1]
        # Streams are named by effect: the number keeps those of one trial from those of another.
        flown[one.number] = simulated(one, rung, fold.found, fitted, config.entropy + int(one.number), counts)
    for count in counts:
        for fold in parted:
            rung = tuple(rungs(fold.found))[-1][1]
            others = [_like(flown[other.number][count], other) for other in fold.others]
            fitted = fit(others, rung, fold.found)
            predictions = predicted(_like(flown[fold.tested.number][count], fold.tested), fitted, rung, fold.found)
            rows += held_rows(fold.tested.number, "floor", str(count), predictions)
    return rows


def _like(flown: Loaded, part: Loaded) -> Loaded:
    """The intervals of a simulated trial that a fold has."""
    names = [interval.name for interval in part.recording.intervals]
    return flown if len(names) == len(flown.recording.intervals) else flown.only(names)
