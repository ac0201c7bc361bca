"""What the residuals of M0 say of a recording's lines and of its references' noise.

Whether a line in the samples is a vibration or a motion of the body is decided by the attitude (`diagnosis.model.lines`), and
so are tones that only the references show and whether the references' noise is as stated. All of them are effects of their own;
the model then is without the lines and tones, and has the actual noise. Once the search has found other effects, which move the
residuals as well, lines and noise are judged anew without these (`diagnosis.model.known_effects`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.noise_removal import remove_noise
from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries, estimate_reference_noise
from diagnosis.detectors.sample_report import SampleReport
from diagnosis.model.baseline import calibrate_baseline
from diagnosis.model.known_effects import KnownEffect, subtract_effects
from diagnosis.model.lines import judge_lines
from diagnosis.model.motion import add_expected_motion
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.reference_tones import find_reference_tone
from diagnosis.model.remainder import add_rounding
from diagnosis.model.sinusoid_causes import UNLISTED
from diagnosis.model.step_index import find_reference_steps
from diagnosis.settings import DiagnosisSettings
from gyrocal.recording import Interval, Recording
from simulator.effects.timing import compute_delay_columns

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

MOST_TONES = 3  # of the references, beyond their averages


@dataclass(frozen=True)
class UnclassifiedRecording:
    """A recording with what its samples show, about the calibration under M0, before the references were asked."""

    recording: Recording  # what was recorded
    report: SampleReport  # of the samples
    model: RecordingModel  # model, sigma: with the references as stated, and the (12,) sigma of its calibration
    sigma: Array
    pieces: tuple[Interval, ...]  # the intervals it is propagated over


@dataclass(frozen=True)
class PreparedRecording:
    """A recording ready for the attitude tests."""

    model: RecordingModel  # linearised about the calibration, on the repaired stream
    samples: SampleReport  # what the samples showed
    sigma: Array  # (12,) of the calibration under M0: G_xx … G_zz, b_x … b_z (rad/s)
    reference_noise: ReferenceNoise | None  # test of the references' noise, None without a series of them
    notes: tuple[str, ...]  # limits of this recording
    pieces: tuple[Interval, ...]  # the intervals that the model is propagated over

    @property
    def classified_symptoms(self) -> tuple[tuple[str, str | None], ...]:
        """Symptoms found in the residuals of M0: lines that are no motions, by gyro, and misfits of the references' noise."""
        lines = [(one.kind, one.axis) for one in self.samples.symptoms if one.of_line]
        noise = self.reference_noise
        odd = [("reference noise", None)] if noise is not None and noise.odd else []
        return tuple(sorted([*lines, *odd], key=str))

    @property
    def is_white(self) -> bool:
        """Whether the readings have white noise; those on a lattice coarser than it have errors that are not."""
        return not (self.samples.lattice | self.samples.hidden).any()


def classify_lines_and_noise(
    one: UnclassifiedRecording,
    settings: DiagnosisSettings,
    tell: Progress = lambda text, share: None,
    at_work: Sequence[KnownEffect] = (),
    tones: bool = True,
) -> PreparedRecording:
    """A recording ready for the attitude tests, without notes.

    Parameters
    ----------
    one : the recording
    settings : thresholds
    tell : called with a text and the share done of a whole diagnosis
    at_work : effects that have been found, which are taken out before lines and noise are judged
    tones : whether tones of the references are looked for
    """
    recording, report, model, sigma, pieces = one.recording, one.report, one.model, one.sigma, one.pieces
    count = max(len(report.lines), 1)

    def tell_line(done: int) -> None:
        tell("gyro samples: lines and references", 0.08 + 0.01 * done / count)

    if report.lines:
        report = judge_lines(report, subtract_effects(model, at_work), tell_line)
    if report.vibrations:
        report = replace(report, smooth=remove_noise(report.rates, recording))
        model, sigma = calibrate_baseline(recording, report, pieces, recording.attitudes.sigma)
    if tones:
        tell("gyro samples: fast tones of the references", 0.09)
        recording, report, model, sigma = _remove_tones(recording, report, pieces, model, sigma, settings)
    tell("gyro samples: noise of the references", 0.095)
    left = subtract_effects(model, at_work)
    noise = _measure_reference_noise(left, report, settings)
    factors = np.ones(3) if noise is None else noise.factors
    if (factors != 1.0).any():
        model, sigma = calibrate_baseline(recording, report, pieces, recording.attitudes.sigma * factors)
    if not (report.lattice | report.hidden).any():  # what these do to a reading is no noise of a known density

        def tell_smoothing(text: str, share: float) -> None:
            tell(f"gyro samples: {text}", 0.096 + 0.003 * share)

        model = add_expected_motion(model, report, pieces, recording.attitudes.sigma * factors, tell_smoothing)
    elif report.lattice.any():
        model = add_rounding(model, np.deg2rad(_find_coarse_steps(report)))
    return PreparedRecording(model, report, sigma, noise, (), pieces)


