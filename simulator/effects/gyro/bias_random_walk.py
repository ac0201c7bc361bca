"""Rate random walk: the bias adds up white noise, Var[b(t) − b(0)] = K² t with K = size in deg/h/√h; b(0) = 0.

IEEE Std 952, annex C: spectrum K²/(2πf)², Allan deviation K √(τ/3). A sample shows the walk's value at its middle. Within an
interval it runs in true time; over the gaps between intervals nothing is known, and ``gaps`` says what is assumed: the walk
holds still there (hold), goes on (grow), or each interval starts at zero again (reset).
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import (
    Array,
    Effect,
    Parameter,
    Parameters,
    ProcessTimes,
    Setting,
    Stream,
    Surroundings,
    Trial,
)
from simulator.effects.common import DEG_H, HOUR, put_on_axis

GAPS = ("hold", "grow", "reset")
COMMON_GAPS = (
    "hold",
    "reset",
)  # over gaps of days a walk that goes on makes levels of their own, and hardly shows as a walk
# Span over sampled time from which on a walk that goes on is not tried: its changes over the gaps are then about √30, or five,
# times those that are seen within intervals, and what is seen of it are levels, as an asymmetry makes them.
LARGEST_SPAN_RATIO = 30.0


class BiasRandomWalk(Effect):
    """See the module."""

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """The walk on its axis."""
        gaps = str(setting.parameters["gaps"])
        t = stream.t_s if gaps == "grow" else np.cumsum(stream.duration_s) - 0.5 * stream.duration_s
        step = np.diff(t, prepend=t[0] - 0.5 * stream.duration_s[0])
        walk = np.cumsum(rng.standard_normal(len(t)) * np.sqrt(step))
        if gaps == "reset":
            for part in stream.intervals:
                walk[part] -= walk[part.start]
        return put_on_axis(setting.size * DEG_H / np.sqrt(HOUR) * walk, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """K² min(t, t'), with t from the first of the times on, since M0 solves for the level there.

        With a reset t runs from the first time of each interval, and the intervals do not depend on one another.
        """
        gaps = parameters["gaps"]
        t = at.t_s if gaps == "grow" else at.run_s
        t = (t - t.min()) / HOUR
        if gaps != "reset":
            return np.asarray(np.minimum.outer(t, t) * DEG_H**2)
        same = np.equal.outer(at.interval, at.interval)
        within = t - np.array([t[at.interval == number].min() for number in at.interval])
        return np.asarray(same * np.minimum.outer(within, within) * DEG_H**2)

    def trials(self, around: Surroundings) -> Sequence[Trial]:
        """List the walk's options over gaps; continuous only where the intervals would show the walk."""
        stream = around.stream
        sampled, whole = float(np.sum(stream.duration_s)), float(stream.t_s[-1] - stream.t_s[0])
        tried = GAPS if whole < LARGEST_SPAN_RATIO * sampled else COMMON_GAPS
        return tuple(Trial({"gaps": gaps}, 1 / len(tried)) for gaps in tried)


EFFECT = BiasRandomWalk(
    name="bias_random_walk",
    summary="rate random walk of the bias",
    says="{whose} bias wanders without returning, by {size}",
    unit="deg/h/√h",
    stage="random_rate",
    prior=(1e-5, 5e3),
    bounds=(0.0, 1e9),
    parameters=(Parameter("gaps", "", "hold", "over the gaps between intervals", choices=GAPS),),
    meaning="The gyro's bias wanders without returning (rate random walk).",
)
