"""What the residuals of M0 say of the references' noise.

Whether it is as stated is an effect of its own; the model then has the actual noise. Once the search has found other effects,
which move the residuals as well, the noise is judged anew without these (`diagnosis.model.known_effects`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries, estimate_reference_noise
from diagnosis.detectors.sample_report import Line, SampleReport
from diagnosis.model.baseline import calibrate_baseline
from diagnosis.model.known_effects import KnownEffect, subtract_effects
from diagnosis.model.motion import add_expected_motion
from diagnosis.model.periods import make_grid
from diagnosis.model.recording_model import RecordingModel
from diagnosis.model.rounding import add_rounding
from diagnosis.model.step_index import find_reference_steps
from diagnosis.settings import DiagnosisSettings
from gyrocal.recording import Interval, Recording
from simulator.effects.timing import compute_delay_columns

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]


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
    one: UnclassifiedRecording,
    settings: DiagnosisSettings,
    tell: Progress = lambda text, share: None,
    at_work: Sequence[KnownEffect] = (),
) -> PreparedRecording:
    """A recording ready for the attitude tests, without notes.

    Parameters
    ----------
    one : the recording
    settings : thresholds
    tell : called with a text and the share done of a whole diagnosis
    at_work : effects that have been found, which are taken out before the noise is judged
    """
    recording, report, model, sigma, pieces = one.recording, one.report, one.model, one.sigma, one.pieces
    tell("gyro samples: noise of the references", 0.09)
    noise = _measure_reference_noise(subtract_effects(model, at_work), report, settings)
    factors = np.ones(3) if noise is None else noise.factors
    if (factors != 1.0).any():
        model, sigma = calibrate_baseline(recording, report, pieces, recording.attitudes.sigma * factors)
    if not (report.lattice | report.hidden).any():  # what these do to a reading is no noise of a known density

        def tell_smoothing(text: str, share: float) -> None:
            tell(f"gyro samples: {text}", 0.096 + 0.003 * share)

        model = add_expected_motion(model, report, pieces, recording.attitudes.sigma * factors, tell_smoothing)
    elif report.lattice.any():
        model = add_rounding(model, np.deg2rad(_find_coarse_steps(report)))
    model = replace(model, lines=_select_fast_lines(model, report.lines))
    return PreparedRecording(model, report, sigma, noise, (), pieces)


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
    prepared: PreparedRecording,
    at_work: Sequence[KnownEffect],
    settings: DiagnosisSettings,
    tell: Progress = lambda text, share: None,
) -> PreparedRecording | None:
    """A recording with its references' noise judged without some effects; None if the judgement is the same."""
    if not at_work or not prepared.has_odd_references:
        return None
    recording, pieces, report = prepared.model.recording, prepared.pieces, prepared.samples
    model, sigma = calibrate_baseline(recording, report, pieces, recording.attitudes.sigma)
    again = classify_noise(UnclassifiedRecording(recording, report, model, sigma, pieces), settings, tell, at_work)
    return None if again.has_odd_references else replace(again, notes=prepared.notes, unobserved=prepared.unobserved)


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
