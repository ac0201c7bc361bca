"""Tests that see every gyro sample: lattice, repeats, clipping, outliers, noise level and colour, lines.

They come before the attitude tests, since one run of clipped or repeated samples spoils those. Under M0 a reading is a smooth
motion plus white noise with σ = ARW/√Δt and is never exactly the same twice. The motion is taken out by a local parabola; only
*quiet* samples count, where the mean does not change visibly over twenty samples on either side.

Every test states its p-value under M0; the ones that need an exact coincidence of floating-point numbers (lattice, repeats,
clipping) cannot happen at all under M0 and are given the smallest p.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from diagnosis.detectors.clipping import find_clipping
from diagnosis.detectors.denoised import denoised
from diagnosis.detectors.gap_interpolation import filled, runs
from diagnosis.detectors.lattice import Kind, undo_lattice
from diagnosis.detectors.number_format import NumberFormats, find_number_formats
from diagnosis.detectors.outliers import find_outliers
from diagnosis.detectors.own_repeats import find_own_repeats
from diagnosis.detectors.repeats import Repeats, find_repeats
from diagnosis.detectors.report import (
    AXES,
    IMPOSSIBLE,
    Findings,
    Line,
    SampleReport,
    SampleTest,
    Stream,
    Symptom,
    Tell,
    consecutive,
    inside,
    silent,
    since_start,
    within,
)
from diagnosis.detectors.run_lengths import compute_p_of_runs
from diagnosis.detectors.sample_noise import local_noise, measure_noise, quiet
from diagnosis.detectors.spectral_lines import find_lines
from diagnosis.detectors.zone_passes import Zone, zone
from diagnosis.settings import DEFAULT, DiagnosisSettings
from gyrocal.recording import Recording
from simulator.effects.recorded import interval_slices
from simulator.effects.smoothing import noise_level

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FEWEST_STRETCHES = 3  # of zeros, in a dead zone
FIRST = 3.0  # steps of a number format, within which the smallest readings beside its zeros lie
HIDDEN = 0.1  # share of an interval in which a lattice hides the rate, from which on the gyro is blind there
HIDING = 2.0  # noise sigmas in a step, above which a lattice hides slow motion
CERTAIN = 3.0  # log odds of a dead zone from which on its edges are left out of the other tests
BESIDE = 10  # samples beside an edge
FAR = 8.0  # noise sigmas from its neighbours at which a value was not measured


def examine(
    recording: Recording, lattice: Kind | None = None, settings: DiagnosisSettings = DEFAULT, tell: Tell = silent
) -> SampleReport:
    """Test all samples of a recording, and repair the stream.

    Parameters
    ----------
    recording : what was recorded
    lattice : how readings on a lattice came there; by default as a sweep through zero shows, rounded if there is none
    settings : thresholds
    tell : called with what is looked for and the share done
    """
    gyro, event_p = recording.gyro, settings.sample_event
    sigma = gyro.arw / np.sqrt(gyro.sample_s)
    used, parts = inside(recording), interval_slices(recording)
    stream = Stream(gyro.rates.copy(), np.full(gyro.rates.shape, gyro.arw**2), np.zeros(gyro.t_s.size, dtype=bool))
    tell("repeated samples", 0.0)
    repeated, stream = _bridge_repeats(recording, stream, used, event_p)
    tell("number format", 0.02)
    formats = find_number_formats(gyro.rates, used, ~stream.filled, parts, sigma, lattice)
    tell("plateaus", 0.03)
    clipping, clipped = find_clipping(recording, used, formats, sigma)
    found = [repeated, formats.describe(), clipping]
    lines: tuple[Line, ...] = ()
    zones: dict[int, Zone] = {}
    factor, hidden = np.ones(3), np.zeros(3, dtype=bool)
    on_lattice = formats.steps > HIDING * sigma
    if sigma > 0:
        tell("repeats of one gyro", 0.03)
        zeros = [_zeros(gyro.rates[used, axis], sigma, float(formats.steps[axis]))[1] for axis in range(3)]
        found.append(find_own_repeats(recording, used, formats.coarse, np.array(zeros), event_p))
        tell("noise here and there", 0.045)
        local = local_noise(stream.rates, sigma, formats.coarse, formats.steps, stream.filled)
        zones = _find_zones(stream.rates, parts, sigma, formats, tell)
        # The jumps at the edges of a zone are neither noise nor motion; of readings beside zeros, some were made zeros.
        used = used & ~_near_edges(zones, used.size) & ~_near_zeros(recording, used, formats, sigma)
        still = used & quiet(stream.rates, local, within(tell, 0.2, 0.25))
        spread = np.where(formats.coarse, formats.steps, 0.0)
        outliers, stream = find_outliers(recording, stream, still, used, local, spread, event_p, within(tell, 0.25, 0.3))
        lines, tests = find_lines(stream.rates, recording, still, used, on_lattice, settings.line, within(tell, 0.3, 0.65))
        replaced = stream.filled | clipped
        noise = measure_noise(stream.rates, recording, still, used, replaced, formats, lines, event_p, within(tell, 0.65, 0.7))
        factor = noise.factor
        tell("zeros", 0.8)
        found += [outliers, tests, noise.findings, _find_zeros(recording, sigma * factor, formats)]
        stream = replace(stream, density=stream.density * noise.density)
        stream, hidden = _undo_lattices(recording, stream, formats, sigma)
    return SampleReport(
        tests=tuple(test for one in found for test in one.tests),
        symptoms=tuple(symptom for one in found for symptom in one.symptoms),
        rates=stream.rates,
        density=stream.density,
        clipped=clipped,
        filled=stream.filled,
        noise_factor=factor,
        noise=sigma * factor,
        smooth=smoothed_rates(stream.rates, recording, within(tell, 0.8, 1)),
        hidden=hidden,
        lattice=on_lattice,
        zones=zones,
        lines=lines,
        cut_odds=formats.cut_odds,
    )


def _find_zones(rates: Array, parts: Sequence[slice], sigma: float, formats: NumberFormats, tell: Tell) -> dict[int, Zone]:
    """Find the dead zones that motions pass through, of gyros on no coarse lattice."""
    found = {}
    for axis in np.flatnonzero(~formats.coarse).tolist():
        tell(f"dead zone of gyro {AXES[axis]}", 0.05 + 0.05 * axis)
        one = zone(rates[:, axis], parts, sigma)
        if one is not None:
            found[axis] = one
    return found


def _is_largest(rates: Array, used: Mask) -> Mask:
    """(n,) samples at the largest reading of a gyro, where a clipped one stands."""
    return np.asarray((np.abs(rates) >= np.abs(rates[used]).max(axis=0) * (1 - 1e-12)).any(axis=1))


def _near_edges(zones: Mapping[int, Zone], size: int) -> Mask:
    """Samples beside an edge of a zone that passes show for certain."""
    jumps = np.zeros(size, dtype=bool)
    for one in zones.values():
        if one.log_odds > CERTAIN:
            jumps[1:] |= np.diff(one.course.dead)
    return np.asarray(scipy.ndimage.binary_dilation(jumps, iterations=BESIDE)) if jumps.any() else jumps


def _near_zeros(recording: Recording, used: Mask, formats: NumberFormats, noise: float) -> Mask:
    """Samples beside exact zeros of a gyro whose noise goes through its dead zone."""
    near = np.zeros(used.size, dtype=bool)
    for axis in np.flatnonzero(~formats.coarse):
        if _zeros(recording.gyro.rates[used, axis], noise, formats.steps[axis])[1]:
            near |= recording.gyro.rates[:, axis] == 0.0
    return np.asarray(scipy.ndimage.binary_dilation(near, iterations=BESIDE)) if near.any() else near


def _zeros(x: Array, noise: float, step: float) -> tuple[Array, bool]:
    """Sizes of the readings that are not zero, in order, and whether zeros beside them leave a zone."""
    other = np.sort(np.abs(x[x != 0.0]))
    # Zeros beside readings that are as good as zero leave no zone, and a number format has zeros beside its first step.
    # A gyro that stops reads zero in one stretch, and a rate goes in and out of a zone.
    several = len(runs(x == 0.0)) >= FEWEST_STRETCHES
    return other, several and other.size > 30 and float(other[:3].mean()) > max(0.01 * noise, FIRST * step)


def smoothed_rates(rates: Array, recording: Recording, tell: Tell = silent) -> Array:
    """Raw rates (n, 3) without their noise, as far as smoothing inside the intervals takes it out."""
    sigma = recording.gyro.arw / np.sqrt(recording.gyro.sample_s)
    out = rates.copy()
    parts = interval_slices(recording)
    for number, part in enumerate(parts):
        tell("motion without noise", number / len(parts))
        out[part] = denoised(rates[part], recording.gyro.sample_s, noise_level(rates[part], sigma))
    return out


def _bridge_repeats(recording: Recording, stream: Stream, used: Mask, event_p: float) -> tuple[Findings, Stream]:
    """Find samples that repeat the one before on all axes, and bridge those that surely are faults."""
    rates = recording.gyro.rates
    found = find_repeats(rates, consecutive(recording, used) & ~_is_largest(rates, used))
    if found is None:
        return Findings(), stream
    if found.p_value < event_p:
        gyro = recording.gyro
        sigma = gyro.arw / np.sqrt(gyro.sample_s)
        rates, factor, density = filled(gyro.t_s, stream.rates, found.mask, gyro.sample_s, sigma)
        stream = Stream(rates, stream.density * factor[:, None] + density, stream.filled | found.mask)
    return _describe_repeats(recording, found, event_p), stream


def _describe_repeats(recording: Recording, found: Repeats, event_p: float) -> Findings:
    """Describe repeated samples: held over, or filled in where they are far from their neighbours."""
    test = SampleTest(
        "repeated_share", None, found.count / found.samples, found.expected / found.samples, found.p_value,
        "repeats", f"{found.count} of {found.samples} samples repeat the one before on all axes",
    )  # fmt: skip
    if found.p_value >= event_p:
        return Findings((test,))
    kind = "repeats" if _is_measured(recording.gyro.rates, found.mask) else "filled_samples"
    text = "" if kind == "repeats" else "samples repeat a value that is far from its neighbours, so that it was filled in"
    likeness = 1.0
    if not found.expected and found.mask.any():  # runs of chance have other lengths
        low, high = np.array(runs(found.mask)).T
        likeness = compute_p_of_runs(since_start(recording)[low], high - low)
    parameters: dict[str, float | str] = {"fraction": found.fraction}
    symptom = Symptom(kind, None, found.size, "samples", found.sigma, parameters, found.p_value, text, likeness=likeness)
    return Findings((test,), (symptom,))


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


def _find_zeros(recording: Recording, noise: Array, formats: NumberFormats) -> Findings:
    """Find samples that read exactly zero on no coarse lattice: a dead zone behind the noise."""
    tests, symptoms, used = [], [], inside(recording)
    for axis in np.flatnonzero(~formats.coarse):
        x = recording.gyro.rates[used, axis]
        count = int(np.sum(x == 0.0))
        other, zone = _zeros(x, float(noise[axis]), float(formats.steps[axis]))
        p, text = IMPOSSIBLE if zone else 1.0, f"{count} samples read exactly zero"
        tests.append(SampleTest("zero_samples", AXES[axis], count, 0.0, p, "dead_zone", text))
        if zone:
            smallest = float(np.rad2deg(other[:3].mean()))
            spacing = max(float(np.rad2deg(other[3:30].mean())) - smallest, 1e-3 * smallest)
            symptoms.append(Symptom("dead_zone", AXES[axis], smallest, "deg/s", spacing, {}, IMPOSSIBLE))
    return Findings(tuple(tests), tuple(symptoms))


def _undo_lattices(recording: Recording, stream: Stream, formats: NumberFormats, sigma: float) -> tuple[Stream, Mask]:
    """Undo what lattices do to slow rates, and add the noise that they make; also which gyros hide slow motion for long."""
    rates, density, hidden = stream.rates.copy(), stream.density.copy(), np.zeros(3, dtype=bool)
    for axis in np.flatnonzero(formats.coarse):
        q = float(formats.steps[axis])
        density[:, axis] += q**2 / 12 * recording.gyro.sample_s
        kind: Kind = "cut" if formats.cut[axis] else "rounded"
        for part in interval_slices(recording):
            x, factor, more = undo_lattice(rates[part, axis], recording.gyro.sample_s, q, sigma, kind)
            rates[part, axis] = x
            density[part, axis] = density[part, axis] * factor + more
            hidden[axis] |= bool(np.mean(more > 0) > HIDDEN)
    return replace(stream, rates=rates, density=density), hidden
