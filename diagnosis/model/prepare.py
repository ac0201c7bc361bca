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

Columns of effects that follow the rate, such as its cube, are formed of the samples, whose noise is that of the attitude
which is propagated with them. A column that holds this noise explains it, and a clean gyro seems to have an effect, as
coefficients of noisy regressors are biased (Fuller, Measurement Error Models, Wiley 1987, section 1.1).

The noise itself is seen in the residuals z, with covariance V, of which it is a part: the best estimate of the noise n(t) of
the calibrated rates is E[n(t) | z] = E[n(t) zᵀ] V⁻¹ z. In inertial axes an observation at t_k holds −∫n dt up to t_k, so that

    E[n(t) | z] = −P(t) Σ_{t_k > t} u_k,    u = V⁻¹ (z − C θ),

with P the density of the noise and C θ what the nuisance parameters explain by least squares. Rates less this estimate are the
best linear unbiased estimate of the motion, whose error goes with no residual (Rao, Linear Statistical Inference and Its
Applications, Wiley 1973, section 5a.2). Smoothing them afterwards leaves that as it is.

All this holds where the residuals are of noise. With an error of a hundred sigmas in them the estimate would be a hundred times
the noise, and the rates without it would be no motion. Where χ² is larger than its degrees of freedom, u √(dof/χ²) stands for
u, which leaves the estimate as large as noise would make it.
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
    recording: Recording, settings: DiagnosisSettings = DEFAULT, tell: Progress = lambda text, share: None
) -> PreparedRecording:
    """Examine the samples, calibrate under M0 by Gauss–Newton on the linear model, and linearise there.

    An `InputError` if the stream does not cover the intervals, or nothing is left of them. Progress is told as a text and the
    share done of a whole diagnosis.
    """
    if mark_interval_samples(recording).sum() < 2 * len(recording.intervals):
        prepare_measurements(recording)  # says which interval lacks samples
    if not mark_interval_samples(recording).any():
        raise InputError("no gyro sample starts inside any interval")
    tell("gyro samples", 0.01)
    report = examine(recording, settings)
    tell("first calibration", 0.06)
    found = classify_noise(recording, report, settings)
    return replace(found, notes=tuple(_write_notes(found)), unobserved=report_unobserved(found.model)[0])


def _write_notes(found: PreparedRecording) -> Iterator[str]:
    """Sentences with noise that the diagnosis estimated where the recording states none, and with what cannot be seen."""
    recording, noise = found.model.recording, found.reference_noise
    if recording.gyro.arw_estimated:
        levels = ", ".join(f"{level:.3g}" for level in recording.gyro.arw_deg_per_sqrt_s * found.samples.noise_factor)
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
    yield from describe_unobserved(found.model)
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
        return self.reference_noise is not None and self.reference_noise.odd

    @property
    def is_white(self) -> bool:
        """Whether the readings have white noise; those on a lattice coarser than it have errors that are not."""
        return not self.samples.coarse_steps.any()


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
    if report.coarse_steps.any():  # what these do to a reading is no noise of a known density
        model = add_rounding(model, report.coarse_steps)
    else:
        model = add_expected_motion(model, report, stated * factors)
    # Lines that are faster than the scan of periods would pass for slow ones.
    grid = make_grid(model)
    fast = [] if grid is None else [line for line in report.lines if line.frequency_hz > grid.tried.max()]
    errors = np.concatenate([_build_line_errors(model, fast), _build_cut_errors(model, report.cut_steps)], axis=2)
    return PreparedRecording(replace(model, nuisance_errors=errors if errors.size else None), report, sigma, noise, ())


def _build_line_errors(model: RecordingModel, lines: Sequence[Line]) -> Array:
    """(n, 3, k) readings that are too high by each of some lines, rad/s."""
    out = np.zeros((model.t_s.size, 3, len(lines)))
    sample = np.searchsorted(model.recording.gyro.t_s, model.t_s, side="right") - 1
    for place, line in enumerate(lines):
        out[:, line.axis, place] = line.waveform[sample]
    return out


def _build_cut_errors(model: RecordingModel, steps: Array) -> Array:
    """(n, 3, k) readings that are too high by what cutting them toward zero to steps (3,) does, rad/s; none for zero steps."""
    axes, gyro = np.flatnonzero(steps), model.recording.gyro
    out = np.zeros((model.t_s.size, 3, axes.size))
    for place, axis in enumerate(axes):
        out[:, axis, place] = compute_cut_error(model.raw[:, axis], steps[axis], gyro.arw / float(np.sqrt(gyro.sample_s)))
    return out


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
    blind = set(np.flatnonzero(report.coarse_steps).tolist())
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


def estimate_gyro_noise(model: RecordingModel, density: Array | None) -> tuple[Array, Array]:
    """Estimate the gyro's noise from the residuals, of a density (samples, 3), rad²/s, that may differ from the stated one.

    Returns the expected error (samples, 3) of the raw rates, rad/s, zero where nothing is propagated, and rotation vectors
    (m, 3) from the propagated attitudes to the expected ones at the references, inertial axes, rad.
    """
    gyro, inverse = model.recording.gyro, np.linalg.inv(model.G)
    noise, turned = np.zeros(gyro.rates.shape), np.zeros((model.reference_rows.size, 3))
    excess = float(model.y @ model.y) / max(model.degrees_of_freedom, 1)
    weighed = model.weighed_residuals / np.sqrt(max(excess, 1.0))
    for block, references in zip(model.blocks, model.reference_slices, strict=True):
        t_s, to_inertial = model.t_s[block.steps], model.to_inertial[block.steps]
        edges = np.append(t_s - 0.5 * model.dt[block.steps], t_s[-1] + 0.5 * model.dt[block.steps][-1])
        done = block.ends[block.groups + block.counts // 2]
        # After a step come the observations that end behind it.
        after = np.zeros((t_s.size + 1, 3))
        np.add.at(after, done, weighed[block.rows].reshape(-1, 3))
        after = np.cumsum(after[::-1], axis=0)[::-1][1:]
        middle = gyro.t_s + 0.5 * gyro.sample_s
        own = np.flatnonzero((middle > edges[0]) & (middle < edges[-1]))
        step = np.searchsorted(edges, middle[own], side="right") - 1
        u = np.einsum("nij,ni->nj", to_inertial[step], after[step])  # in body axes
        power = (u @ model.G) * density[own] if density is not None else gyro.arw**2 * (u @ inverse.T)
        noise[own] = -power
        # The same of each step, by the mean over its samples, turns the attitude.
        count = np.bincount(step, minlength=t_s.size)
        mean = np.column_stack([np.bincount(step, noise[own, k], t_s.size) for k in range(3)]) / np.maximum(count, 1)[:, None]
        moved = -np.einsum("nij,nj->ni", to_inertial, mean @ model.G.T) * model.dt[block.steps, None]
        total = np.vstack([np.zeros(3), np.cumsum(moved, axis=0)])
        turned[references] = total[block.ends]
    return noise, turned


def add_expected_motion(model: RecordingModel, report: SampleReport, sigma: Array) -> RecordingModel:
    """The model with columns of the motion that gyro and references show together; sigma (references, 3) rad."""
    noise, turned = estimate_gyro_noise(model, report.density)
    shown = remove_noise(report.rates - noise, model.recording)
    again = linearise_recording(model.recording, model.G, model.bias, report.rates, shown, report.density, sigma=sigma)
    return replace(again, at_reference=Rotation.from_rotvec(turned).as_matrix() @ again.at_reference)
