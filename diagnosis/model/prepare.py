"""Prepare a recording: linearise it about its own calibration under M0, and classify the references' noise.

The samples are examined first, since a repeated sample spoils every test of the attitude. White noise that is not
as stated, of the samples or of the references, is an effect of its own; it is found here, and the model then has the actual
noise.

The references' noise is classified by their residuals under M0. An effect that changes these residuals is visible there, too: a
changed misalignment makes the references of a spinning body look noisier from some moment on. Once the search has found effects
with columns, the noise is classified again without them:

    ζ' = ζ − Σ e_k a_k − e_p δp,

e_k the attitude errors of the effects' columns, a_k their amplitudes, and δp the change of G and b that fits ζ − Σ e_k a_k
best.

Columns of effects that follow the rate, such as its cube, are computed from the samples, and the attitude propagated with these
has the same noise. A column with this noise in it explains the noise of the residuals, and a clean gyro seems to have an
effect: coefficients of noisy regressors are biased (Fuller, Measurement Error Models, Wiley 1987, section 1.1).

The residuals z, with covariance V, contain the gyro's noise. The best estimate of the noise n(t) of the calibrated rates is
E[n(t) | z] = E[n(t) zᵀ] V⁻¹ z. In inertial axes an observation at t_k holds −∫n dt up to t_k, so that

    E[n(t) | z] = −P(t) Σ_{t_k > t} u_k,    u = V⁻¹ (z − C θ),

with P the density of the noise and C θ the least-squares fit of the nuisance parameters. Rates less this estimate are the best
linear unbiased estimate of the motion, whose error is uncorrelated with the residuals (Rao, Linear Statistical Inference and
Its Applications, Wiley 1973, section 5a.2). Smoothing the rates afterwards does not change that.

All this holds for residuals of noise alone. With an error of a hundred sigmas in them the estimate would be a hundred times the
noise, and the rates without it would not be the motion. Where χ² exceeds its degrees of freedom, u is multiplied by √(dof/χ²),
so that the estimate is as large as noise would make it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from diagnosis.detectors.noise_removal import remove_noise
from diagnosis.detectors.number_format import compute_cut_error
from diagnosis.detectors.reference_noise import ReferenceNoise, ReferenceSeries, estimate_reference_noise
from diagnosis.detectors.sample_report import Line, SampleReport
from diagnosis.detectors.samples import examine
from diagnosis.inference.amplitudes import FittedEffect
from diagnosis.model.calibration import calibrate_baseline, compute_correction, describe_unobserved, report_unobserved
from diagnosis.model.linearise import linearise_recording
from diagnosis.model.misfit import compute_attitude_errors
from diagnosis.model.periods import make_grid
from diagnosis.model.recording_model import RecordingModel, build_parameter_errors
from diagnosis.model.rounding import add_rounding
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.arrays import Array
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
    recording: Recording, settings: DiagnosisSettings = DEFAULT, progress: Progress = lambda text, share: None
) -> PreparedRecording:
    """Examine the samples, calibrate under M0 by Gauss–Newton on the linear model, and linearise there.

    Raises an `InputError` if the stream does not cover the intervals, or no sample is inside them. `progress` is called with a
    text and the share done of a whole diagnosis.
    """
    if mark_interval_samples(recording).sum() < 2 * len(recording.intervals):
        prepare_measurements(recording)  # says which interval lacks samples
    if not mark_interval_samples(recording).any():
        raise InputError("no gyro sample starts inside any interval")
    progress("gyro samples", 0.01)
    report = examine(recording, settings)
    progress("first calibration", 0.06)
    prepared = classify_noise(recording, report, settings)
    return replace(prepared, notes=tuple(_write_notes(prepared)), unobserved=report_unobserved(prepared.model)[0])


def _write_notes(prepared: PreparedRecording) -> Iterator[str]:
    """Write sentences on noise that was estimated where the recording states none, and on parameters that cannot be seen."""
    recording, noise = prepared.model.recording, prepared.reference_noise
    if recording.gyro.arw_estimated:
        levels = ", ".join(f"{level:.3g}" for level in recording.gyro.arw_deg_per_sqrt_s * prepared.samples.noise_factor)
        yield f"Angle random walk estimated as {levels} deg/√s about x, y, z; the recording states an estimate only"
    if recording.attitudes.sigma_estimated and noise is not None:
        factors = noise.factors if noise.departs else np.ones(3)
        sigmas = ", ".join(f"{sigma:.3g}" for sigma in np.median(recording.attitudes.sigma_deg, axis=0) * factors)
        yield f"Noise of the references estimated as {sigmas} deg about x, y, z; the recording states an estimate only"
    counts = [find_reference_rows(recording.attitudes.t_s, interval).size for interval in recording.intervals]
    if max(counts) <= 2:
        yield (
            f"References only at the ends of {len(counts)} intervals: {max(3 * len(counts) - 12, 0)} degrees of freedom are "
            "left beside the 12 of the calibration, so most effects cannot be told from one another or from a change of G and b"
        )
    yield from describe_unobserved(prepared.model)
    yield (
        "A constant offset of the references acts like a rotation of G and of the start attitudes: no recording of gyro and "
        "reference attitudes can show it"
    )


@dataclass(frozen=True)
class PreparedRecording:
    """A recording ready for the attitude tests."""

    model: RecordingModel  # linearised about the calibration, on the filled stream
    samples: SampleReport  # what the samples showed
    sigma: Array  # (12,) of the calibration under M0: G_xx … G_zz, b_x … b_z (rad/s)
    reference_noise: ReferenceNoise | None  # test of the references' noise, None without a series of them
    notes: tuple[str, ...]  # limits of this recording
    unobserved: tuple[str, ...] = ()  # elements of G and b that these motions do not show

    @property
    def has_odd_references(self) -> bool:
        """Whether the noise of the references is not as stated."""
        return self.reference_noise is not None and self.reference_noise.is_unusual

    @property
    def is_white(self) -> bool:
        """Whether the readings have white noise; those on a lattice coarser than it have errors that are not."""
        return not self.samples.coarse_steps.any()


def classify_noise(
    recording: Recording, report: SampleReport, settings: DiagnosisSettings, known_effects: Sequence[KnownEffect] = ()
) -> PreparedRecording:
    """Calibrate under M0 with the classified noise of the references; known effects are subtracted before it is classified."""
    stated = recording.attitudes.sigma
    model, sigma = calibrate_baseline(recording, report, stated)
    noise = _measure_reference_noise(subtract_effects(model, known_effects), report, settings)
    factors = np.ones(3) if noise is None else noise.factors
    if (factors != 1.0).any():
        model, sigma = calibrate_baseline(recording, report, stated * factors)
    if report.coarse_steps.any():  # rounding to these steps is no noise of a known density
        model = add_rounding(model, report.coarse_steps)
    else:
        model = add_expected_motion(model, report, stated * factors)
    # Lines that are faster than the scan of periods would pass for slow ones.
    grid = make_grid(model)
    fast = [] if grid is None else [line for line in report.lines if line.frequency_hz > grid.tried.max()]
    errors = np.concatenate([_build_line_errors(model, fast), _build_cut_errors(model, report.cut_steps)], axis=2)
    return PreparedRecording(replace(model, nuisance_errors=errors if errors.size else None), report, sigma, noise, ())


def _build_line_errors(model: RecordingModel, lines: Sequence[Line]) -> Array:
    """Build the errors (n, 3, k) of the readings by each line, rad/s."""
    out = np.zeros((model.t_s.size, 3, len(lines)))
    sample = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    for place, line in enumerate(lines):
        out[:, line.axis, place] = line.waveform[sample]
    return out


def _build_cut_errors(model: RecordingModel, steps: Array) -> Array:
    """Build the errors (n, 3, k) of readings that are cut toward zero to steps (3,), rad/s, one a step that is not zero."""
    axes, gyro = np.flatnonzero(steps), model.recording.gyro
    out = np.zeros((model.t_s.size, 3, axes.size))
    for place, axis in enumerate(axes):
        out[:, axis, place] = compute_cut_error(model.raw[:, axis], steps[axis], gyro.arw / float(np.sqrt(gyro.sample_s)))
    return out


def reclassify_without_effects(
    prepared: PreparedRecording, known_effects: Sequence[KnownEffect], settings: DiagnosisSettings
) -> PreparedRecording | None:
    """Classify the references' noise again without known effects; None unless the noise is as stated without them."""
    if not known_effects or not prepared.has_odd_references:
        return None
    reclassified = classify_noise(prepared.model.recording, prepared.samples, settings, known_effects)
    return (
        None if reclassified.has_odd_references else replace(reclassified, notes=prepared.notes, unobserved=prepared.unobserved)
    )


