"""Tests that see every gyro sample: lattice, repeats, clipping, outliers, noise level and colour, lines.

They come before the attitude tests, since one run of clipped or repeated samples spoils those. Under M0 a reading is a smooth
motion plus white noise with σ = ARW/√Δt and is never exactly the same twice. The motion is taken out by a local parabola; only
*quiet* samples count, where the mean does not change visibly over twenty samples on either side.

Every test states its p-value under M0; the ones that need an exact coincidence of floating-point numbers (lattice, repeats,
clipping) cannot happen at all under M0 and are given the smallest p.
"""

from __future__ import annotations

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from diagnosis.detectors.clipping import saturation
from diagnosis.detectors.denoised import denoised
from diagnosis.detectors.gap_interpolation import filled, runs
from diagnosis.detectors.lattice import Kind, lattice_step, undone
from diagnosis.detectors.likeness import of_runs
from diagnosis.detectors.noise_patterns import patterns
from diagnosis.detectors.noise_structure import constancy, together
from diagnosis.detectors.number_format import SAME, SYMPTOMS, compute_log_posterior
from diagnosis.detectors.outliers import spikes
from diagnosis.detectors.own_repeats import own_repeats
from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    SampleReport,
    SampleTest,
    Symptom,
    Tell,
    consecutive,
    inside,
    silent,
    since_start,
    within,
)
from diagnosis.detectors.sample_noise import local_noise, noise, quiet
from diagnosis.detectors.spectral_lines import lines
from diagnosis.detectors.stale_samples import stale_samples
from diagnosis.detectors.zone_passes import zone
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices
from simulator.effects.smoothing import noise_level

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

COARSE = 0.2  # a lattice finer than this share of the noise is a number format: its rounding has 0.3 % of the power
WORTH = 3.0  # sigmas of the angle random walk over all samples, that half steps must turn by for a finer lattice to matter
DECIDED = 8.0  # log odds of one number format from which on the references are not asked, and a finer lattice matters
OPEN = 0.05  # probability of another number format, from which on it is told
FIRST = 3.0  # steps of a number format, within which the smallest readings beside its zeros lie
HIDING = 2.0  # noise sigmas in a step, above which a lattice hides slow motion
CERTAIN = 3.0  # log odds of a dead zone from which on its edges are left out of the other tests
BESIDE = 10  # samples beside an edge
ALONE = 1e-3  # share of the samples that repeat on one axis and not on all, from which on chance may repeat all
FAR = 8.0  # noise sigmas from its neighbours at which a value was not measured