def _find_coarse_steps(report: SampleReport) -> Array:
    """Return the (3,) steps of readings that are coarser than their noise, deg/s; 0 where there are none."""
    steps = {one.axis: one.value for one in report.tests if one.statistic == "lattice_step"}
    return np.where(report.lattice, [steps.get(axis, 0.0) for axis in "xyz"], 0.0)


def reclassify_without_effects(
    prepared: PreparedRecording,
    at_work: Sequence[KnownEffect],
    settings: DiagnosisSettings,
    tell: Progress = lambda text, share: None,
) -> PreparedRecording | None:
    """A recording with its lines and its references' noise judged without some effects; None if the judgement is the same."""
    if not at_work or not (prepared.classified_symptoms or prepared.samples.lines):
        return None
    recording, pieces, report = prepared.model.recording, prepared.pieces, prepared.samples.restore_lines()
    model, sigma = prepared.model, prepared.sigma
    if prepared.samples.vibrations:
        report = replace(report, smooth=remove_noise(report.rates, recording))
    if prepared.classified_symptoms:
        model, sigma = calibrate_baseline(recording, report, pieces, recording.attitudes.sigma)
    again = classify_lines_and_noise(
        UnclassifiedRecording(recording, report, model, sigma, pieces), settings, tell, at_work, tones=False
    )
    return replace(again, notes=prepared.notes) if again.classified_symptoms != prepared.classified_symptoms else None


def _remove_tones(
    recording: Recording,
    report: SampleReport,
    pieces: tuple[Interval, ...],
    model: RecordingModel,
    sigma: Array,
    settings: DiagnosisSettings,
) -> tuple[Recording, SampleReport, RecordingModel, Array]:
    """Take the tones that only all references show out of a recording, as symptoms; also its model and the sigma of that."""
    if (report.lattice | report.hidden).any():
        return recording, report, model, sigma
    for _ in range(MOST_TONES):
        tone = find_reference_tone(model, report.rates, settings.sample_event, settings.unlisted_share)
        if tone is None:
            break
        symptom = tone.make_symptom(settings.group_share, settings.unknown)
        report = replace(report, symptoms=(*report.symptoms, symptom))
        if symptom.kind == UNLISTED:
            break
        recording, rates = tone.listed_causes[0][0].remove(recording, report.rates)
        report = replace(report, rates=rates)
        model, sigma = calibrate_baseline(recording, report, pieces, recording.attitudes.sigma)
    return recording, report, model, sigma


def _measure_reference_noise(
    model: RecordingModel,
    report: SampleReport,
    settings: DiagnosisSettings,
) -> ReferenceNoise | None:
    """The test of the references' noise, where no gyro hides motion between two references, which would look like it."""
    blind = set(np.flatnonzero(report.hidden | report.lattice).tolist())
    recording, density = model.recording, np.median(report.density, axis=0)
    series = ReferenceSeries(
        t_s=model.references.t_s,
        interval=model.interval_of_reference,
        sigma=recording.attitudes.sigma[model.reference_rows],
        to_inertial=model.at_reference,
        residuals=model.residuals,
        rates=model.rates[find_reference_steps(model)],
        error_axes=recording.attitudes.select_rows(model.reference_rows).build_error_axes(),
    )
    noise = estimate_reference_noise(series, density, settings)
    if noise is not None and noise.odd:
        noise = estimate_reference_noise(series, density, settings, model.compute_attitude_turns(_build_motion_errors(model)))
    return None if noise is not None and (noise.axis in blind or len(blind) == 3) else noise


def _build_motion_errors(model: RecordingModel) -> Array:
    """(n, 3, k) errors of readings that follow the motion: each rate on each axis, its size and its square, and its change.

    So does one of a bias that is not the same in all intervals, where the body turns from one reference to the next.
    """
    raw, mission = model.raw, (model.t_s - model.t_s.mean()) / max(float(np.ptp(model.t_s)), 1.0)
    own = np.zeros((len(raw), 3, 18))
    for axis in range(3):
        own[:, axis, 15 + axis] = mission
        own[:, axis, 3 * axis : 3 * axis + 3] = raw
        own[:, axis, 9 + axis] = np.abs(raw[:, axis])
        own[:, axis, 12 + axis] = raw[:, axis] ** 2
    return np.concatenate([own, compute_delay_columns(model.stream)], axis=2)
