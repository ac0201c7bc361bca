"""Sentences of an answer: symptoms that contradict a cause, mistaken units, and why a calibration may see no misfit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy.special

from diagnosis.model.linearise import linearise_recording
from diagnosis.model.misfit import compute_innovations
from diagnosis.model.prepare import PreparedRecording
from diagnosis.model.symptoms import SampleCause
from diagnosis.settings import DiagnosisSettings

if TYPE_CHECKING:
    from diagnosis.explain import AttitudeInference

LEAST_POSITIVE = 1e-300

FITS = 0.01  # p-value of χ² from which on a calibration says that the residuals fit
ALIKE = 0.1  # relative, of a noise factor and a ratio of units

MISTAKEN = {  # factors of white noise that a number in another unit makes, by symptom
    "white_noise_level": (
        (1 / 60, "1/60, as of an angle random walk in deg/√h where deg/√s is asked for"),
        (60.0, "60, as of an angle random walk in deg/√s that was taken for deg/√h"),
        (180 / np.pi, "180/π, as of an angle random walk in rad/√s where deg/√s is asked for"),
    ),
    "reference_noise_level": (
        (1 / 3600, "1/3600, as of sigmas in arcsec where degrees are asked for"),
        (1 / 60, "1/60, as of sigmas in arcmin where degrees are asked for"),
        (3600.0, "3600, as of sigmas in degrees that were taken for arcsec"),
        (180 / np.pi, "180/π, as of sigmas in rad where degrees are asked for"),
    ),
}


def explain_fitting_residuals(
    prepared: PreparedRecording, samples: Sequence[SampleCause], explained: AttitudeInference, gap: bool
) -> tuple[str, ...]:
    """Explain a gap although the residuals of a calibration fit the stated noise."""
    model = prepared.model
    if not (gap or samples):
        return ()
    # The calibration uses all references, the samples as recorded, and the stated noise.
    e, _, fitted_basis = compute_innovations(linearise_recording(model.recording, model.G, model.bias))
    chi2, dof = float(np.sum(e**2)), e.size - fitted_basis.shape[1]
    p = float(scipy.special.chdtrc(dof, chi2)) if dof > 0 else 0.0
    if p < FITS:
        return ()
    reasons = ["the gyro samples show what is hardly left of them over the time between two references"] if samples else []
    if gap and explained.fitted:
        remaining = model.y - sum(
            (model.project_out_nuisance(effect.contribution) for effect in explained.fitted), np.zeros(model.size)
        )
        names = " and ".join(effect.label for effect in explained.fitted)
        gain = model.y @ model.y - remaining @ remaining
        reasons.append(f"{names} takes {gain:.0f} off χ², which is much for it and little for {dof} residuals")
    elif gap:
        reasons.append(f"what departs is a few of {dof} residuals, or a pattern in them, for which χ² is no test")
    return (
        f"The residuals after a calibration fit the stated noise (χ² = {chi2:.0f} of {dof}, p = {p:.2g}), so that gyrocal "
        f"calibrate sees no gap; there is one all the same, since {'; and '.join(reasons)}",
    )


def list_odd_symptoms(samples: Sequence[SampleCause], settings: DiagnosisSettings) -> Iterator[str]:
    """List a sentence for each effect that the samples show although it would not behave so."""
    for sample in samples:
        if sample.effect is not None and sample.symptom.likeness < 1 - settings.named:
            cause = sample.cause(settings)
            yield (
                f"{cause.label} would show in the samples as something does, but hardly in this way "
                f"(p = {sample.symptom.likeness:.1g}); its probability is {cause.group_probability:.2f}"
            )


def list_unit_mistakes(samples: Sequence[SampleCause]) -> Iterator[str]:
    """List noise levels that are wrong by the factor of another unit."""
    for sample in samples:
        mistakes = [
            (abs(np.log(max(sample.symptom.size, LEAST_POSITIVE) / ratio)), mistake)
            for ratio, mistake in MISTAKEN.get(sample.symptom.kind, ())
        ]
        distance, mistake = min(mistakes, default=(np.inf, ""))
        if sample.effect is not None and distance < ALIKE:
            yield f"{sample.effect} is about {mistake}: look at the number that is stated, and its unit"


def list_likely_effects(explained: AttitudeInference, settings: DiagnosisSettings) -> tuple[str, ...]:
    """List effects that nearly every explanation of an unknown gap contains, though none is the whole cause."""
    attribution = explained.attribution
    if attribution is None or attribution.verdict != "unknown":
        return ()
    shares: dict[str, float] = {}
    for explanation in attribution.ranked:
        for label in explanation.labels:
            shares[label] = shares.get(label, 0.0) + explanation.probability
    listed = {candidate.label for candidate in explained.candidates if candidate.listed}
    return tuple(
        f"Whatever else is at work, {label} is part of explanations with a total probability of {share:.2f}"
        for label, share in sorted(shares.items(), key=lambda pair: -pair[1])
        if label in listed and share >= settings.named
    )
