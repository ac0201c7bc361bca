"""Bias instability, 1/f noise of the rate: two-sided spectrum S(f) = B²/(2π f) with B = size, one-sided twice that.

IEEE Std 952, annex C: the Allan variance is 4 ∫ S(f) sin⁴(πfτ)/(πfτ)² df = 2 ln 2 B²/π whatever τ, so that the floor of the
Allan deviation is 0.664 B. Made as a sum of first-order Gauss–Markov processes an octave apart. One of variance v and time
constant τ has the two-sided spectrum 2 v τ/(1 + (2πfτ)²); summed over all octaves, ∫ dτ/(τ ln 2), that is v/(2 f ln 2),
hence v = B² ln 2/π. The time constants go from one sample to the whole recording (its gaps included, since the noise runs on
in true time), so that 1/f holds over all that can be seen. Source of the idea: van der Ziel, Physica 16 (1950) 359.
"""

import numpy as np

from simulator.effects.base import Array, Effect, Parameters, ProcessTimes, Setting, Stream
from simulator.effects.common import DEG_H, gauss_markov, markov, put_on_axis


def list_octave_constants(shortest: float, longest: float) -> Array:
    """List time constants an octave apart that span the shortest to the longest, s."""
    return np.asarray(shortest * 2.0 ** np.arange(max(1, int(np.ceil(np.log2(max(longest / shortest, 1.0)))) + 1)))


class NoiseFlicker(Effect):
    """See the module."""

    def wander(self, rng: np.random.Generator, stream: Stream, setting: Setting) -> Array:
        """The noise on its axis."""
        constants = list_octave_constants(float(np.median(stream.duration_s)), float(stream.t_s[-1] - stream.t_s[0]))
        total = sum((gauss_markov(rng, stream.t_s, tau) for tau in constants), np.zeros(len(stream.t_s)))
        return put_on_axis(setting.size * DEG_H * np.sqrt(np.log(2) / np.pi) * total, setting.axis)[:, :, 0]

    def covariance(self, at: ProcessTimes, parameters: Parameters) -> Array:
        """The same sum of Gauss–Markov processes, from the spacing of the times to all that they span."""
        constants = list_octave_constants(float(np.median(np.diff(at.t_s))), float(np.ptp(at.t_s)))
        total = sum((markov(at.t_s, float(tau)) for tau in constants), np.zeros((len(at.t_s), len(at.t_s))))
        return np.asarray(total * np.log(2) / np.pi * DEG_H**2)


EFFECT = NoiseFlicker(
    name="noise_flicker",
    summary="bias instability, 1/f noise of the rate",
    says="{whose} bias never settles and wavers by {size}",
    unit="deg/h",
    stage="random_rate",
    prior=(1e-5, 1e3),
    bounds=(0.0, 1e9),
    meaning="The gyro's bias wanders about a level that is never quite constant (bias instability, 1/f noise).",
)
