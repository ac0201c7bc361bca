"""Sinusoidal errors of any period with one phase over the whole recording: the scan for them, and their options.

A period is known to the time T between the first and the last reference, gaps included: frequencies 1/(4T) apart lose at most
1 − sinc²(1/8) = 5 % of the χ² of a sinusoid between two of them. That may be a hundred thousand frequencies where the intervals
lie weeks apart, so the waves themselves are made at a few frequencies per interval's length only, and
`diagnosis.sinusoids` gives the evidence of those in between.

Where such a frequency is kept, the best of a grid `FINER` times finer takes its place, with its share of the prior, so that one
of several aliases, periods that differ by the gaps between intervals, is not preferred for being nearer to the grid.

The prior is even in the logarithm of the period, so that the option at f has the share ∝ 1/f of all that were tried, whether or
not it is kept. Orbit harmonics are left out where the orbit is known: they are other effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from diagnosis.model.linear import LinearModel, ParameterChoice, Parameters, SelectedCandidate
from diagnosis.model.recording_model import RecordingModel
from diagnosis.sinusoids import IntervalProducts, find_tops, make_waves
from gyrocal.arrays import Array
from simulator.effects.base import AXIS_NAMES, Effect, Value
from simulator.effects.periodic import SHORTEST_PERIOD_SPACINGS, compute_period_band

STEP = 0.25  # between frequencies that are tried, in units of 1/T
MADE = 0.0625  # between frequencies at which waves are made, in units of 1/D, at most
MOST = 300_000  # frequencies; of longer recordings the shortest periods are left out
HARMONICS = 4  # of the orbit that are left out: they are other effects
NEAR = 0.25  # of 1/T from one of them, up to which a sinusoid shows nine tenths of what that does
FINER = 8  # steps of the finer grid in one of the first
PEAKS = 12  # best frequencies that are kept, no two of one peak in terms of an interval's length
# others near each of the best peaks, which differ by the gaps between intervals, and how many peaks
ALIASES = 6
ALIASED = 3
FINE_PERIODS = 8  # to either side of an option that was found
REFINED_ALIASES = 8  # of an option, around which the same is done
# share of χ² and χ² by which such an alias may explain less
NEARLY = 0.03
ENOUGH = 12.0


@dataclass(frozen=True)
class Grid:
    """Frequencies that are tried, Hz."""

    made: Array  # (j,) at which waves are made
    tried: Array  # (j, m) in the order of frequency
    log_weight: Array  # (j, m) log prior share, −∞ of what is left out
    step: float  # between neighbours


@dataclass(frozen=True)
class Period:
    """A frequency that is worth an option: Hz, log of its prior share, and the width of the frequencies it stands for, Hz."""

    frequency: float
    log_weight: float
    width: float

    @property
    def parameters(self) -> Parameters:
        """Period, s, and its sigma between an option and its neighbours."""
        return {"period_s": 1 / self.frequency, "period_sigma_s": self.width / np.sqrt(12) / self.frequency**2}


Found = dict[tuple[bool, int], tuple[Period, ...]]  # by whether it is an error of the references, and by axis


def make_grid(model: RecordingModel) -> Grid | None:
    """Make the frequencies to try in a recording; None without a series of references."""
    band = compute_period_band(model.surroundings)
    if band is None:
        return None
    t, block = model.observation_t_s, model.observation_block
    spacings_s = np.diff(t)[(np.diff(block) == 0) & (np.diff(t) > 0)]
    shortest = max(band[0], SHORTEST_PERIOD_SPACINGS * float(np.median(spacings_s)) if spacings_s.size else np.inf)
    span, arc = band[1], max(float(model_block.elapsed_s[-1]) for model_block in model.blocks)
    step = STEP / span
    highest = min(1 / shortest, MOST * step)
    lowest = 1 / span
    if not lowest < highest:
        return None
    per_wave = max(1, int(np.floor(MADE / arc / step)))
    wave_hz = lowest + per_wave * step * (np.arange(int(np.ceil((highest - lowest) / (per_wave * step)))) + 0.5)
    tried_hz = wave_hz[:, None] + step * (np.arange(per_wave) + 0.5 - 0.5 * per_wave)
    allowed = tried_hz <= highest
    orbit = 1 / model.stream.orbit_period_s
    if np.isfinite(orbit):
        order = np.rint(tried_hz / orbit)
        allowed &= (np.abs(tried_hz - order * orbit) > NEAR * lowest) | (order < 1) | (order > HARMONICS)
    if not allowed.any():
        return None
    with np.errstate(divide="ignore"):
        share = np.where(allowed, 1 / tried_hz, 0.0)
        return Grid(np.asarray(wave_hz, dtype=float), np.asarray(tried_hz, dtype=float), np.log(share / share.sum()), step)


def scan_periods(model: RecordingModel) -> Found:
    """Scan for each kind of error, of the references or not, about each axis; nothing without a series of references."""
    grid = make_grid(model)
    periods: Found = {}
    if grid is None:
        return periods
    for on_references in (False, True):
        for axis in range(3):
            periods[on_references, axis] = select_periods(grid, compute_wave_products(model, grid, axis, on_references))
    return periods


def compute_wave_products(model: RecordingModel, grid: Grid, axis: int, on_references: bool) -> IntervalProducts:
    """Compute the products of the waves of an error of the rates or the references about one body axis."""
    columns = (model.reference_columns if on_references else model.cell_columns)[axis]
    gram = columns.T @ model.project_out_nuisance(columns)
    t, length, interval = model.cells.t_s, model.cells.duration_s, model.cells.interval
    if on_references:
        t, length, interval = model.observation_t_s, np.zeros(model.observation_t_s.size), model.observation_block
    Q = compute_common_nuisance(model)
    count = len(model.blocks)
    zg = np.empty((grid.made.size, count, 1 + Q.shape[1]), dtype=complex)
    s = np.empty((grid.made.size, count, 1), dtype=complex)
    h = np.zeros(grid.made.size)
    middle = np.empty(count)
    for number, block in enumerate(model.blocks):
        members = np.flatnonzero(interval == number)
        middle[number] = 0.5 * (t[members[0]] + t[members[-1]])
        C = columns[block.rows][:, members]
        a = np.exp(2j * np.pi * np.outer(t[members] - middle[number], grid.made)) * np.sinc(
            np.outer(length[members], grid.made)
        )
        parts = np.column_stack([C.T @ model.y[block.rows], C.T @ Q[block.rows]]).T @ a  # (1 + q, j)
        turned = (gram[np.ix_(members, members)] @ a.view(float)).view(complex)
        zg[:, number] = parts.T
        h += np.sum((a.conj() * turned).real, axis=0) + np.sum(np.abs(parts[1:]) ** 2, axis=0)
        s[:, number, 0] = np.sum(a * turned, axis=0) + np.sum(parts[1:] ** 2, axis=0)
    return IntervalProducts(middle, zg, h, s)


def compute_common_nuisance(model: RecordingModel) -> Array:
    """Compute (N, q) orthonormal directions of the nuisance parameters beside the start attitudes."""
    starts = np.linalg.qr(model.starts)[0]
    U, s, _ = np.linalg.svd(model.nuisance - starts @ (starts.T @ model.nuisance), full_matrices=False)
    return np.asarray(U[:, s > 1e-6])


def select_periods(grid: Grid, products: IntervalProducts) -> tuple[Period, ...]:
    """Select the frequencies that explain most: the best of each peak, and the aliases of the very best."""
    score = products.compute_log_evidence(grid.tried) + grid.log_weight
    best = score.max(axis=1)
    peaks = find_tops(best, PEAKS)
    width = score.shape[1]
    chosen = {int(peak) * width + int(np.argmax(score[peak])) for peak in peaks}
    flat_score = score.ravel()
    tops = find_tops(flat_score, flat_score.size)
    for peak in peaks[:ALIASED]:
        finer_hz = tops[np.abs(tops // width - peak) <= 1]
        chosen |= {int(k) for k in finer_hz[:ALIASES]}
    places = np.array([k for k in chosen if np.isfinite(flat_score[k])], dtype=np.intp)
    finer_hz = grid.tried.ravel()[places, None] + grid.step / FINER * (np.arange(FINER) + 0.5 - 0.5 * FINER)
    finer = products.compute_log_evidence(finer_hz, places // width)
    log_weight = grid.log_weight.ravel()[places] - np.log(FINER)
    best_of = np.argmax(finer, axis=1)
    order = np.argsort(-(finer.max(axis=1) + log_weight))
    return tuple(Period(float(finer_hz[k, best_of[k]]), float(log_weight[k]), grid.step / FINER) for k in order)


def make_period_columns(model: RecordingModel, axis: int, on_references: bool, frequencies: Array) -> list[Array]:
    """Make (N, 2) whitened columns of sine and cosine of an error about one body axis at each frequency, per rad/s or rad.

    Over a cell the mean of the wave stands for it.
    """
    t_s = model.references.t_s if on_references else model.cells.t_s
    waves = make_waves(frequencies, t_s, 0.0 if on_references else model.cells.duration_s)
    if on_references:
        errors = np.zeros((t_s.size, 3, waves.shape[1]))
        errors[:, axis] = waves
        columns = model.whiten(model.observe_reference_error(errors))
    else:
        columns = model.cell_columns[axis] @ waves
    return np.split(columns, frequencies.size, axis=1)


def make_columns(model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value]) -> Array:
    """Make (N, k) whitened columns of an effect per unit of its amplitudes."""
    if effect.on_references:
        return model.whiten(model.observe_reference_error(effect.reference_columns(model.references, axis, parameters)))
    return model.whiten(model.reading(effect.columns(model.stream, axis, parameters)))


def make_effect_columns(model: RecordingModel, effect: Effect, axis: str, frequencies: Array) -> list[Array]:
    """Make (N, 2) whitened columns of an effect at several frequencies, Hz, in its unit: the first decides on it."""
    period_columns = make_period_columns(model, AXIS_NAMES.index(axis), effect.on_references, frequencies)
    exact = make_columns(model, effect, axis, {"period_s": 1 / float(frequencies[0])})
    factor = float(np.sum(period_columns[0] * exact) / np.sum(period_columns[0] ** 2))
    return [factor * part for part in period_columns]


def add_finer_periods(model: RecordingModel, linear: LinearModel, member: SelectedCandidate, effect: Effect) -> LinearModel:
    """Add more periods to a linear model, close together around the one at which a member is held and its aliases.

    Each of these options keeps half of its prior; the new ones, which reach to its neighbours, share as much as it had.
    """
    entry = linear.candidate(member)
    if not entry.scanned:
        return linear
    aliases, fine = _find_aliases(linear, member), FINE_PERIODS
    fine_moves = np.array([k for k in range(-fine, fine + 1) if k]) / fine
    share = float(np.log(fine_moves.size))
    finer_periods = [
        Period(float(period.frequency + period.width * move), period.log_weight - share, period.width / fine)
        for period in map(_get_period, aliases)
        for move in fine_moves
    ]
    W = np.hstack(make_effect_columns(model, effect, str(entry.axis), np.array([period.frequency for period in finer_periods])))
    start = linear.W.shape[1]
    finer = [ParameterChoice(start + 2 * k, 2, period.log_weight, period.parameters) for k, period in enumerate(finer_periods)]
    options = [
        replace(option, log_weight=option.log_weight - np.log(2)) if option in aliases else option for option in entry.options
    ]
    return linear.replace_options(member.candidate, [*options, *finer], W, model.project_out_nuisance(W))


def _find_aliases(linear: LinearModel, member: SelectedCandidate) -> list[ParameterChoice]:
    """Find the member's option of a sinusoid and others, none of them neighbours, that explain nearly as much alone."""
    options, first = linear.candidate(member).options, linear.option(member)
    chi2 = {
        choice.start: float(np.sum((scipy.linalg.orth(linear.X[:, choice.columns]).T @ linear.y) ** 2)) for choice in options
    }
    least = (1 - NEARLY) * chi2[first.start] - ENOUGH
    separation_hz = 2 * FINE_PERIODS * _get_period(first).width
    aliases = [first]
    for option in sorted(options, key=lambda option: -chi2[option.start]):
        frequency = _get_period(option).frequency
        new = all(abs(frequency - _get_period(alias).frequency) > separation_hz for alias in aliases)
        if len(aliases) < REFINED_ALIASES and chi2[option.start] >= least and new:
            aliases.append(option)
    return aliases


def _get_period(option: ParameterChoice) -> Period:
    frequency = 1 / float(option.parameters["period_s"])
    return Period(frequency, option.log_weight, float(option.parameters["period_sigma_s"]) * float(np.sqrt(12)) * frequency**2)
