"""Prepare a recording: linearise it about its own calibration under M0.

The samples are examined first, since a repeated sample spoils every test of the attitude. White noise that is not
as stated, of the samples or of the references, is an effect of its own; it is found here, and the model then has the actual
noise. What the references say of their own noise is in `diagnosis.model.noise_classification`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from diagnosis.detectors.sample_report import scale_progress
from diagnosis.detectors.samples import examine
from diagnosis.model.baseline import calibrate_baseline, describe_unobserved, report_unobserved
from diagnosis.model.noise_classification import PreparedRecording, Progress, UnclassifiedRecording, classify_noise
from diagnosis.model.recording_model import RecordingModel
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.errors import InputError
from gyrocal.masking import mark_interval_samples
from gyrocal.recording import Recording, find_reference_rows

__all__ = ["PreparedRecording", "Progress", "prepare"]


def prepare(
    recording: Recording, settings: DiagnosisSettings = DEFAULT, tell: Progress = lambda text, share: None
) -> PreparedRecording:
    """Examine the samples, calibrate under M0 by Gauss–Newton on the linear model, and linearise there.

    An `InputError` if the stream does not cover the intervals, or nothing is left of them.

    Parameters
    ----------
    recording : what was recorded
    settings : thresholds
    tell : called with a text and the share done of a whole diagnosis
    """
    _check_samples(recording)

    def tell_samples(text: str, share: float) -> None:
        tell(f"gyro samples: {text}", share)

    report = examine(recording, settings=settings, tell=scale_progress(tell_samples, 0.01, 0.06))
    pieces, stated = recording.intervals, recording.attitudes.sigma
    model, sigma = calibrate_baseline(recording, report, pieces, stated, scale_progress(tell_samples, 0.06, 0.07))
    found = classify_noise(UnclassifiedRecording(recording, report, model, sigma, pieces), settings, tell)
    return replace(
        found, notes=(*report_noise_levels(found), *_write_notes(found.model)), unobserved=report_unobserved(found.model)[0]
    )


def _check_samples(recording: Recording) -> None:
    if mark_interval_samples(recording).sum() < 2 * len(recording.intervals):
        prepare_measurements(recording)  # says which interval lacks samples
    if not mark_interval_samples(recording).any():
        raise InputError("no gyro sample starts inside any interval")


def report_noise_levels(found: PreparedRecording) -> Iterator[str]:
    """Sentences with the noise that the diagnosis estimated, where the recording states none of its own."""
    recording, noise = found.model.recording, found.reference_noise
    if recording.gyro.arw_estimated:
        levels = ", ".join(f"{level:.3g}" for level in recording.gyro.arw_deg_per_sqrt_s * found.samples.noise_factor)
        yield f"Angle random walk estimated as {levels} deg/√s about x, y, z; the recording states an estimate only"
    if recording.attitudes.sigma_estimated and noise is not None:
        factors = noise.factors if noise.departs else np.ones(3)
        sigmas = ", ".join(f"{sigma:.3g}" for sigma in np.median(recording.attitudes.sigma_deg, axis=0) * factors)
        yield f"Noise of the references estimated as {sigmas} deg about x, y, z; the recording states an estimate only"


def _write_notes(model: RecordingModel) -> tuple[str, ...]:
    notes, recording = [], model.recording
    counts = [find_reference_rows(recording.attitudes.t_s, interval).size for interval in recording.intervals]
    if max(counts) <= 2:
        left = 3 * len(counts) - 12
        notes.append(
            f"References only at the ends of {len(counts)} intervals: {max(left, 0)} degrees of freedom are left beside the 12 "
            "of the calibration, so most effects cannot be told from one another or from a change of G and b"
        )
    notes += describe_unobserved(model)
    notes.append(
        "A constant offset of the references acts like a rotation of G and of the start attitudes: no recording of gyro and "
        "reference attitudes can show it"
    )
    return tuple(notes)
