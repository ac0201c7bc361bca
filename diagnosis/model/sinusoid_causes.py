"""Causes of a sinusoid: an error of the references, a variation of the bias, a vibration, or none of the library."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.sample_report import Symptom
from diagnosis.sinusoids.fit import make_waves
from gyrocal.recording import Recording
from simulator.effects import EFFECTS, Effect
from simulator.truth.rotation import apply_rotation_errors

Array = NDArray[np.float64]

REFERENCE, BIAS, PICKUP, UNLISTED = "reference_tone", "bias_tone", "spectral_line", "unlisted_tone"


def get_effect(kind: str) -> Effect:
    """Return the effect that a symptom is a sign of."""
    return next(effect for effect in EFFECTS.values() if effect.symptom == kind)


@dataclass(frozen=True)
class SinusoidCause:
    """A cause of a sinusoid."""

    kind: str  # its symptom
    axis: int  # about which
    frequency_hz: float  # f, or an alias of it
    amplitudes: Array  # (2,) of sine and cosine, rad or rad/s
    sigma: float  # of each of them
    log_weight: float = 0.0  # prior and evidence, not normalised

    def compute_at(self, t_s: Array) -> Array:
        """Compute the sinusoid (n,) at some times, rad or rad/s."""
        return np.asarray(make_waves(self.frequency_hz, t_s) @ self.amplitudes)

    def compute_in_samples(self, recording: Recording) -> Array:
        """Compute the sinusoid in the readings, rad/s: a bias is averaged over a sample, a vibration is not."""
        sample_s = recording.gyro.sample_s
        mean = np.sinc(self.frequency_hz * sample_s) if self.kind == BIAS else 1.0
        return self.compute_at(recording.gyro.t_s + 0.5 * sample_s) * mean

    def state(self) -> tuple[float, float, str, dict[str, float | str]]:
        """Return size, its sigma, unit, and the other numbers, as the effect has them."""
        factor = float(np.rad2deg(1.0)) * (3600 if self.kind == BIAS else 1)
        parameters: dict[str, float | str] = (
            {"apparent_hz": self.frequency_hz} if self.kind == PICKUP else {"period_s": 1 / self.frequency_hz}
        )
        parameters["phase_deg"] = float(np.rad2deg(np.arctan2(self.amplitudes[1], self.amplitudes[0])))
        return factor * float(np.hypot(*self.amplitudes)), factor * self.sigma, get_effect(self.kind).unit, parameters

    def remove(self, recording: Recording, rates: Array) -> tuple[Recording, Array]:
        """Return the recording and its (samples, 3) rates without the sinusoid."""
        attitudes = recording.attitudes
        if self.kind == REFERENCE:
            error = np.zeros((attitudes.t_s.size, 3))
            error[:, self.axis] = self.compute_at(attitudes.t_s)
            return replace(
                recording, attitudes=replace(attitudes, quaternions=apply_rotation_errors(attitudes.quaternions, -error))
            ), rates
        rates = rates.copy()
        rates[:, self.axis] -= self.compute_in_samples(recording)
        return recording, rates


@dataclass(frozen=True)
class ReferenceTone:
    """A sinusoid of the references: its possible causes with their probabilities, the likeliest first."""

    causes: tuple[tuple[SinusoidCause, float], ...]  # of kinds and axes that differ
    p_value: float  # that noise has so strong a sinusoid

    @property
    def listed_causes(self) -> tuple[tuple[SinusoidCause, float], ...]:
        """Causes of the library, the likeliest first."""
        return tuple((cause, p) for cause, p in self.causes if cause.kind != UNLISTED)

    def make_symptom(self, least: float, unknown: float) -> Symptom:
        """Make the symptom; alternatives about the same axis have at least a share of the probability.

        Where causes outside the library have more than `unknown` of the probability, it is the symptom of no effect.
        """
        first = (self.listed_causes or self.causes)[0][0]
        text = f"all references show a tone at {self.causes[0][0].frequency_hz:.4g} Hz, too fast for their averages"
        axis = "xyz"[first.axis]
        if 1 - sum(p for _, p in self.listed_causes) > unknown:
            return Symptom(UNLISTED, axis, 0.0, "", 0.0, {}, self.p_value, text)
        same = [(cause.kind, p) for cause, p in self.listed_causes if cause.axis == first.axis]
        same = [one for one in same if one[1] >= least * sum(p for _, p in same)]
        total = sum(p for _, p in same)
        size, sigma, unit, parameters = first.state()
        rivals = tuple((kind, p / total) for kind, p in same[1:])
        return Symptom(first.kind, axis, size, unit, sigma, parameters, self.p_value, text, total, rivals)
