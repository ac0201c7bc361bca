"""The floor: what the whole procedure leaves on simulated trials, M0 with the effects found on the recorded motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.result import Diagnosis
from gyrocal import Attitudes, Interval
from simulator.effects import Setting, setting
from simulator.replay import replay, replayed
from studies.validation import broad
from studies.validation.real_gyro.prediction import CUT, STALE, Fit, Rung
from studies.validation.real_gyro.trials import Loaded

Array = NDArray[np.float64]


def simulated(one: Loaded, rung: Rung, found: Fit, effects: Sequence[Setting], seed: int, count: int) -> list[Loaded]:
    """A trial simulated again and again on its motion: M0 with the effects found, from other draws of the noise.

    The motion is that of the repaired rates over the whole trial. It is flown with the tags that are right, and the late ones
    are put back afterwards, which is exactly what a time offset does.
    """
    t, own = one.trial.t_s, one.whole.attitudes
    edge = broad.SHORTEST_REST_S / 10  # the delay must not move a reference out of the samples
    inside = (own.t_s > t[0] + edge) & (own.t_s < t[-1] - edge)
    times, first = np.unique(np.concatenate([own.t_s[inside], one.recording.attitudes.t_s]), return_index=True)
    sigma = np.concatenate([own.sigma[inside], one.recording.attitudes.sigma])[first]
    attitudes = Attitudes(times, one.trial.quaternions[np.searchsorted(t, times - 1e-9)], sigma)
    rates = one.repaired(rung.cut, rung.bridged)
    whole = replace(
        one.whole,
        gyro=replace(one.whole.gyro, t_s=t - found.delay, rates=rates),
        attitudes=attitudes,
        intervals=(Interval("whole", "", float(times[0]), float(times[-1])),),
    )
    bias = found.bias - found.G @ rates[one.first_rest].mean(axis=0)
    motion = replayed(whole, found.G, bias)
    flown = (replay(whole, found.G, bias, effects, seed=seed, case=case, motion=motion) for case in range(count))
    return [one.flown_again(other.gyro.rates, other.attitudes) for other in flown]


def sample_effects(diagnosis: Diagnosis) -> list[Setting]:
    """What a diagnosis finds in the samples, for the simulator; the time offset is in the tags."""
    return [
        setting(cause.effect, None, max(cause.size, 1.0) if cause.effect == STALE else cause.size, cause.parameters)
        for cause in diagnosis.causes
        if cause.effect in (CUT, STALE)
    ]