def examine(
    recording: Recording, lattice: Kind | None = None, settings: DiagnosisSettings = DEFAULT, tell: Tell = silent
) -> SampleReport:
    """All stream tests of a recording, and its repaired stream.

    Parameters
    ----------
    recording : what was recorded
    lattice : how readings on a lattice came there; by default as a sweep through zero shows, rounded if there is none
    settings : thresholds
    tell : called with what is looked for and the share done
    """
    gyro = recording.gyro
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    none = np.zeros(gyro.t_s.size, dtype=bool)
    report = SampleReport([], [], gyro.rates.copy(), np.full(gyro.rates.shape, gyro.arw**2), none, none.copy())
    report.event_p, report.line_p = settings.sample_event, settings.line
    used = inside(recording)
    steps = np.zeros(3)
    for axis in range(3):
        tell(f"lattice of gyro {AXES[axis]}", 0.005 * axis)
        steps[axis] = lattice_step(gyro.rates[used, axis])
    tell("repeated samples", 0.015)
    coarse = steps > COARSE * sigma
    _stale(report, recording, used, coarse)
    tell("number format", 0.02)
    # A finer one is of no consequence if readings were rounded; cut ones are all half a step too near to zero.
    worth = ~coarse & (sigma > 0) & (0.5 * steps * np.sqrt(used.sum()) > WORTH * sigma)
    parts = interval_slices(recording)
    posterior = compute_log_posterior(gyro.rates, parts, ~report.filled, np.where(coarse | worth, steps, 0.0), sigma)
    odds = posterior[:, 1] - posterior[:, 0]
    coarse = coarse | (worth & (odds > DECIDED))
    # Of readings that keep their sign, those cut toward zero are rounded ones but for a constant.
    both_signs = bool((coarse & (gyro.rates[used].min(axis=0) < 0) & (gyro.rates[used].max(axis=0) > 0)).any())
    cut = coarse & both_signs & (odds > 0 if lattice is None else lattice == "cut")
    strongest, mixed = float(odds[np.argmax(np.abs(odds))]), bool(cut.any() and (coarse & ~cut).any())
    if both_signs and lattice is None and not mixed and abs(strongest) < DECIDED:
        report.cut_odds = strongest
    report.lattice = steps > HIDING * sigma
    _quantization(report, steps, coarse, cut, posterior)
    tell("plateaus", 0.025)
    may_be_cut = coarse & (posterior[:, 1] > np.log(OPEN)) if lattice is None else cut
    may_be_rounded = coarse & (posterior[:, 0] > np.log(OPEN)) if lattice is None else coarse & ~cut
    saturation(report, recording, used, coarse, (may_be_rounded, may_be_cut), steps, sigma)
    if sigma > 0:
        tell("repeats of one gyro", 0.03)
        own_repeats(report, recording, used, coarse)
        tell("noise here and there", 0.045)
        local = local_noise(report.rates, sigma, coarse, steps, report.filled)
        found = {}
        for axis in np.flatnonzero(~coarse).tolist():
            tell(f"dead zone of gyro {AXES[axis]}", 0.05 + 0.05 * axis)
            found[axis] = zone(report.rates[:, axis], parts, sigma)
        report.zones = {axis: one for axis, one in found.items() if one is not None}
        # The jumps at the edges of a zone are neither noise nor motion; of readings beside zeros, some were made zeros.
        used = used & ~_near_edges(report) & ~_near_zeros(recording, used, coarse, steps, sigma)
        still = used & quiet(report.rates, local, within(tell, 0.2, 0.25))
        spread = np.where(coarse, steps, 0.0)
        spikes(report, recording, still, used, local, spread, within(tell, 0.25, 0.3))
        report.lines = lines(report, recording, still, used, within(tell, 0.3, 0.65))
        noise(
            report,
            recording,
            still,
            used,
            sigma,
            steps,
            coarse,
            may_be_cut,
            within(tell, 0.65, 0.7),
        )
        report.noise = sigma * report.noise_factor
        if not coarse.any():
            tell("noise in common", 0.7)
            together(report, recording, still)
            constancy(report, recording, used, within(tell, 0.75, 0.77))
            patterns(report, recording, used, steps, within(tell, 0.77, 0.8))
        tell("zeros", 0.8)
        _zero_mass(report, recording, inside(recording), coarse, steps)
        _off_the_lattice(report, recording, steps, coarse, cut, sigma)
    report.smooth = smoothed_rates(report.rates, recording, within(tell, 0.8, 1))
    return report


def _near_edges(report: SampleReport) -> Mask:
    """Samples beside an edge of a zone that passes show for certain."""
    jumps = np.zeros(report.clipped.size, dtype=bool)
    for one in report.zones.values():
        if one.log_odds > CERTAIN:
            jumps[1:] |= np.diff(one.course.dead)
    return np.asarray(scipy.ndimage.binary_dilation(jumps, iterations=BESIDE)) if jumps.any() else jumps


def _near_zeros(recording: Recording, used: Mask, coarse: Mask, steps: Array, noise: float) -> Mask:
    """Samples beside exact zeros of a gyro whose noise goes through its dead zone."""
    near = np.zeros(used.size, dtype=bool)
    for axis in np.flatnonzero(~coarse):
        if _zeros(recording.gyro.rates[used, axis], noise, steps[axis])[1]:
            near |= recording.gyro.rates[:, axis] == 0.0
    return np.asarray(scipy.ndimage.binary_dilation(near, iterations=BESIDE)) if near.any() else near


