"""Prepare a recording: linearise it about its own calibration under M0, and judge the references' noise.

The samples are examined first, since a repeated sample spoils every test of the attitude. White noise that is not
as stated, of the samples or of the references, is an effect of its own; it is found here, and the model then has the actual
noise.

The references' noise is judged by what M0 leaves of them. An effect that moves those residuals is visible there, too: a changed
misalignment makes the references of a spinning body look noisier from some moment on. Once the search has found effects with
columns, the noise is judged anew without them:

    ζ' = ζ − Σ e_k a_k − e_p δp,

e_k the attitude errors of the effects' columns, a_k their amplitudes, and δp the change of G and b that fits ζ − Σ e_k a_k
best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from diagnosis.arrays import Array
from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries, estimate_reference_noise
from diagnosis.detectors.sample_report import Line, SampleReport
from diagnosis.detectors.samples import examine
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.baseline import calibrate_baseline, compute_correction, describe_unobserved, report_unobserved
from diagnosis.model.bins import find_reference_steps
from diagnosis.model.misfit import compute_attitude_errors
from diagnosis.model.motion import add_expected_motion
from diagnosis.model.periods import make_grid
from diagnosis.model.recording_model import RecordingModel, build_parameter_errors
from diagnosis.model.rounding import add_rounding
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.errors import InputError
from gyrocal.masking import mark_interval_samples
from gyrocal.recording import Recording, find_reference_rows
from simulator.effects.base import Effect
from simulator.effects.timing import compute_delay_columns

__all__ = ["PreparedRecording", "Progress", "prepare"]

Progress = Callable[[str, float], None]
KnownEffect = tuple[Effect, FittedEffect]  # an effect with columns, and its amplitudes


def prepare(
    recording: Recording, settings: DiagnosisSettings = DEFAULT, tell: Progress = lambda text, share: None
) -> PreparedRecording:
    """Examine the samples, calibrate under M0 by Gauss–Newton on the linear model, and linearise there.

    An `InputError` if the stream does not cover the intervals, or nothing is left of them. Progress is told as a text and the
    share done of a whole diagnosis.
    """
    _check_samples(recording)
    tell("gyro samples", 0.01)
    report = examine(recording, settings)
    tell("first calibration", 0.06)
    found = classify_noise(recording, report, settings)
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


@dataclass(frozen=True)
class PreparedRecording:
    """A recording ready for the attitude tests."""

    model: RecordingModel  # linearised about the calibration, on the repaired stream
    samples: SampleReport  # what the samples showed
    sigma: Array  # (12,) of the calibration under M0: G_xx … G_zz, b_x … b_z (rad/s)
    reference_noise: ReferenceNoise | None  # test of the references' noise, None without a series of them
    notes: tuple[str, ...]  # limits of this recording
    unobserved: tuple[str, ...] = ()  # elements of G and b that these motions do not show

    @property
    def has_odd_references(self) -> bool:
        """Whether the noise of the references is not as stated."""
        return self.reference_noise is not None and self.reference_noise.odd

    @property
    def is_white(self) -> bool:
        """Whether the readings have white noise; those on a lattice coarser than it have errors that are not."""
        return not (self.samples.lattice | self.samples.hidden).any()


def classify_noise(
    recording: Recording, report: SampleReport, settings: DiagnosisSettings, at_work: Sequence[KnownEffect] = ()
) -> PreparedRecording:
    """A recording ready for the attitude tests, without notes; effects at work are taken out before the noise is judged."""
    stated = recording.attitudes.sigma
    model, sigma = calibrate_baseline(recording, report, stated)
    noise = _measure_reference_noise(subtract_effects(model, at_work), report, settings)
    factors = np.ones(3) if noise is None else noise.factors
    if (factors != 1.0).any():
        model, sigma = calibrate_baseline(recording, report, stated * factors)
    if not (report.lattice | report.hidden).any():  # what these do to a reading is no noise of a known density
        model = add_expected_motion(model, report, stated * factors)
    elif report.lattice.any():
        model = add_rounding(model, np.deg2rad(_find_coarse_steps(report)))
    model = replace(model, lines=_select_fast_lines(model, report.lines))
    return PreparedRecording(model, report, sigma, noise, ())


def _select_fast_lines(model: RecordingModel, lines: Sequence[Line]) -> Array | None:
    """(n, 3, k) the lines that are faster than the scan of periods; None without any. They would pass for slow ones."""
    grid = make_grid(model)
    fast = [] if grid is None else [line for line in lines if line.frequency_hz > grid.tried.max()]
    return _build_line_errors(model, fast) if fast else None


def _build_line_errors(model: RecordingModel, lines: Sequence[Line]) -> Array:
    """(n, 3, k) readings that are too high by each of some lines, rad/s."""
    out = np.zeros((model.t_s.size, 3, len(lines)))
    sample = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    for place, line in enumerate(lines):
        out[:, line.axis, place] = line.waveform[sample]
    return out


def _find_coarse_steps(report: SampleReport) -> Array:
    """Return the (3,) steps of readings that are coarser than their noise, deg/s; 0 where there are none."""
    steps = {one.axis: one.value for one in report.tests if one.statistic == "lattice_step"}
    return np.where(report.lattice, [steps.get(axis, 0.0) for axis in "xyz"], 0.0)


def reclassify_without_effects(
    prepared: PreparedRecording, at_work: Sequence[KnownEffect], settings: DiagnosisSettings
) -> PreparedRecording | None:
    """A recording with its references' noise judged without some effects; None if the judgement is the same."""
    if not at_work or not prepared.has_odd_references:
        return None
    again = classify_noise(prepared.model.recording, prepared.samples, settings, at_work)
    return None if again.has_odd_references else replace(again, notes=prepared.notes, unobserved=prepared.unobserved)


