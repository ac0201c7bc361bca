"""What a tone is, and the ways in which it can come about."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.report import Symptom
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Effect
from simulator.truth.rotation import perturbed

Array = NDArray[np.float64]

REFERENCE, BIAS, PICKUP, UNLISTED = "reference_tone", "bias_tone", "spectral_line", "unlisted_tone"


def waves(frequencies: Array, t_s: Array, duration_s: Array | float) -> Array:
    """(n, 2 f) sine and cosine of each frequency, or their means over as long."""
    angle = 2 * np.pi * np.outer(t_s, frequencies)
    mean = np.sinc(np.outer(np.broadcast_to(duration_s, t_s.shape), frequencies))
    return np.stack([np.sin(angle) * mean, np.cos(angle) * mean], axis=2).reshape(t_s.size, -1)


def effect_of(kind: str) -> Effect:
    """The effect that a symptom is a sign of."""
    return next(effect for effect in EFFECTS.values() if effect.symptom == kind)


@dataclass(frozen=True)
class Way:
    """A way in which a tone can come about.

    Attributes
    ----------
    kind : its symptom
    axis : about which
    frequency_hz : f, or an alias of it
    amplitudes : (2,) of sine and cosine, rad or rad/s
    sigma : of each of them
    log_weight : prior and evidence, not normalised
    """

    kind: str
    axis: int
    frequency_hz: float
    amplitudes: Array
    sigma: float
    log_weight: float

    @property
    def size(self) -> float:
        """Amplitude, rad or rad/s."""
        return float(np.hypot(*self.amplitudes))

    def at(self, t_s: Array) -> Array:
        """(n,) the tone at some times, rad or rad/s."""
        return np.asarray(waves(np.array([self.frequency_hz]), t_s, 0.0) @ self.amplitudes)

    def in_samples(self, recording: Recording) -> Array:
        """(samples,) the tone in the readings, rad/s: a bias is averaged over a sample, a vibration is not."""
        sample_s = recording.gyro.sample_s
        mean = np.sinc(self.frequency_hz * sample_s) if self.kind == BIAS else 1.0
        return self.at(recording.gyro.t_s + 0.5 * sample_s) * mean

    def stated(self) -> tuple[float, float, str, dict[str, float | str]]:
        """Size, its sigma, unit, and the other numbers, as the effect has them."""
        unit = effect_of(self.kind).unit
        factor = float(np.rad2deg(1.0)) * (3600 if self.kind == BIAS else 1)
        phase = {"phase_deg": float(np.rad2deg(np.arctan2(self.amplitudes[1], self.amplitudes[0])))}
        at: dict[str, float | str] = (
            {"apparent_hz": self.frequency_hz} if self.kind == PICKUP else {"period_s": 1 / self.frequency_hz}
        )
        return factor * self.size, factor * self.sigma, unit, {**at, **phase}


@dataclass(frozen=True)
class Tone:
    """A tone: the ways in which it can come about with their probabilities, the likeliest first.

    Attributes
    ----------
    ways : of kinds and axes that differ
    p_value : that noise has so strong a tone
    """

    ways: tuple[tuple[Way, float], ...]
    p_value: float

    @property
    def listed(self) -> tuple[tuple[Way, float], ...]:
        """The ways of effects on the list, the likeliest first."""
        return tuple((way, p) for way, p in self.ways if way.kind != UNLISTED)

    def symptom(self, least: float, unknown: float) -> Symptom:
        """As what the tests of the samples write; alternatives about the same axis have at least a share of the probability.

        Where something unlisted has more than `unknown` of the probability, it is the symptom of no effect.
        """
        listed = self.listed
        first = listed[0][0] if listed else self.ways[0][0]
        text = f"all references show a tone at {self.ways[0][0].frequency_hz:.4g} Hz, too fast for their averages"
        axis = "xyz"[first.axis]
        if 1 - sum(p for _, p in listed) > unknown:
            return Symptom(UNLISTED, axis, 0.0, "", 0.0, {}, self.p_value, text)
        same = [(way.kind, p) for way, p in listed if way.axis == first.axis]
        same = [one for one in same if one[1] >= least * sum(p for _, p in same)]
        total = sum(p for _, p in same)
        size, sigma, unit, parameters = first.stated()
        rivals = tuple((kind, p / total) for kind, p in same[1:])
        return Symptom(first.kind, axis, size, unit, sigma, parameters, self.p_value, text, total, rivals)


def without(recording: Recording, rates: Array, way: Way) -> tuple[Recording, Array]:
    """The recording with a tone of the references taken out, or the (samples, 3) rates with that of a reading."""
    attitudes = recording.attitudes
    if way.kind == REFERENCE:
        error = np.zeros((attitudes.t_s.size, 3))
        error[:, way.axis] = way.at(attitudes.t_s)
        return replace(recording, attitudes=replace(attitudes, quaternions=perturbed(attitudes.quaternions, -error))), rates
    rates = rates.copy()
    rates[:, way.axis] -= way.in_samples(recording)
    return recording, rates
