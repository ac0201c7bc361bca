"""Biases that wander at random, IEEE Std 952, annex C.

bias_random_walk
    Rate random walk: the bias adds up white noise, Var[b(t) − b(0)] = K² t with K = size in deg/h/√h; b(0) = 0. Spectrum
    K²/(2πf)², Allan deviation K √(τ/3). A sample shows the walk's value at its middle. Within an interval it runs in true time;
    over the gaps between intervals nothing is known, and ``gaps`` says what is assumed: the walk holds still there (hold), goes
    on (grow), or each interval starts at zero again (reset).
bias_markov
    First-order Gauss–Markov noise, autocovariance size² exp(−|Δt|/τ): a spectrum 2 size² τ/(1 + (2πfτ)²), so that the Allan
    deviation rises to 0.617 size near 1.9 τ and falls again. Unlike a random walk it returns. The time constant is tried from
    what the references' spacing can show to what an interval can; a longer one is a random walk, or a bias of its own in each
    interval.
noise_flicker
    Bias instability, 1/f noise of the rate: two-sided spectrum S(f) = B²/(2π f) with B = size, one-sided twice that. The Allan
    variance is 4 ∫ S(f) sin⁴(πfτ)/(πfτ)² df = 2 ln 2 B²/π whatever τ, so that the floor of the Allan deviation is 0.664 B. Made
    as a sum of first-order Gauss–Markov processes an octave apart. One of variance v and time constant τ has the two-sided
    spectrum 2 v τ/(1 + (2πfτ)²); summed over all octaves, ∫ dτ/(τ ln 2), that is v/(2 f ln 2), hence v = B² ln 2/π. The time
    constants go from one sample to the whole recording (its gaps included, since the noise runs on in true time), so that 1/f
    holds over all that can be seen. Source of the idea: van der Ziel, Physica 16 (1950) 359.
"""

from collections.abc import Sequence

import numpy as np

from simulator.effects.base import Array, Effect, Parameter, Parameters, ProcessTimes, Setting, Stream, Surroundings, Trial
from simulator.effects.common import DEG_H, HOUR, GaussMarkov, TriedConstants, gauss_markov, markov, put_on_axis

GAPS = ("hold", "grow", "reset")
# Over gaps of days a walk that goes on makes levels of its own, and hardly shows as a walk.
COMMON_GAPS = ("hold", "reset")
# Span over sampled time from which on a walk that goes on is not tried: its changes over the gaps are then about √30, or five,
# times those within intervals, and the walk shows as levels of the intervals, as an asymmetry does.
LARGEST_SPAN_RATIO = 30.0


class _BiasRandomWalk(Effect):
    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        gaps = str(setting.parameters["gaps"])
        t = stream.t_s if gaps == "grow" else np.cumsum(stream.duration_s) - 0.5 * stream.duration_s
        step = np.diff(t, prepend=t[0] - 0.5 * stream.duration_s[0])
        walk = np.cumsum(rng.standard_normal(len(t)) * np.sqrt(step))
        if gaps == "reset":
            for part in stream.intervals:
                walk[part] -= walk[part.start]
        return put_on_axis(setting.size * DEG_H / np.sqrt(HOUR) * walk, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """Compute K² min(t, t'), with t from the first of the times on, since M0 solves for the level there.

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
        stream = around.stream
        sampled_s, span_s = float(np.sum(stream.duration_s)), float(stream.t_s[-1] - stream.t_s[0])
        tried = GAPS if span_s < LARGEST_SPAN_RATIO * sampled_s else COMMON_GAPS
        return tuple(Trial({"gaps": gaps}, 1 / len(tried)) for gaps in tried)


class _BiasMarkov(GaussMarkov):
    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        return self.draw(rng, stream.t_s, setting)


class _NoiseFlicker(Effect):
    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        constants = _list_octave_constants(float(np.median(stream.duration_s)), float(stream.t_s[-1] - stream.t_s[0]))
        total = sum((gauss_markov(rng, stream.t_s, tau) for tau in constants), np.zeros(len(stream.t_s)))
        return put_on_axis(setting.size * DEG_H * np.sqrt(np.log(2) / np.pi) * total, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        constants = _list_octave_constants(float(np.median(np.diff(at.t_s))), float(np.ptp(at.t_s)))
        total = sum((markov(at.t_s, float(tau)) for tau in constants), np.zeros((len(at.t_s), len(at.t_s))))
        return np.asarray(total * np.log(2) / np.pi * DEG_H**2)


def _list_octave_constants(shortest: float, longest: float) -> Array:
    """List time constants an octave apart that span the shortest to the longest, s."""
    return np.asarray(shortest * 2.0 ** np.arange(max(1, int(np.ceil(np.log2(max(longest / shortest, 1.0)))) + 1)))


EFFECTS = [
    _BiasRandomWalk(
        name="bias_random_walk",
        summary="rate random walk of the bias",
        says="{whose} bias wanders without returning, by {size}",
        unit="deg/h/√h",
        stage="random_rate",
        prior=(1e-5, 5e3),
        bounds=(0.0, 1e9),
        parameters=(Parameter("gaps", "", "hold", "over the gaps between intervals", choices=GAPS),),
        meaning="The gyro's bias wanders without returning (rate random walk).",
    ),
    _BiasMarkov(
        name="bias_markov",
        summary="bias correlated in time (Markov)",
        says="{whose} bias wanders by {size} and comes back",
        unit="deg/h",
        stage="random_rate",
        prior=(1e-5, 1e3),
        bounds=(0.0, 1e9),
        meaning="The gyro's bias wanders and returns, within a time constant.",
        scale=DEG_H,
        tried=TriedConstants(spacings=1.0, intervals=1.0, ratio=3.0, least_arc=2.0),
    ),
    _NoiseFlicker(
        name="noise_flicker",
        summary="bias instability, 1/f noise of the rate",
        says="{whose} bias never settles and wavers by {size}",
        unit="deg/h",
        stage="random_rate",
        prior=(1e-5, 1e3),
        bounds=(0.0, 1e9),
        meaning="The gyro's bias wanders about a level that is never quite constant (bias instability, 1/f noise).",
    ),
]