def _measure_reference_noise(model: RecordingModel, report: SampleReport, settings: DiagnosisSettings) -> ReferenceNoise | None:
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
        noise = estimate_reference_noise(
            series, density, settings, model.compute_attitude_turns(_build_motion_errors(model, report.lines))
        )
    return None if noise is not None and (noise.axis in blind or len(blind) == 3) else noise


def _build_motion_errors(model: RecordingModel, lines: Sequence[Line]) -> Array:
    """(n, 3, k) errors of readings that follow the motion: each rate on each axis, its size and its square, and its change.

    So does one of a bias that is not the same in all intervals, where the body turns from one reference to the next, and so may
    each line in the samples.
    """
    raw, mission = model.raw, (model.t_s - model.t_s.mean()) / max(float(np.ptp(model.t_s)), 1.0)
    own = np.zeros((len(raw), 3, 18))
    for axis in range(3):
        own[:, axis, 15 + axis] = mission
        own[:, axis, 3 * axis : 3 * axis + 3] = raw
        own[:, axis, 9 + axis] = np.abs(raw[:, axis])
        own[:, axis, 12 + axis] = raw[:, axis] ** 2
    return np.concatenate([own, compute_delay_columns(model.stream), _build_line_errors(model, lines)], axis=2)


def select_known_effects(fitted: Sequence[FittedEffect], effects: Mapping[str, Effect]) -> tuple[KnownEffect, ...]:
    """Select the identified effects whose attitude errors are known, and not only their statistics."""
    return tuple(
        (effects[one.effect], one)
        for one in fitted
        if not one.process and one.effect in effects and effects[one.effect].has_columns
    )


def subtract_effects(model: RecordingModel, at_work: Sequence[KnownEffect]) -> RecordingModel:
    """The model with the residuals that are left without some effects, where their columns are those of their amplitudes."""
    errors = []
    for effect, one in at_work:
        columns = compute_attitude_errors(model, effect, one.axis, one.parameters)
        if columns.shape[2] == one.amplitudes.size:
            errors.append(columns @ one.amplitudes)
    if not errors:
        return model
    left = _replace_residuals(model, model.residuals - np.sum(errors, axis=0))
    change, _ = compute_correction(left)
    high = -np.einsum("ij,njk->nik", np.linalg.inv(model.G), build_parameter_errors(model.raw))
    return _replace_residuals(model, left.residuals - model.compute_attitude_turns(high) @ change)


def _replace_residuals(model: RecordingModel, residuals: Array) -> RecordingModel:
    return replace(model, residuals=residuals, zeta=model.average_references(residuals).ravel())
