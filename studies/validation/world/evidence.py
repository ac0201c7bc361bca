r"""How strongly a change of a recording shows, whatever stage of the measuring chain it comes from.

**In the attitude.** A change δ of the raw rates and an error e of the references change the residual, in inertial axes and to
first order, by y(t) = ∫ Aᵀ G δ dt + Aᵀ e. The gyro's white noise makes y a random walk of ARW² a second, and the references add
their own white noise: y is whitened by a Kalman filter that starts from each interval's first reference, and what the twelve
parameters of the calibration take up is projected out. The norm of what is left is √Δχ² of a fit of just this change.

**In the samples.** Above a quarter of the sampling rate the plans have next to no motion; there the norm of the change over the
stated noise, by the Fourier transform of each interval, is that of a filter matched to it. A Hann window keeps what a slow
change does between its ends from leaking there. Both together, √(a² + s²), is the evidence of a change of known shape.
What follows the motion, as a scale factor, a dead zone, a delay or a step of G do, has jerks where the motion has them; nobody
who does not know the motion can tell such a jerk from the body's, so that for listed effects of that kind the attitude counts
alone (`studies.validation.world.world`).

**Of a random change** the shape is not known. With w and w' two draws of its whitened change, E|w|² = tr Λ and E(w·w')² = tr Λ²
of its covariance Λ; r = (tr Λ)²/tr Λ² equal eigenvalues λ = tr Λ²/tr Λ have these moments, and the Kullback–Leibler divergence
D = (r/2)(λ − ln(1 + λ)) from the noise. √(2D) is the evidence. Where an effect changes the noise itself, its level in bands is
compared too, and the larger of the two counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, solve_lower
from simulator.effects.base import Array
from simulator.truth.integration import accumulate
from simulator.truth.rotation import apply_rotation_errors, convert_to_matrix, separation
from studies.validation.world.plans import Plan

Indices = NDArray[np.intp]

HIGH = 0.25  # of the sampling rate, from where on samples are free of motion
EVIDENCE_RANK_TOLERANCE = 1e-10  # of the largest singular value
BANDS = 24  # in which the level of noise is compared
SERIES = 1e-4  # of λ, below which λ − ln(1 + λ) = λ²/2 − λ³/3


@dataclass(frozen=True)
class Change:
    """What differs between two recordings of a plan: raw rates (n, 3), rad/s, and references e (m, 3), rad."""

    raw: Array
    reference: Array


class Evidence:
    """The linear model of a plan's residuals."""

    def __init__(self, plan: Plan):
        motion, plain = plan.motion, plan.plain
        self.plan, self.sample_s = plan, plain.gyro.sample_s
        self.first, self.share, self.interval = _locate_references(
            motion.t_s, motion.intervals, motion.reference_t_s, self.sample_s
        )
        mean = motion.rates * self.sample_s
        self.to_inertial = np.empty((len(mean), 3, 3))
        error = np.zeros((len(motion.reference_t_s), 3))
        for number, part in enumerate(motion.intervals):
            rows = np.flatnonzero(self.interval == number)
            path = accumulate(motion.quaternions[rows[0]], mean[part])
            self.to_inertial[part] = np.swapaxes(convert_to_matrix(apply_rotation_errors(path[:-1], -0.5 * mean[part])), 1, 2)
            inside = self.first[rows]
            at = apply_rotation_errors(path[inside - part.start], -self.share[rows, None] * mean[inside])
            error[rows] = separation(at, motion.quaternions[rows])
        self.at_references = np.swapaxes(convert_to_matrix(motion.quaternions), 1, 2)
        own = plan.noise_axes
        self.of_noise = self.at_references if own is None else self.at_references @ np.swapaxes(own, 1, 2)
        self.model_error = float(np.linalg.norm(self.whiten_change(Change(np.zeros_like(mean), error))))

    @cached_property
    def parameters(self) -> Array:
        """(N, 12) whitened columns of G row by row, then b."""
        raw, columns = self.plan.plain.gyro.rates, []
        for body in range(3):
            turn = self.to_inertial[:, :, body]
            columns += [turn * raw[:, [gyro]] for gyro in range(3)]
        columns += [self.to_inertial[:, :, body] for body in range(3)]
        return np.stack([self._whiten_residuals(self._integrate_rates(one)) for one in columns], axis=1)

    @cached_property
    def sigmas(self) -> Array:
        """(12,) formal sigmas of G and b, rad/s; infinite where the plan does not determine them."""
        scale = np.linalg.norm(self.parameters, axis=0)
        if not scale.all():
            return np.full(12, np.inf)
        _, s, vt = np.linalg.svd(self.parameters / scale, full_matrices=False)
        if s[-1] < EVIDENCE_RANK_TOLERANCE * s[0]:
            return np.full(12, np.inf)
        return np.asarray(np.linalg.norm(vt.T / s, axis=1) / scale)

    @cached_property
    def taken_up(self) -> Array:
        """(N, r) orthonormal basis of what the calibration takes up."""
        scale = np.linalg.norm(self.parameters, axis=0)
        u, s, _ = np.linalg.svd(self.parameters / np.where(scale > 0, scale, 1.0), full_matrices=False)
        return u[:, s > EVIDENCE_RANK_TOLERANCE * s[0]]

    def _integrate_rates(self, inertial: Array) -> Array:
        """∫ of rates (n, 3) up to each reference since its interval's start, (m, 3)."""
        total = np.vstack([np.zeros((1, 3)), np.cumsum(inertial * self.sample_s, axis=0)])
        begin = np.array([part.start for part in self.plan.motion.intervals])[self.interval]
        return np.asarray(total[self.first] - total[begin] + self.share[:, None] * (total[self.first + 1] - total[self.first]))

    def _whiten_residuals(self, y: Array) -> Array:
        """(m, 3) → (N,) white, of unit variance."""
        plain = self.plan.plain
        return _whiten_random_walk(y, plain.attitudes.t_s, self.interval, self.of_noise, plain.attitudes.sigma, plain.gyro.arw)

    def whiten_change(self, change: Change) -> Array:
        """(N,) change of the whitened residuals, before anything is taken up."""
        turned = np.einsum("nij,nj->ni", self.to_inertial, change.raw @ self.plan.G.T)
        return self._whiten_residuals(
            self._integrate_rates(turned) + np.einsum("nij,nj->ni", self.at_references, change.reference)
        )

    def attitude(self, change: Change) -> Array:
        """(N,) change of the whitened residuals that the calibration does not take up."""
        white = self.whiten_change(change)
        return np.asarray(white - self.taken_up @ (self.taken_up.T @ white))

    def samples(self, change: Change) -> Array:
        """(M,) change of the samples above the motion, over their noise: axis by axis, in each interval by interval."""
        out, sigma = [], self.plan.plain.gyro.arw / np.sqrt(self.sample_s)
        for part in self.plan.motion.intervals:
            count = part.stop - part.start
            low = int(np.ceil(HIGH * count))
            if not change.raw[part].any():  # of what acts on references
                out.append(np.zeros((3, 2 * (count // 2 + 1 - low))))
                continue
            window = np.hanning(count)[:, None]
            window /= np.sqrt(np.mean(window**2))
            spectrum = np.fft.rfft(change.raw[part] * window, axis=0)[low:]
            out.append(np.sqrt(2 / count) / sigma * np.concatenate([spectrum.real, spectrum.imag]).T)
        return np.hstack(out).ravel()

    def combine_evidence(self, change: Change) -> Array:
        """Both: its norm is the evidence of a known shape."""
        return np.concatenate([self.attitude(change), self.samples(change)])


def compute_process_evidence(draws: Sequence[Array]) -> float:
    """√(2D) of a random change from several draws of what is seen, each (N,)."""
    rows = np.array(draws)
    gram = rows @ rows.T
    trace = float(np.trace(gram)) / len(rows)
    off = gram[~np.eye(len(rows), dtype=bool)]
    square = max(float(np.mean(off**2)), trace**2 / rows.shape[1])  # no rank is above the number of observations
    if trace <= 0:
        return 0.0
    size = square / trace
    loss = size**2 / 2 - size**3 / 3 if size < SERIES else size - np.log1p(size)
    return float(np.sqrt(trace / size * loss))


def _locate_references(
    t_s: Array, intervals: Sequence[slice], reference_t_s: Array, sample_s: float
) -> tuple[Indices, Array, Indices]:
    """Sample in which each reference lies, its share of it, and its interval, (m,) each."""
    starts = np.array([t_s[part.start] for part in intervals])
    interval = np.searchsorted(starts - 1e-6, reference_t_s, side="right") - 1
    begin, count = np.array([[part.start, part.stop - part.start] for part in intervals])[interval].T
    u = (reference_t_s - starts[interval]) / sample_s
    inside = np.minimum(np.floor(u + 1e-6).astype(np.intp), count - 1)
    return begin + inside, u - inside, interval


@compile_cached
def _whiten_random_walk(y: Array, t: Array, interval: Indices, R: Array, sigma: Array, arw: float) -> Array:
    """Innovations of a random walk observed with white noise, over their root covariance; each interval's first starts it."""
    out = np.empty((len(y), 3))
    used = 0
    x, P = np.zeros(3), np.zeros((3, 3))
    for k in range(len(y)):
        noise = np.zeros((3, 3))
        for i in range(3):
            for j in range(3):
                for a in range(3):
                    noise[i, j] += R[k, i, a] * sigma[k, a] ** 2 * R[k, j, a]
        if k == 0 or interval[k] != interval[k - 1]:
            x, P = y[k].copy(), noise
            continue
        P = P + arw * arw * (t[k] - t[k - 1]) * np.eye(3)
        S = P + noise
        innovation = y[k] - x
        L = compute_lower_root(S)
        white, half = solve_lower(L, innovation.reshape(3, 1))[:, 0], solve_lower(L, P)  # (L⁻¹P)ᵀ L⁻¹ is the gain
        out[used] = white
        used += 1
        for i in range(3):
            for a in range(3):
                x[i] += half[a, i] * white[a]
                for j in range(3):
                    P[i, j] -= half[a, i] * half[a, j]
    return out[:used].copy().ravel()


def compute_noise_evidence(before: Array, after: Array) -> float:
    """√(2D) of noise whose level differs by bands: D = ½ Σ (ρ − 1 − ln ρ) over the N numbers, ρ the ratio of a band's power.

    Parameters
    ----------
    before, after : (N,) white noise as stated, and what it is with the change
    """
    cuts = np.linspace(0, len(before), min(BANDS, len(before)) + 1).astype(np.intp)[:-1]
    ratio = np.add.reduceat(after**2, cuts) / np.maximum(np.add.reduceat(before**2, cuts), 1e-300)
    count = np.diff(np.append(cuts, len(before)))
    return float(np.sqrt(np.sum(count * (ratio - 1 - np.log(np.maximum(ratio, 1e-12))))))