def _measure_reference_noise(model: RecordingModel, report: SampleReport, settings: DiagnosisSettings) -> ReferenceNoise | None:
    """Test the references' noise; None where a lattice hides motion about the departing axis, which looks like noise."""
    hidden_axes = set(np.flatnonzero(report.coarse_steps).tolist())
    recording, density = model.recording, np.median(report.density, axis=0)
    series = ReferenceSeries(
        t_s=model.references.t_s,
        interval=model.interval_of_reference,
        sigma=recording.attitudes.sigma[model.reference_rows],
        to_inertial=model.at_reference,
        residuals=model.residuals,
        error_axes=recording.attitudes.select_rows(model.reference_rows).build_error_axes(),
    )
    noise = estimate_reference_noise(series, density, settings)
    if noise is not None and noise.is_unusual:
        noise = estimate_reference_noise(
            series, density, settings, model.compute_attitude_turns(_build_motion_errors(model, report.lines))
        )
    return None if noise is not None and (noise.axis in hidden_axes or len(hidden_axes) == 3) else noise


def _build_motion_errors(model: RecordingModel, lines: Sequence[Line]) -> Array:
    """Build errors (n, 3, k) of readings that follow the motion: each rate on each axis, its size, its square and its change.

    A bias drift follows the motion where the body turns from one reference to the next, and each line of the samples may.
    """
    raw, mission = model.raw, (model.t_s - model.t_s.mean()) / max(float(np.ptp(model.t_s)), 1.0)
    errors = np.zeros((len(raw), 3, 18))
    for axis in range(3):
        errors[:, axis, 15 + axis] = mission
        errors[:, axis, 3 * axis : 3 * axis + 3] = raw
        errors[:, axis, 9 + axis] = np.abs(raw[:, axis])
        errors[:, axis, 12 + axis] = raw[:, axis] ** 2
    return np.concatenate([errors, compute_delay_columns(model.stream), _build_line_errors(model, lines)], axis=2)


