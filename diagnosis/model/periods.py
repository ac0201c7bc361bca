"""A scan for swings of any period with one phase over the whole recording.

A period is known to the time T between the first and the last reference, gaps included: frequencies 1/(4T) apart lose at most
1 − sinc²(1/8) = 5 % of the χ² of a swing between two of them. That may be a hundred thousand frequencies where the intervals
lie weeks apart, so the waves themselves are made at frequencies f_j only, some per interval's length D. In interval i with the
middle c_i, a wave of the frequency f near f_j is

    exp(2πi f t) ≈ exp(2πi f c_i) a_ij(t),    a_ij(t) = exp(2πi f_j (t − c_i)),

which with |f − f_j| ≤ 1/(32D) loses at most 0.3 % of χ². With the whitened columns C of unit errors at the times t, the start
attitudes are taken out of each interval on its own; what is left of the nuisance parameters are a few directions Q, common to
all. The products of v = Σ_i exp(2πi f c_i) C a_ij, whose real and imaginary part are the columns of cosine and sine, are then

    vᵀy = Σ_i e_i z_i,    vᴴPv = Σ_i h_i − |Σ_i e_i g_i|²,    vᵀPv = Σ_i e_i² s_i − Σ (Σ_i e_i g_i)²,

P the projection, e_i = exp(2πi f c_i), and z, g, h, s those of a_ij in its interval: a few numbers for each frequency.

Where such a frequency is kept, the best of a grid `FINER` times finer takes its place, with its share of the prior, so that one
of several aliases, periods that differ by the gaps between intervals, is not preferred for being nearer to the grid.

The prior is even in the logarithm of the period, so that the option at f has the share ∝ 1/f of all that were tried, whether or
not it is kept. Orbit harmonics are left out where the orbit is known: they are other effects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.recording import RecordingModel
from simulator.effects.periodic import SHORTEST, period_band

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]


STEP = 0.25  # between frequencies that are tried, in units of 1/T
MADE = 0.0625  # between frequencies at which waves are made, in units of 1/D, at most
MOST = 300_000  # frequencies; of longer recordings the shortest periods are left out
HARMONICS = 4  # of the orbit that are left out
NEAR = 0.25  # of 1/T from one of them, up to which a swing shows nine tenths of what that does
FINER = 8  # steps of the finer grid in one of the first
PEAKS = 12  # best frequencies that are kept, no two of one peak in terms of an interval's length
ALIASES = 6  # others near each of the best of them, which differ by the gaps between intervals
ALIASED = 3  # peaks that have them
SCALES = (3.0, 10.0, 30.0, 100.0, 300.0)  # signal-to-noise ratios of the amplitudes by which frequencies are compared


@dataclass(frozen=True)
class Grid:
    """Frequencies that are tried, Hz.

    Attributes
    ----------
    made : (j,) at which waves are made
    tried : (j, m) in the order of frequency
    log_weight : (j, m) log prior share, −∞ of what is left out
    step : between neighbours
    """

    made: Array
    tried: Array
    log_weight: Array
    step: float


@dataclass(frozen=True)
class Kept:
    """A frequency that is worth an option: Hz, log of its prior share, and the frequencies that it stands for, Hz."""

    frequency: float
    log_weight: float
    width: float


def grid(model: RecordingModel) -> Grid | None:
    """The frequencies to try in a recording; None without a series of references."""
    band = period_band(model.around)
    if band is None:
        return None
    t, block = model.observation_t_s, model.observation_block
    apart = np.diff(t)[(np.diff(block) == 0) & (np.diff(t) > 0)]
    shortest = max(band[0], SHORTEST * float(np.median(apart)) if apart.size else np.inf)
    span, arc = band[1], max(float(one.elapsed_s[-1]) for one in model.blocks)
    step = STEP / span
    highest = min(1 / shortest, MOST * step)
    lowest = 1 / span
    if not lowest < highest:
        return None
    each = max(1, int(np.floor(MADE / arc / step)))
    made = lowest + each * step * (np.arange(int(np.ceil((highest - lowest) / (each * step)))) + 0.5)
    tried = made[:, None] + step * (np.arange(each) + 0.5 - 0.5 * each)
    allowed = tried <= highest
    orbit = 1 / model.stream.orbit_period_s
    if np.isfinite(orbit):
        order = np.rint(tried / orbit)
        allowed &= (np.abs(tried - order * orbit) > NEAR * lowest) | (order < 1) | (order > HARMONICS)
    if not allowed.any():
        return None
    with np.errstate(divide="ignore"):
        share = np.where(allowed, 1 / tried, 0.0)
        return Grid(np.asarray(made, dtype=float), np.asarray(tried, dtype=float), np.log(share / share.sum()), step)


Found = dict[tuple[bool, int], tuple[Kept, ...]]  # the best first, by whether the references err, and by body axis


@dataclass(frozen=True)
class Waves:
    """Products of the waves of one kind of error about one axis in each interval, see the module.

    Attributes
    ----------
    middle_s : (n,) c_i
    zg : (j, n, 1 + q) z and g
    h : (j,) Σ_i h_i
    s : (j, n, 1)
    """

    middle_s: Array
    zg: Complex
    h: Array
    s: Complex

    def scores(self, frequency: Array, made: Indices | slice = slice(None)) -> Array:
        """(j, m) log evidence of waves with their phase free, at the best of some sizes.

        Parameters
        ----------
        frequency : (j, m) Hz
        made : which of the frequencies at which waves are made each row of them is near to
        """
        e = np.exp(2j * np.pi * frequency[:, :, None] * self.middle_s)
        sums = np.matmul(e, self.zg[made])
        z, g = sums[..., 0], sums[..., 1:]
        around = self.h[made][:, None] - np.sum(np.abs(g) ** 2, axis=2)
        along = np.matmul(e * e, self.s[made])[..., 0] - np.sum(g * g, axis=2)
        pp, qq, pq = 0.5 * (around + along.real), 0.5 * (around - along.real), 0.5 * along.imag
        mean = np.maximum(0.5 * around, 1e-300)
        best = np.full(frequency.shape, -np.inf)
        for scale in SCALES:
            v = scale**2 / mean
            det = np.maximum((1 + v * pp) * (1 + v * qq) - (v * pq) ** 2, 1.0)
            quadratic = (1 + v * qq) * z.real**2 - 2 * v * pq * z.real * z.imag + (1 + v * pp) * z.imag**2
            best = np.maximum(best, 0.5 * v * quadratic / det - 0.5 * np.log(det))
        return best


def swings(model: RecordingModel) -> Found:
    """The scan for each kind of error, of the references or not, about each axis; none without a series of references."""
    model = model.without_priors()  # whose blocks have nothing in common but nuisance parameters
    at = grid(model)
    out: Found = {}
    if at is None:
        return out
    for on_references in (False, True):
        for axis in range(3):
            out[on_references, axis] = kept(at, waves(model, at, axis, on_references))
    return out


def waves(model: RecordingModel, at: Grid, axis: int, on_references: bool) -> Waves:
    """Products of the waves of an error of the rates or the references about one body axis."""
    columns, grams = (
        (model.reference_columns, model.reference_grams) if on_references else (model.cell_columns, model.cell_grams)
    )
    t, length, interval = times(model, on_references)
    Q = common_nuisance(model)
    count = len(model.blocks)
    zg = np.empty((at.made.size, count, 1 + Q.shape[1]), dtype=complex)
    s = np.empty((at.made.size, count, 1), dtype=complex)
    h = np.zeros(at.made.size)
    middle = np.empty(count)
    for number, block in enumerate(model.blocks):
        own = np.flatnonzero(interval == number)
        middle[number] = 0.5 * (t[own[0]] + t[own[-1]])
        C = columns[axis][block.rows][:, own]
        a = np.exp(2j * np.pi * np.outer(t[own] - middle[number], at.made)) * np.sinc(np.outer(length[own], at.made))
        parts = np.column_stack([C.T @ model.y[block.rows], C.T @ Q[block.rows]]).T @ a  # (1 + q, j)
        turned = grams[axis][np.ix_(own, own)] @ a
        zg[:, number] = parts.T
        h += np.sum((a.conj() * turned).real, axis=0) + np.sum(np.abs(parts[1:]) ** 2, axis=0)
        s[:, number, 0] = np.sum(a * turned, axis=0) + np.sum(parts[1:] ** 2, axis=0)
    return Waves(middle, zg, h, s)


def times(model: RecordingModel, on_references: bool) -> tuple[Array, Array, Indices]:
    """Times of the unit errors of a kind and how long each lasts, s, and the block of each."""
    if on_references:
        t_s = model.observation_t_s
        return t_s, np.zeros_like(t_s), model.observation_block
    return model.cells.t_s, model.cells.duration_s, model.cells.interval


def common_nuisance(model: RecordingModel) -> Array:
    """(N, q) orthonormal directions of the nuisance parameters beside the start attitudes."""
    starts = np.linalg.qr(model.starts)[0]
    U, s, _ = np.linalg.svd(model.nuisance - starts @ (starts.T @ model.nuisance), full_matrices=False)
    return np.asarray(U[:, s > 1e-6])


def kept(at: Grid, found: Waves) -> tuple[Kept, ...]:
    """The frequencies that explain most: the best of each peak, and the aliases of the very best."""
    score = found.scores(at.tried) + at.log_weight
    best = score.max(axis=1)
    around = np.pad(best, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((best > around[:-2]) & (best >= around[2:]))
    peaks = peaks[np.argsort(-best[peaks])][:PEAKS]
    width = score.shape[1]
    chosen = {int(peak) * width + int(np.argmax(score[peak])) for peak in peaks}
    flat, sides = score.ravel(), np.pad(score.ravel(), 1, constant_values=-np.inf)
    tops = np.flatnonzero((flat > sides[:-2]) & (flat >= sides[2:]))
    for peak in peaks[:ALIASED]:
        near = tops[np.abs(tops // width - peak) <= 1]
        chosen |= {int(k) for k in near[np.argsort(-flat[near])][:ALIASES]}
    places = np.array([k for k in chosen if np.isfinite(flat[k])], dtype=np.intp)
    near = at.tried.ravel()[places, None] + at.step / FINER * (np.arange(FINER) + 0.5 - 0.5 * FINER)
    finer = found.scores(near, places // width)
    log_weight = at.log_weight.ravel()[places] - np.log(FINER)
    best_of = np.argmax(finer, axis=1)
    order = np.argsort(-(finer.max(axis=1) + log_weight))
    return tuple(Kept(float(near[k, best_of[k]]), float(log_weight[k]), at.step / FINER) for k in order)


def columns(model: RecordingModel, axis: int, on_references: bool, frequencies: Array) -> list[Array]:
    """(N, 2) whitened columns of sine and cosine of an error about one body axis at each frequency, per rad/s or rad.

    Over a cell the mean of the wave stands for it.
    """
    t_s = model.references.t_s if on_references else model.cells.t_s
    angle = 2 * np.pi * np.outer(t_s, frequencies)
    swing = np.hstack([np.sin(angle), np.cos(angle)])
    if on_references:
        errors = np.zeros((t_s.size, 3, swing.shape[1]))
        errors[:, axis] = swing
        both = model.whitened(model.reference_error(errors))
    else:
        both = model.cell_columns[axis] @ (swing * np.tile(np.sinc(np.outer(model.cells.duration_s, frequencies)), 2))
    return [both[:, [k, k + frequencies.size]] for k in range(frequencies.size)]
