"""A tone in one arc of the samples, by least squares beside the motion of the body.

The motion that is slow beside the tone is followed by a local polynomial and taken out first. Toward the ends of the arc that
follows the tone as well: what it leaves of the readings is fitted to what it leaves of waves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.signal
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

AVERAGED_CYCLES = (4, 4.5, 5, 5.5, 6, 7, 8, 9, 10)  # of a tone, over which the motion beside it may be followed
DEGREE = 6  # of the polynomial that follows it
SUDDEN = 6.0  # robust sigmas beyond which a sample does not count
NO_NOISE = 1e-60  # (rad/s)², where readings leave nothing beside a tone


@dataclass(frozen=True)
class InArc:
    """A tone in one arc.

    Attributes
    ----------
    t_s : (n,) time since its middle, s
    plain : (n, 2) cosine and sine of the tone's frequency
    waves, level : (n, 2), (n,) what is left of those and of the readings without the slow motion
    calm : (n,) samples that count
    fitted : (2,) the readings' part of the waves
    """

    t_s: Array
    plain: Array
    waves: Array
    level: Array
    calm: Mask
    fitted: Array


def in_arc(x: Array, t_s: Array, frequency_hz: float, sample_s: float) -> InArc:
    """Least squares in one arc, of readings (n,) in rad/s at times (n,) in s."""
    angle = 2 * np.pi * frequency_hz * t_s
    plain = np.column_stack([np.cos(angle), np.sin(angle)])
    level, cosine, sine = (without_motion(one, frequency_hz * sample_s) for one in (x, *plain.T))
    waves = np.column_stack([cosine, sine])
    fitted = np.linalg.lstsq(waves, level, rcond=None)[0]
    calm = calm_samples(level - waves @ fitted)
    fitted = np.linalg.lstsq(waves[calm], level[calm], rcond=None)[0]
    return InArc(t_s - t_s.mean(), plain, waves, level, calm, np.asarray(fitted))


def frequency_off(arcs: Sequence[InArc]) -> float:
    """How much higher a tone's frequency is than that of the waves which were fitted to it, Hz; one step of Gauss and Newton.

    The ends of arcs and the tone's own image at the negative frequency pull the top of the spectrum.
    """
    top, bottom = 0.0, 0.0
    for one in arcs:
        waves = one.waves[one.calm]
        change = 2 * np.pi * one.t_s[one.calm] * (waves @ np.array([one.fitted[1], -one.fitted[0]]))
        own = change - waves @ np.linalg.lstsq(waves, change, rcond=None)[0]
        left = one.level[one.calm] - waves @ one.fitted
        weight = 1 / max(float(np.mean(left**2)), NO_NOISE)
        top, bottom = top + weight * float(own @ left), bottom + weight * float(own @ own)
    return top / bottom if bottom > 0 else 0.0


def without_motion(x: Array, cycles: float) -> Array:
    """Samples without the body's motion that is slow beside a tone of so many cycles in a sample.

    A local polynomial over some cycles of the tone follows the motion, and of the tone next to nothing if its length is well
    chosen. A slew that begins gently is quiet to the eyes of the noise tests, but would pass for noise of the tone's amplitude.
    """
    counts = np.unique(np.round(np.array(AVERAGED_CYCLES) / cycles).astype(np.intp) // 2 * 2 + 1)
    kernels = [_smoothing(int(count)) for count in counts if DEGREE + 2 < count < x.size]
    if not kernels:
        return np.asarray(scipy.signal.detrend(x))
    kernel = min(kernels, key=lambda kernel: abs(_gain(kernel, cycles)))
    smooth = scipy.signal.oaconvolve(np.pad(x, kernel.size // 2, mode="edge"), kernel, mode="valid")
    return np.asarray((x - smooth) / (1 - _gain(kernel, cycles)))


@lru_cache(maxsize=16)
def _smoothing(count: int) -> Array:
    """Weights of the samples in the middle of a local polynomial; in orthogonal polynomials, since windows may be long."""
    Q = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, count), DEGREE))[0]
    return np.asarray(Q @ Q[count // 2])


def _gain(kernel: Array, cycles: float) -> float:
    """Gain of a symmetric smoothing at a frequency in cycles a sample."""
    return float(kernel @ np.cos(2 * np.pi * cycles * (np.arange(kernel.size) - kernel.size // 2)))


def calm_samples(left: Array) -> Mask:
    """Samples in which nothing sudden is left of the motion."""
    spread = float(np.median(np.abs(left))) / 0.6745
    return np.asarray(np.abs(left) <= SUDDEN * spread)
