"""Tests of every gyro sample: lattice, repeats, outliers, noise level, lines, zeros.

They come before the attitude tests, since one run of repeated samples spoils those. Under M0 a reading is a smooth
motion plus white noise with σ = ARW/√Δt and is never exactly the same twice.

Every test states its p-value under M0; the ones that need an exact coincidence of floating-point numbers (lattice, repeats)
cannot happen at all under M0 and are given the smallest p.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.ndimage

from diagnosis.arrays import AXES
from diagnosis.detectors.noise_removal import remove_noise
from diagnosis.detectors.number_format import Lattices, find_lattices
from diagnosis.detectors.outliers import find_outliers
from diagnosis.detectors.repeats import bridge_repeats
from diagnosis.detectors.sample_noise import estimate_local_noise, find_quiet_samples, measure_noise
from diagnosis.detectors.sample_report import IMPOSSIBLE, Findings, Line, SampleReport, SampleTest, Stream, Symptom
from diagnosis.detectors.spectral_lines import find_lines
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.arrays import Array, Mask
from gyrocal.mask_runs import find_mask_runs
from gyrocal.masking import mark_interval_samples
from gyrocal.recording import Recording

# of samples that read exactly zero beside others that do not come near it
FEWEST_STRETCHES = 3  # of zeros
FIRST_STEPS = 3.0  # steps of a number format, within which the smallest readings beside its zeros lie
OF_NOISE = 0.01  # noise sigmas, within which readings are as good as zero
SMALLEST = 3  # readings that are not zero, whose mean shows how near to it others come
FEWEST_OTHERS = 30  # readings that are not zero
BESIDE_ZERO = 10  # samples beside a zero that are left out of other tests
HIDING = 2.0  # noise sigmas in a step, above which a lattice hides slow motion


def examine(recording: Recording, settings: DiagnosisSettings = DEFAULT) -> SampleReport:
    """Test all samples of a recording, and bridge those that were not measured."""
    gyro, used = recording.gyro, mark_interval_samples(recording)
    density = np.full(gyro.rates.shape, gyro.arw**2)
    stream = Stream(recording, gyro.rates.copy(), density, np.zeros(gyro.t_s.size, dtype=bool), used)
    repeated, stream = bridge_repeats(stream, settings.sample_event)
    sigma, factor = stream.sigma, np.ones(3)
    lattices = find_lattices(gyro.rates[used], sigma)
    findings, lines = [repeated, lattices.describe()], tuple[Line, ...]()
    if sigma > 0:
        stream, noisy, lines, factor = _examine_noise(stream, lattices, settings)
        findings += noisy
    stream = lattices.add_noise(stream)
    return SampleReport(
        tests=tuple(test for finding in findings for test in finding.tests),
        symptoms=tuple(symptom for finding in findings for symptom in finding.symptoms),
        rates=stream.rates,
        density=stream.density,
        filled=stream.filled,
        noise_factor=factor,
        noise=sigma * factor,
        smooth=remove_noise(stream.rates, recording),
        coarse_steps=np.where(lattices.steps > HIDING * sigma, lattices.steps, 0.0),
        cut_steps=np.where(lattices.may_bias, lattices.steps, 0.0),
        lines=lines,
    )


def _examine_noise(
    stream: Stream, lattices: Lattices, settings: DiagnosisSettings
) -> tuple[Stream, list[Findings], tuple[Line, ...], Array]:
    """Examine the noise of the samples: zeros, outliers, lines and the noise level.

    Returns the stream with outliers bridged, findings, lines, and the (3,) actual over stated noise of a sample.
    """
    sigma, coarse, event_p = stream.sigma, lattices.coarse, settings.sample_event
    zeros, near_zeros = find_zeros(stream, lattices)
    local = estimate_local_noise(stream.rates, sigma, coarse, lattices.steps, stream.filled)
    # Of readings beside zeros, some were made zeros: the jumps there are neither noise nor motion.
    stream = replace(stream, used=stream.used & ~near_zeros)
    still = stream.used & find_quiet_samples(stream.rates, local)
    steps = np.where(coarse, lattices.steps, 0.0)
    outliers, stream = find_outliers(stream, still, local, steps, event_p)
    lines, tests = find_lines(stream, still, lattices.steps > HIDING * sigma, settings.line)
    levels, factor, density_factor = measure_noise(stream, lattices, lines, event_p)
    return replace(stream, density=stream.density * density_factor), [outliers, tests, levels, zeros], lines, factor


def find_zeros(stream: Stream, lattices: Lattices) -> tuple[Findings, Mask]:
    """Find readings that are exactly zero more often than noise allows, on no coarse lattice; also samples (n,) beside them.

    Zeros beside readings that are as good as zero are no exception, and a number format has zeros beside its first step. A gyro
    that stops reads zero in one stretch.
    """
    tests, symptoms, near_zeros = [], [], np.zeros(len(stream.rates), dtype=bool)
    for axis in np.flatnonzero(~lattices.coarse):
        zero = (stream.recording.gyro.rates[:, axis] == 0.0) & stream.used
        sizes = np.sort(np.abs(stream.recording.gyro.rates[stream.used & ~zero, axis]))
        smallest = float(sizes[:SMALLEST].mean()) if sizes.size else 0.0
        is_away = smallest > max(OF_NOISE * stream.sigma, FIRST_STEPS * float(lattices.steps[axis]))
        count = int(zero.sum())
        is_symptom = is_away and sizes.size > FEWEST_OTHERS and len(find_mask_runs(zero)) >= FEWEST_STRETCHES
        p, text = IMPOSSIBLE if is_symptom else 1.0, f"{count} samples read exactly zero"
        tests.append(SampleTest("zero_samples", AXES[axis], count, 0.0, p, "zero_samples", text))
        if is_symptom:
            near_zeros |= scipy.ndimage.binary_dilation(zero, iterations=BESIDE_ZERO)
            text = f"readings are exactly zero more often than noise allows, {AXES[axis]}: {count} samples"
            symptoms.append(Symptom("zero_samples", AXES[axis], count, "samples", 0.0, {}, IMPOSSIBLE, text))
    return Findings(tuple(tests), tuple(symptoms)), near_zeros