def select_known_effects(fitted: Sequence[FittedEffect], effects: Mapping[str, Effect]) -> tuple[KnownEffect, ...]:
    """Select the identified effects whose attitude errors are known, and not only their statistics."""
    return tuple(
        (effects[member.effect], member)
        for member in fitted
        if not member.process and member.effect in effects and effects[member.effect].has_columns
    )


def subtract_effects(model: RecordingModel, known_effects: Sequence[KnownEffect]) -> RecordingModel:
    """Subtract known effects from the residuals, those whose columns match their amplitudes, and fit G and b again."""
    errors = []
    for effect, fitted in known_effects:
        columns = compute_attitude_errors(model, effect, fitted.axis, fitted.parameters)
        if columns.shape[2] == fitted.amplitudes.size:
            errors.append(columns @ fitted.amplitudes)
    if not errors:
        return model
    reduced = _replace_residuals(model, model.residuals - np.sum(errors, axis=0))
    change, _ = compute_correction(reduced)
    rate_errors = -np.einsum("ij,njk->nik", np.linalg.inv(model.G), build_parameter_errors(model.raw))
    return _replace_residuals(model, reduced.residuals - model.compute_attitude_turns(rate_errors) @ change)


def _replace_residuals(model: RecordingModel, residuals: Array) -> RecordingModel:
    return replace(model, residuals=residuals, zeta=model.average_references(residuals).ravel())


def estimate_gyro_noise(model: RecordingModel, density: Array | None) -> tuple[Array, Array]:
    """Estimate the gyro's noise from the residuals, of a density (samples, 3), rad²/s, that may differ from the stated one.

    Returns the expected error (samples, 3) of the raw rates, rad/s, zero where nothing is propagated, and rotation vectors
    (m, 3) from the propagated attitudes to the expected ones at the references, inertial axes, rad.
    """
    gyro, inverse = model.recording.gyro, np.linalg.inv(model.G)
    noise, turned = np.zeros(gyro.rates.shape), np.zeros((model.reference_rows.size, 3))
    excess = float(model.y @ model.y) / max(model.degrees_of_freedom, 1)
    weighed_residuals = model.weighed_residuals / np.sqrt(max(excess, 1.0))
    for block, references in zip(model.blocks, model.reference_slices, strict=True):
        t_s, to_inertial = model.t_s[block.steps], model.to_inertial[block.steps]
        edges_s = np.append(t_s - 0.5 * model.dt[block.steps], t_s[-1] + 0.5 * model.dt[block.steps][-1])
        last_step = block.ends[block.groups + block.counts // 2]
        # The sum in E[n(t) | z]: over the observations that end after each step.
        later_sum = np.zeros((t_s.size + 1, 3))
        np.add.at(later_sum, last_step, weighed_residuals[block.rows].reshape(-1, 3))
        later_sum = np.cumsum(later_sum[::-1], axis=0)[::-1][1:]
        middle_s = gyro.t_s + 0.5 * gyro.sample_s
        inside = np.flatnonzero((middle_s > edges_s[0]) & (middle_s < edges_s[-1]))
        step = np.searchsorted(edges_s, middle_s[inside], side="right") - 1
        u = np.einsum("nij,ni->nj", to_inertial[step], later_sum[step])  # in body axes
        noise[inside] = -((u @ model.G) * density[inside] if density is not None else gyro.arw**2 * (u @ inverse.T))
        # The mean error of each step's samples turns the attitude.
        count = np.bincount(step, minlength=t_s.size)
        mean = (
            np.column_stack([np.bincount(step, noise[inside, k], t_s.size) for k in range(3)]) / np.maximum(count, 1)[:, None]
        )
        moved = -np.einsum("nij,nj->ni", to_inertial, mean @ model.G.T) * model.dt[block.steps, None]
        total = np.vstack([np.zeros(3), np.cumsum(moved, axis=0)])
        turned[references] = total[block.ends]
    return noise, turned


def add_expected_motion(model: RecordingModel, report: SampleReport, sigma: Array) -> RecordingModel:
    """Linearise a model again about the motion that gyro and references show together; sigma (references, 3), rad."""
    noise, turned = estimate_gyro_noise(model, report.density)
    motion = remove_noise(report.rates - noise, model.recording)
    relinearised = linearise_recording(model.recording, model.G, model.bias, report.rates, motion, report.density, sigma=sigma)
    return replace(relinearised, at_reference=Rotation.from_rotvec(turned).as_matrix() @ relinearised.at_reference)
