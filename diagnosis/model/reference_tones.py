"""Sinusoids that all references show and their averages do not.

Candidates are seen in averages of neighbouring references, in which a sinusoid of a few references' period is lost, and the
gyro's own samples may hide it in the motion. So the innovations of all references (`diagnosis.model.misfit`) are searched.

An interval counts up to half the rate of its own references: beyond that it shows its slow errors once more. References that
are h apart cannot tell a frequency f from |j/h ± f|: a reading may be wrong at any of these, up to half the gyro's sampling
rate. The phases between the intervals and the samples tell which. Frequencies of a vibration are even up to half the sampling
rate beforehand, periods of a bias or of the references in their logarithm.

What follows the motion varies as the body does: a sinusoid must keep its χ² beside what the products of the rates, their sizes
and their changes explain. Its alternatives are one about no single axis, and one whose amplitude changes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.special import logsumexp

from diagnosis.inference.evidence import average_evidence, log_bayes
from diagnosis.model.linear import VISIBLE, build_scales
from diagnosis.model.lines import LINE_PRIOR
from diagnosis.model.misfit import build_basis, compute_innovations, whiten_errors
from diagnosis.model.recording_model import RecordingModel, build_parameter_errors
from diagnosis.model.sinusoid_causes import (
    BIAS,
    PICKUP,
    REFERENCE,
    UNLISTED,
    ReferenceTone,
    SinusoidCause,
    get_effect,
)
from diagnosis.sinusoids.coherence import compute_products, find_tops
from diagnosis.sinusoids.fit import Piece, fit_sinusoid, make_waves
from diagnosis.sinusoids.spectrum import compute_log_p, compute_piece_spectrum
from gyrocal.recording import Recording
from simulator.effects.recording_view import find_interval_slices
from simulator.effects.timing import compute_delay_columns

Array = NDArray[np.float64]

AXIS_INDICES = range(3)
NEIGHBOUR_OFFSETS = np.arange(3, 15)  # coefficients of the samples to either side, in units of the frequency resolution

SHORTEST = 16  # innovations of an interval from which its spectrum counts
FEWEST_PERIODS = 2.0  # in the longest interval
SLOW = 2.5  # spacings of the averages, above which period these show a sinusoid themselves
LEVEL_FREQUENCIES = 81  # over which the level of the noise is taken
OWN_CHI2 = 0.5  # share of its χ² that a sinusoid keeps beside what follows the motion
REGULAR = 1e-3  # relative scatter of the references' spacing below which frequencies have aliases
SEGMENTS = 4  # parts of the recording in which an alternative's amplitude differs
PHASE_STEP = 0.1  # cycles over the whole recording, between frequencies that its intervals are to tell apart
# bounds of the time
MOST_MOVES = 4000
MOST_ALIASES = 60
TOPS = 6


@dataclass(frozen=True)
class ReferenceInnovations:
    """Innovations of all references."""

    model: RecordingModel  # of the recording
    y: Array  # (N,) without what G and b take up
    taken: Array  # taken, motion: (N, q) orthonormal bases of that, and of it and what follows the motion
    motion: Array

    def make_columns(self, frequencies: Array, on_references: bool, axes: Sequence[int], parts: Array | None = None) -> Array:
        """Make (N, 2 f a p) innovations of sine and cosine at each frequency about each axis, in each of some parts (m, p)."""
        model = self.model
        t_s, duration = (model.references.t_s, 0.0) if on_references else (model.t_s, model.dt)
        own = make_waves(frequencies, t_s, duration)
        if parts is not None:
            own = (own[:, :, None] * parts[:, None, :]).reshape(len(own), -1)
        made = np.zeros((len(own), 3, own.shape[1] // 2, len(axes), 2))
        for place, axis in enumerate(axes):
            made[:, axis, :, place] = own.reshape(len(own), -1, 2)
        made = made.reshape(len(own), 3, -1)
        errors = -np.matmul(model.at_reference, made) if on_references else model.compute_attitude_turns(made)
        return whiten_errors(model, errors)[0]

    def compute_chi2(self, columns: Array, beside: Array) -> float:
        """Return the χ² that columns explain beside a basis."""
        U = build_basis(columns - beside @ (beside.T @ columns))
        return float(np.sum((U.T @ self.y) ** 2))

    def compute_evidence(self, columns: Array, level: float, limits: tuple[float, ...] = (0.0, np.inf)) -> float:
        """Return the log evidence of columns with amplitudes of any size that is plausible and could be seen."""
        own = (columns - self.taken @ (self.taken.T @ columns)) / np.sqrt(level)
        largest = np.linalg.norm(own, axis=0).max()
        scales = build_scales(max(VISIBLE[0] / largest, limits[0]), min(VISIBLE[1] / largest, limits[1]))
        if not scales.size:
            return -np.inf
        return average_evidence(log_bayes((own.T @ own)[None], (own.T @ self.y)[None] / np.sqrt(level), scales), np.zeros(1))


def find_reference_tone(model: RecordingModel, rates: Array, p_least: float, unlisted: float) -> ReferenceTone | None:
    """Find the strongest sinusoid of all references that is too fast for their averages; None without one.

    Parameters
    ----------
    model : of the recording, about its calibration under M0
    rates : (samples, 3) repaired raw rates, rad/s
    p_least : p-value below which a sinusoid is one
    unlisted : prior probability that it is on no list
    """
    peak = find_peak(model)
    if peak is None or peak[1] >= p_least:
        return None
    centre, p_value, reach = peak
    series = make_innovations(model)
    columns = series.make_columns(np.array([centre]), True, AXIS_INDICES)
    axis = int(np.argmax([series.compute_chi2(columns[:, 2 * k : 2 * k + 2], series.taken) for k in AXIS_INDICES]))
    (frequency,) = find_coherent(series, np.array([centre]), axis, reach)
    columns = series.make_columns(np.array([frequency]), True, [axis])
    chi2 = series.compute_chi2(columns, series.taken)
    if series.compute_chi2(columns, series.motion) < OWN_CHI2 * chi2:
        return None
    level = float((series.y @ series.y - chi2) / max(series.y.size - series.taken.shape[1] - 2, 1))
    aliases = find_coherent(series, list_aliases(model, centre), axis, reach)
    causes = [
        *_list_causes(series, float(frequency), aliases, axis, level, rates),
        *_list_alternatives(series, float(frequency), axis, level),
    ]
    shares = {kind: unlisted if kind == UNLISTED else (1 - unlisted) / 3 for kind in (REFERENCE, BIAS, PICKUP, UNLISTED)}
    log = np.array([cause.log_weight + np.log(shares[cause.kind]) for cause in causes])
    probability = np.exp(log - logsumexp(log))
    merged: dict[tuple[str, int], tuple[SinusoidCause, float]] = {}
    for k in np.argsort(-probability):
        first, share = merged.get((causes[k].kind, causes[k].axis), (causes[k], 0.0))
        merged[causes[k].kind, causes[k].axis] = (first, share + float(probability[k]))
    return ReferenceTone(tuple(sorted(merged.values(), key=lambda one: -one[1])), p_value)


def find_peak(model: RecordingModel) -> tuple[float, float, float] | None:
    """Return frequency, p-value and the step between frequencies, Hz; None where the averages show all there is."""
    e, later, _ = compute_innovations(model)
    interval, t_s = model.interval_of_reference[later], model.references.t_s[later]
    parts = [own for own in (np.flatnonzero(interval == k) for k in np.unique(interval)) if own.size >= SHORTEST]
    if not parts:
        return None
    spacing = float(np.median(np.concatenate([np.diff(t_s[own]) for own in parts])))
    step = 0.5 / max(float(np.ptp(t_s[own])) for own in parts)
    frequencies = np.arange(2 * FEWEST_PERIODS * step, 0.5 / spacing - step, step)
    averages = spacing * float(np.median(np.concatenate([block.counts for block in model.blocks])))
    fast = frequencies > 1 / (SLOW * averages)
    if not fast.any():
        return None
    highest = [0.5 / float(np.median(np.diff(t_s[own]))) + 0.5 * step for own in parts]
    spectrum = compute_piece_spectrum([(t_s[own], e[own]) for own in parts], frequencies, highest)
    mean = np.sum(spectrum.power * spectrum.count, axis=0) / spectrum.count.sum()
    level = np.maximum(spectrum.compute_level(LEVEL_FREQUENCIES), mean)  # around it, where noise is not white
    log_p = compute_log_p(spectrum.power / level, np.maximum(spectrum.count, 1), spectrum.power.size)
    log_p[~fast | (spectrum.count[:, 0] == 0)] = 0.0
    place, axis = np.unravel_index(int(np.argmin(log_p)), log_p.shape)
    pieces = [Piece(t_s[own], e[own, axis] - e[own, axis].mean(), lambda waves: waves - waves.mean(axis=0)) for own in parts]
    fit = fit_sinusoid(pieces, float(frequencies[place]), step)
    return fit.frequency_hz, max(float(np.exp(log_p[place, axis])), 1e-300), step


def make_innovations(model: RecordingModel) -> ReferenceInnovations:
    """Make the innovations of a recording, and the bases of what they do not tell."""
    rows = [
        model.residuals[:, :, None],
        model.compute_attitude_turns(build_parameter_errors(model.raw)),
        model.compute_attitude_turns(_follow_motion(model)),
    ]
    white, _ = whiten_errors(model, np.concatenate(rows, axis=2))
    taken = build_basis(white[:, 1:13])
    return ReferenceInnovations(model, white[:, 0] - taken @ (taken.T @ white[:, 0]), taken, build_basis(white[:, 1:]))


def find_coherent(series: ReferenceInnovations, frequencies: Array, axis: int, reach: float) -> Array:
    """Move each frequency, by at most a reach, to where one phase over all intervals explains most, Hz.

    A wave of the readings has the same phases as one of the references, but for a quarter of a turn.
    """
    model = series.model
    t_s = model.references.t_s
    later = np.diff(model.interval_of_reference, prepend=-1) == 0
    owner = np.repeat(model.interval_of_reference[later], 3)
    middle = np.array([t_s[model.interval_of_reference == k].mean() for k in np.unique(owner)])
    columns = series.make_columns(frequencies, True, [axis])
    columns = columns - series.taken @ (series.taken.T @ columns)
    width = max(PHASE_STEP / float(np.ptp(t_s)), 2 * reach / MOST_MOVES)
    near = frequencies[:, None] + width * np.arange(-np.floor(reach / width), np.floor(reach / width) + 1)
    scores = compute_products(frequencies, columns, series.y, owner, middle).compute_log_evidence(near)
    moved = []
    for tried, score in zip(near, scores, strict=True):
        tops = tried[find_tops(score, TOPS)] if middle.size > 1 else tried  # one interval has one phase at any frequency
        exact = series.make_columns(tops, True, [axis])
        chi2 = [series.compute_chi2(exact[:, 2 * k : 2 * k + 2], series.taken) for k in range(tops.size)]
        moved.append(float(tops[int(np.argmax(chi2))]))
    return np.array(moved)


def list_aliases(model: RecordingModel, frequency: float) -> Array:
    """Return frequencies of a reading that the references cannot tell from one, up to half the sampling rate, Hz."""
    apart = np.concatenate([np.diff(block.elapsed_s) for block in model.blocks])
    spacing, half_rate = float(np.median(apart)), 0.5 / model.recording.gyro.sample_s
    irregular = np.abs(apart - spacing) > REGULAR * spacing
    if irregular.mean() > 0.1:
        return np.array([frequency])
    multiples = np.arange(1, int(half_rate * spacing) + 2) / spacing
    found = np.sort(np.concatenate([[frequency], multiples - frequency, multiples + frequency]))
    return np.asarray(found[(found > 0) & (found < half_rate)][:MOST_ALIASES])


# ---- causes ---------------------------------------------------------------------------------------------------------------


def _list_causes(
    series: ReferenceInnovations, frequency: float, aliases: Array, axis: int, level: float, rates: Array
) -> Iterator[SinusoidCause]:
    """The references or a bias about each axis, and a vibration at one of the aliases."""
    recording = series.model.recording
    sample_s = recording.gyro.sample_s
    even_in_log, even = -float(np.log(LINE_PRIOR.bias_range * frequency)), float(np.log(2 * sample_s))
    tried = [(kind, one, np.array([frequency]), even_in_log) for kind in (REFERENCE, BIAS) for one in AXIS_INDICES]
    for kind, one, at, log_prior in [*tried, (PICKUP, axis, aliases, even)]:
        columns = series.make_columns(at, kind == REFERENCE, [one])
        if kind == PICKUP:  # which is not averaged over a sample
            columns = columns / np.repeat(np.sinc(at * sample_s), 2)
        unit = np.deg2rad(1 / 3600 if kind == BIAS else 1.0)
        limits = tuple(unit * limit for limit in get_effect(kind).prior)
        for k, f in enumerate(at):
            own = columns[:, 2 * k : 2 * k + 2]
            evidence = series.compute_evidence(own, level, limits)
            if not np.isfinite(evidence):
                continue
            own = own - series.taken @ (series.taken.T @ own)
            amplitudes = np.asarray(np.linalg.lstsq(own, series.y, rcond=None)[0], dtype=float)
            sigma = float(np.sqrt(level * np.trace(np.linalg.inv(own.T @ own)) / 2))
            chi2 = float(np.sum((own @ amplitudes) ** 2)) / level
            cause = SinusoidCause(kind, one, float(f), amplitudes, sigma)
            of_samples = 0.0 if kind == REFERENCE else compute_sample_log_ratio(recording, rates, cause, chi2)
            yield SinusoidCause(kind, one, float(f), amplitudes, sigma, evidence + log_prior + of_samples)


def _list_alternatives(series: ReferenceInnovations, frequency: float, axis: int, level: float) -> Iterator[SinusoidCause]:
    """A sinusoid about no single axis, and one whose amplitude changes between parts of the recording."""
    model, at = series.model, np.array([frequency])
    number = model.interval_of_reference if len(model.blocks) > 1 else model.references.t_s
    cuts = np.unique(np.quantile(number, np.linspace(0, 1, SEGMENTS + 1)[1:-1]))
    part = np.searchsorted(cuts, number, side="right")
    parts = np.asarray(part[:, None] == np.unique(part), dtype=float)
    prior = -float(np.log(2 * LINE_PRIOR.bias_range * frequency))
    for columns in (series.make_columns(at, True, AXIS_INDICES), series.make_columns(at, True, [axis], parts)):
        yield SinusoidCause(UNLISTED, axis, frequency, np.zeros(2), 0.0, series.compute_evidence(columns, level) + prior)


def compute_sample_log_ratio(recording: Recording, rates: Array, cause: SinusoidCause, chi2: float) -> float:
    """Return the log likelihood of the samples with a sinusoid in the readings, over that without it.

    With S the samples' Fourier coefficient under a window, a that of the sinusoid, and P the mean power of n of them around,

        log LR = (n + 1) [log(1 + |S|²/(n P)) − log(1 + |S − a|²/(n v))] − log(v/P),    v = P + 2 |a|²/χ²:

    P has the scatter of n coefficients, and a that of the χ² that the references give it. A body that moves at that frequency
    has a large S of any phase, which favours neither.
    """
    total, sample_s = 0.0, recording.gyro.sample_s
    wave, n = cause.compute_in_samples(recording), 2 * NEIGHBOUR_OFFSETS.size
    for part in find_interval_slices(recording):
        count = part.stop - part.start
        edge = NEIGHBOUR_OFFSETS[-1] / (count * sample_s)
        if not edge < cause.frequency_hz < 0.5 / sample_s - edge:
            continue
        turned = np.exp(-2j * np.pi * cause.frequency_hz * sample_s * np.arange(count)) * np.hanning(count)
        x = rates[part, cause.axis]
        spectrum, a = scipy.fft.fft(turned * (x - x.mean())), np.sum(turned * wave[part])
        S, P = spectrum[0], float(np.mean(np.abs(spectrum[np.concatenate([NEIGHBOUR_OFFSETS, -NEIGHBOUR_OFFSETS])]) ** 2))
        if P > 0:
            v = P + 2 * abs(a) ** 2 / max(chi2, 2.0)
            total += (n + 1) * float(np.log1p(abs(S) ** 2 / (n * P)) - np.log1p(abs(S - a) ** 2 / (n * v)))
            total -= float(np.log(v / P))
    return total


def _follow_motion(model: RecordingModel) -> Array:
    """(n, 3, k) errors of readings that follow the motion: products of rates, their sizes and their changes."""
    raw = model.raw
    products = [raw[:, i] * raw[:, j] for i in AXIS_INDICES for j in range(i, 3)]
    own = np.column_stack([*products, *np.abs(raw).T, *compute_delay_columns(model.stream)[:, :, 0].T])
    out = np.zeros((len(raw), 3, 3 * own.shape[1]))
    for axis in AXIS_INDICES:
        out[:, axis, axis * own.shape[1] : (axis + 1) * own.shape[1]] = own
    return out