def _zeros(x: Array, noise: float, step: float) -> tuple[Array, bool]:
    """Sizes of the readings that are not zero, in order, and whether zeros beside them leave a zone."""
    other = np.sort(np.abs(x[x != 0.0]))
    # Zeros beside readings that are as good as zero leave no zone, and a number format has zeros beside its first step.
    return other, x.size - other.size >= 3 and other.size > 30 and float(other[:3].mean()) > max(0.01 * noise, FIRST * step)


def smoothed_rates(rates: Array, recording: Recording, tell: Tell = silent) -> Array:
    """Raw rates (n, 3) without their noise, as far as smoothing inside the intervals takes it out."""
    sigma = recording.gyro.arw / np.sqrt(recording.gyro.sample_s)
    out = rates.copy()
    parts = interval_slices(recording)
    for number, part in enumerate(parts):
        tell("motion without noise", number / len(parts))
        out[part] = denoised(rates[part], recording.gyro.sample_s, noise_level(rates[part], sigma))
    return out


def _quantization(report: SampleReport, steps: Array, coarse: Mask, cut: Mask, posterior: Array) -> None:
    for axis in range(3):
        found = bool(coarse[axis])
        symptom = "lattice_cut" if found and cut[axis] else "lattice_rounded"
        p = IMPOSSIBLE if found else 1.0
        text = (
            f"all readings are multiples of {np.rad2deg(steps[axis]):.4g} deg/s"
            if found
            else "readings lie on no lattice that matters beside the noise"
        )
        report.tests.append(SampleTest("lattice_step", AXES[axis], float(np.rad2deg(steps[axis])), 0.0, p, symptom, text))
    if not coarse.any():
        return
    for kind, axes in (("lattice_rounded", coarse & ~cut), ("lattice_cut", coarse & cut)):
        if not axes.any():
            continue
        found_steps = steps[axes]
        common = bool(axes.all()) and np.ptp(found_steps) < SAME * found_steps.mean()
        groups = [(None, float(found_steps.mean()))] if common else [(AXES[k], float(steps[k])) for k in np.flatnonzero(axes)]
        for axis_name, step in groups:
            size = float(np.rad2deg(step))
            how = "cut toward zero" if kind == "lattice_cut" else "rounded"
            text = f"all readings are multiples of {size:.4g} deg/s, {how}"
            shares = np.exp(posterior[np.flatnonzero(axes)[0] if axis_name is None else AXES.index(axis_name)])
            others = zip(SYMPTOMS, shares.tolist(), strict=True)
            rivals = tuple((other, share) for other, share in others if other != kind and share > OPEN)
            report.symptoms.append(Symptom(kind, axis_name, size, "deg/s", 1e-6 * size, {}, IMPOSSIBLE, text, rivals=rivals))


def _stale(report: SampleReport, recording: Recording, used: Mask, coarse: Mask) -> None:
    """Samples that repeat the one before on all axes at once, beyond what a coarse lattice makes."""
    rates = recording.gyro.rates
    equal = np.zeros(rates.shape, dtype=bool)
    equal[1:] = rates[1:] == rates[:-1]
    clipped = (np.abs(rates) >= np.abs(rates[used]).max(axis=0) * (1 - 1e-12)).any(axis=1)
    follows = consecutive(recording, used) & ~clipped
    # Floats with few digits repeat as those of a lattice do, axis by axis.
    alone = (equal & ~equal.all(axis=1, keepdims=True))[follows].mean(axis=0) > ALONE if follows.any() else coarse
    found = stale_samples(rates, equal, follows, coarse | alone, report.event_p)
    if found is None:
        return
    report.tests.append(
        SampleTest(
            "repeated_share", None, found.count / found.samples, found.expected / found.samples, found.p_value,
            "repeats", f"{found.count} of {found.samples} samples repeat the one before on all axes",
        )
    )  # fmt: skip
    if found.p_value >= report.event_p:
        return
    parameters: dict[str, float | str] = {"fraction": found.fraction}
    kind = "repeats" if _is_measured(rates, found.mask) else "filled_samples"
    text = "" if kind == "repeats" else "samples repeat a value that is far from its neighbours, so that it was filled in"
    alike = _run_likeness(found.mask, recording) if not coarse.any() else 1.0
    report.symptoms.append(
        Symptom(kind, None, found.size, "samples", found.sigma, parameters, found.p_value, text, likeness=alike)
    )
    _fill(report, recording, found.mask)


