"""What the tests of the samples write into, and what they ask of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.arrays import AXES
from gyrocal.arrays import Array, Mask
from gyrocal.mask_runs import find_mask_runs
from gyrocal.recording import Recording

IMPOSSIBLE = 1e-300  # p of what M0 cannot do


@dataclass(frozen=True)
class SampleTest:
    """One statistic."""

    statistic: str  # statistic, axis: which
    axis: str | None
    value: float  # value, expected: what was found, and what M0 gives
    expected: float
    p_value: float  # under M0, not corrected
    symptom: str | None  # what it is a sign of (`simulator.effects.base.SYMPTOMS`), or None
    text: str  # a sentence


@dataclass(frozen=True)
class Symptom:
    """A departure from M0 that shows in the samples, whatever effect may claim it."""

    kind: str  # one of `simulator.effects.base.SYMPTOMS`
    axis: str | None  # gyro, or None for all of them
    size: float  # size, unit, sigma: how large
    unit: str
    sigma: float
    parameters: dict[str, float | str]  # its other numbers
    p_value: float  # under M0
    text: str = ""  # a sentence
    probability: float = 1.0  # that an effect is at work and not a motion of the body, where that was weighed
    # other symptoms that this may be as well, about the same axis, with their shares of the probability
    rivals: tuple[tuple[str, float], ...] = ()
    likeness: float = 1.0  # p-value of how it behaves, if it is what its kind says


@dataclass(frozen=True)
class Findings:
    """Tests of the samples, and the departures that they establish."""

    tests: tuple[SampleTest, ...] = ()
    symptoms: tuple[Symptom, ...] = ()


@dataclass(frozen=True)
class Line:
    """A sinusoid in the readings of one gyro."""

    axis: int  # which gyro
    frequency_hz: float  # as sampled
    amplitude: float  # amplitude, sigma: rad/s
    sigma: float
    p_value: float  # that noise has so strong a line at any frequency
    waveform: Array  # (n,) the sinusoid in the samples of the arcs in which it was found, rad/s

    @property
    def text(self) -> str:
        """Place, axis and size in words."""
        return f"a line at {self.frequency_hz:.4g} Hz, {AXES[self.axis]}, {np.rad2deg(self.amplitude):.3g} deg/s"


@dataclass(frozen=True)
class Stream:
    """A stream of three gyros, in which lines stand in for the samples that were not measured so far."""

    recording: Recording  # as recorded
    rates: Array  # rates, density: (n, 3) rad/s, and noise density, rad²/s
    density: Array
    filled: Mask  # (n,) samples that something was put in place of
    used: Mask  # (n,) samples inside the intervals that are tested

    @property
    def sigma(self) -> float:
        """Stated white noise of a sample, rad/s."""
        return self.recording.gyro.arw / float(np.sqrt(self.recording.gyro.sample_s))

    def find_arcs(self, mask: Mask) -> list[tuple[int, int]]:
        """Find unbroken runs of at least 256 samples of a mask (n,), as slices."""
        return find_long_runs(mask & mark_consecutive_samples(self.recording, mask))


@dataclass(frozen=True)
class SampleReport:
    """What the samples show, and the stream with lines in place of samples that were not measured."""

    tests: tuple[SampleTest, ...]  # tests, symptoms: all statistics, and the departures they establish
    symptoms: tuple[Symptom, ...]
    rates: Array  # (n, 3) raw rates, filled, rad/s
    density: Array  # (n, 3) noise density of each sample, rad²/s
    filled: Mask  # (n,) samples that something was put in place of
    noise_factor: Array  # (3,) actual white noise relative to the stated one
    noise: Array  # (3,) noise of a sample as it shows, rad/s
    # (n, 3) filled raw rates without their noise: what effects follow, since a regressor with the noise of the residuals in
    # it would explain that noise
    smooth: Array
    coarse_steps: Array  # (3,) step of a lattice that readings lie on and that hides slow motion, rad/s; zero of others
    cut_steps: Array  # (3,) step that readings may have been cut to, if half of it matters, rad/s; zero of others
    lines: tuple[Line, ...]  # lines of the spectrum; a body that moves so shows them as well as an error of the gyro


def mark_consecutive_samples(recording: Recording, used: Mask) -> Mask:
    """Mark the samples that directly follow another of the same interval."""
    t = recording.gyro.t_s
    out = np.zeros(t.size, dtype=bool)
    out[1:] = (np.diff(t) < 1.5 * recording.gyro.sample_s) & used[1:] & used[:-1]
    return out


def find_long_runs(mask: Mask) -> list[tuple[int, int]]:
    """Find the unbroken runs of at least 256 samples, as slices."""
    return [(low, high) for low, high in find_mask_runs(mask) if high - low >= 256]