def _run_likeness(repeated: Mask, recording: Recording) -> float:
    """Of the runs of repeats, counted from their interval's start; those of a lattice may be chance and are not judged."""
    low, high = np.array(runs(repeated)).T
    return of_runs(since_start(recording)[low], high - low)


def _is_measured(rates: Array, repeated: Mask) -> bool:
    """Whether the values that are repeated lie among their neighbours, as samples held over do and filler does not."""
    edges = [(low, high) for low, high in runs(repeated) if low >= 3 and high + 1 < len(rates)]
    if not edges:
        return True
    low, high = np.array(edges).T
    source, before, after = rates[low - 1], rates[low - 2], rates[high]
    share = 1.0 / (high - low + 2)[:, None]
    departure = np.abs(source - ((1 - share) * before + share * after))
    noise = np.median(np.abs(np.diff(rates, 2, axis=0)), axis=0) / 0.6745 / np.sqrt(6)
    change = np.abs(after - before)
    return bool(np.median((departure / np.maximum(FAR * noise, change)).max(axis=1)) < 1)


def _fill(report: SampleReport, recording: Recording, bad: Mask) -> None:
    """Bridge bad samples; what they integrate to is then uncertain."""
    gyro = recording.gyro
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    report.rates, factor, density = filled(gyro.t_s, report.rates, bad, gyro.sample_s, sigma)
    report.density = report.density * factor[:, None] + density
    report.filled |= bad


def _zero_mass(report: SampleReport, recording: Recording, used: Mask, coarse: Mask, steps: Array) -> None:
    """Samples that read exactly zero on no lattice: a dead zone behind the noise."""
    for axis in np.flatnonzero(~coarse):
        x = recording.gyro.rates[used, axis]
        count = int(np.sum(x == 0.0))
        other, zone = _zeros(x, float(report.noise[axis]), float(steps[axis]))
        p = IMPOSSIBLE if zone else 1.0
        report.tests.append(
            SampleTest("zero_samples", AXES[axis], count, 0.0, p, "dead_zone", f"{count} samples read exactly zero")
        )
        if p < report.event_p:
            smallest = float(np.rad2deg(other[:3].mean()))
            spacing = float(np.rad2deg(other[3:30].mean())) - smallest
            report.symptoms.append(
                Symptom("dead_zone", AXES[axis], smallest, "deg/s", max(spacing, 1e-3 * smallest), {}, IMPOSSIBLE)
            )


def _off_the_lattice(report: SampleReport, recording: Recording, steps: Array, coarse: Mask, cut: Mask, sigma: float) -> None:
    """Undo what the lattice does to slow rates, and account for the noise it makes."""
    t = recording.gyro.t_s
    for axis in np.flatnonzero(coarse):
        q = float(steps[axis])
        report.density[:, axis] += q**2 / 12 * recording.gyro.sample_s
        kind: Kind = "cut" if cut[axis] else "rounded"
        for interval in recording.intervals:
            low, high = np.searchsorted(t, [interval.start_s - 1e-6, interval.stop_s - 1e-6])
            x, factor, hidden = undone(report.rates[low:high, axis], recording.gyro.sample_s, q, sigma, kind)
            report.rates[low:high, axis] = x
            report.density[low:high, axis] = report.density[low:high, axis] * factor + hidden
            report.hidden[axis] |= bool(np.mean(hidden > 0) > 0.1)
