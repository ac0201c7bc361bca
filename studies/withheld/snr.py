r"""Compute the signal-to-noise ratio of an effect beside G, b, the start attitudes and the motion of the body.

**In the attitude** a change δ of the raw rates and an error e of the references change the residual by y(t) = ∫ Aᵀ G δ dt +
Aᵀ e, to first order and in inertial axes. A Kalman filter whitens y, the span of the twelve parameters is projected out, and
the norm of the remaining vector is √Δχ² of a fit of just this change. For the responses w and w' to two draws of a random
change, E|w|² = tr Λ and E(w·w')² = tr Λ²; r = (tr Λ)²/tr Λ² equal eigenvalues λ = tr Λ²/tr Λ have these moments, and the ratio
is √(2D), D = (r/2)(λ − ln(1 + λ)).

**In the samples** the motion is unknown, so that no waveform can be tested, only the level. Third differences over √20 have the
samples' white noise and hardly any of a smooth motion; the spectrum is used from a tenth of the sampling rate on. The
level of cells of sixteen numbers is compared with that of noise and motion: √(2D), D = ½ Σ 16 (ρ − 1 − ln ρ), ρ the ratio of a
cell's power with and without the change, in time or in frequency, whichever ratio is larger.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, solve_lower
from simulator.truth.integration import accumulate
from simulator.truth.rotation import apply_rotation_errors, convert_to_matrix, separation
from studies.withheld.plans import Plan

RANK_TOLERANCE = 1e-10  # of the largest singular value
CELL = 16  # numbers in a cell, whose mean power is compared
LOWEST_HZ = 0.1  # of the sampling rate, lowest frequency of the samples that is used
SERIES = 1e-4  # of λ, below which λ − ln(1 + λ) = λ²/2 − λ³/3


class Change(NamedTuple):
    """Difference of two recordings of a plan: of raw rates (n, 3), rad/s, and of references e (m, 3), rad."""

    raw: Array
    reference: Array

    def scale(self, factor: float) -> "Change":
        """Return the change times a factor."""
        return Change(factor * self.raw, factor * self.reference)


class ResidualModel:
    """The linear model of a plan's residuals."""

    def __init__(self, plan: Plan):
        motion, self.plan, self.sample_s = plan.motion, plan, plan.plain.gyro.sample_s
        starts = np.array([part.start for part in motion.intervals])
        times = motion.t_s[starts]
        self.interval = np.searchsorted(times - 1e-6, motion.reference_t_s, side="right") - 1
        steps = (motion.reference_t_s - times[self.interval]) / self.sample_s
        last = np.array([part.stop - part.start for part in motion.intervals])[self.interval] - 1
        inside = np.minimum(np.floor(steps + 1e-6).astype(np.intp), last)
        self.begin, self.first, self.share = starts[self.interval], starts[self.interval] + inside, steps - inside
        mean = motion.rates * self.sample_s
        self.to_inertial = np.empty((len(mean), 3, 3))
        error = np.zeros((len(motion.reference_t_s), 3))
        for number, part in enumerate(motion.intervals):
            rows = np.flatnonzero(self.interval == number)
            path = accumulate(motion.quaternions[rows[0]], mean[part])
            self.to_inertial[part] = np.swapaxes(convert_to_matrix(apply_rotation_errors(path[:-1], -0.5 * mean[part])), 1, 2)
            attitudes = apply_rotation_errors(path[inside[rows]], -self.share[rows, None] * mean[self.first[rows]])
            error[rows] = separation(attitudes, motion.quaternions[rows])
        self.at_references = np.swapaxes(convert_to_matrix(motion.quaternions), 1, 2)
        zero = Change(np.zeros_like(mean), error)
        self.model_error = float(np.linalg.norm(self.whiten(zero)))  # of the plan's own samples

    @cached_property
    def parameters(self) -> Array:
        """Whitened columns (N, 12) of G row by row, then b."""
        raw, columns = self.plan.plain.gyro.rates, []
        for body in range(3):
            turn = self.to_inertial[:, :, body]
            columns += [turn * raw[:, [gyro]] for gyro in range(3)]
        columns += [self.to_inertial[:, :, body] for body in range(3)]
        return np.stack([self._whiten_residuals(self._integrate(column)) for column in columns], axis=1)

    @cached_property
    def parameter_basis(self) -> tuple[Array, Array]:
        """Orthonormal basis (N, r) of the columns of G and b, and their formal sigmas (12,); infinite where r is below 12."""
        scale = np.linalg.norm(self.parameters, axis=0)
        u, s, vt = np.linalg.svd(self.parameters / np.where(scale > 0, scale, 1.0), full_matrices=False)
        is_determined = s > RANK_TOLERANCE * s[0]
        sigmas = np.linalg.norm(vt.T / s, axis=1) / scale if is_determined.all() and scale.all() else np.full(12, np.inf)
        return u[:, is_determined], sigmas

    def whiten(self, change: Change) -> Array:
        """Compute the change (N,) of the whitened residuals, before G and b are fitted."""
        rate_errors = np.einsum("nij,nj->ni", self.to_inertial, change.raw @ self.plan.G.T)
        reference_errors = np.einsum("nij,nj->ni", self.at_references, change.reference)
        return self._whiten_residuals(self._integrate(rate_errors) + reference_errors)

    def respond(self, change: Change) -> Array:
        """Compute the change (N,) of the whitened residuals that a fit of G and b leaves."""
        white, (basis, _) = self.whiten(change), self.parameter_basis
        return np.asarray(white - basis @ (basis.T @ white))

    def _integrate(self, inertial: Array) -> Array:
        """Integrate rates (n, 3), rad/s, from its interval's start up to each reference, (m, 3) rad."""
        total = np.vstack([np.zeros((1, 3)), np.cumsum(inertial * self.sample_s, axis=0)])
        step = total[self.first + 1] - total[self.first]
        return np.asarray(total[self.first] - total[self.begin] + self.share[:, None] * step)

    def _whiten_residuals(self, y: Array) -> Array:
        """Whiten residuals (m, 3), rad, to (N,) of unit variance."""
        attitudes = self.plan.plain.attitudes
        return _whiten_random_walk(
            y, attitudes.t_s, self.interval, self.at_references, attitudes.sigma, self.plan.plain.gyro.arw
        )

    # ---- samples -----------------------------------------------------------------------------------------------------------

    @cached_property
    def sample_sigma(self) -> float:
        """White noise of a sample, rad/s."""
        return float(self.plan.plain.gyro.arw / np.sqrt(self.sample_s))

    def roughen(self, raw: Array) -> Array:
        """Compute third differences (k, 3) of samples (n, 3), over their noise; a smooth motion has hardly any."""
        parts = [np.diff(raw[part], 3, axis=0) for part in self.plan.motion.intervals]
        return np.concatenate(parts) / (np.sqrt(20) * self.sample_sigma)

    def transform(self, raw: Array) -> Array:
        """Compute complex amplitudes (k, 3) of samples at high frequencies, over those of their noise, by interval."""
        amplitudes = []
        for part in self.plan.motion.intervals:
            count = part.stop - part.start
            window = np.hanning(count)[:, None]
            window /= self.sample_sigma * np.sqrt(np.sum(window**2))
            amplitudes.append(np.fft.rfft(raw[part] * window, axis=0)[int(np.ceil(LOWEST_HZ * count)) :])
        return np.concatenate(amplitudes)

    @cached_property
    def motion_levels(self) -> tuple[Array, Array]:
        """Power of the motion itself in third differences and at high frequencies, each (k, 3)."""
        raw = self.plan.plain.gyro.rates
        return self.roughen(raw) ** 2, np.abs(self.transform(raw)) ** 2

    def measure_samples(self, raw: Array, noise: Array | None) -> float:
        """Compute the signal-to-noise ratio of a change of samples (n, 3), which may correlate with their noise (n, 3)."""
        if not raw.any():
            return 0.0
        time_level, frequency_level = self.motion_levels
        rough, spectrum = self.roughen(raw), self.transform(raw)
        cross = np.zeros(3) if noise is None else np.mean(self.roughen(noise) * rough, axis=0)
        snr = _measure_level(rough**2 + 2 * cross, 1 + time_level, CELL)
        return max(snr, _measure_level(np.abs(spectrum) ** 2, 1 + frequency_level, CELL // 2))  # an amplitude is two numbers


def _measure_level(change: Array, before: Array, rows: int) -> float:
    """Compute √(2D) of a change of power relative to the power before, both (k, 3), in cells of `rows` rows."""
    cuts = np.arange(0, len(change) - rows + 1, rows)
    if not cuts.size:
        return 0.0
    ratio = np.maximum(1 + np.add.reduceat(change, cuts, axis=0) / np.add.reduceat(before, cuts, axis=0), 1e-12)
    return float(np.sqrt(np.sum(CELL * (ratio - 1 - np.log(ratio)))))


def measure_attitude(responses: Sequence[Array], noises: Sequence[Array]) -> float:
    """Compute the signal-to-noise ratio in the attitude from draws of the response (N,) to a change, and of the noise.

    A change that is nearly the same in all draws has a waveform. The ratio of a random one is that of its process or level.
    """
    rows = np.array(responses)
    gram = rows @ rows.T
    power = float(np.trace(gram)) / len(rows)
    if power <= 0:
        return 0.0
    products = gram[~np.eye(len(rows), dtype=bool)]
    if not products.size or products.mean() > 0.5 * power:
        return float(np.sqrt(products.mean() if products.size else power))
    square = max(float(np.mean(products**2)), power**2 / rows.shape[1])  # no rank is above the number of observations
    size = square / power
    loss = size**2 / 2 - size**3 / 3 if size < SERIES else size - np.log1p(size)
    noise = np.array(noises)
    level = np.mean((rows + noise) ** 2 - noise**2)  # of unit variance
    ratio = max(1 + float(level), 1e-12)
    return float(max(np.sqrt(power / size * loss), np.sqrt(rows.shape[1] * (ratio - 1 - np.log(ratio)))))


@compile_cached
def _whiten_random_walk(y: Array, t: Array, interval: Indices, R: Array, sigma: Array, arw: float) -> Array:
    """Compute innovations of a random walk observed with white noise, whitened; each interval's first value starts it."""
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
        innovation = y[k] - x
        L = compute_lower_root(P + noise)
        white, half = solve_lower(L, innovation.reshape(3, 1))[:, 0], solve_lower(L, P)  # (L⁻¹P)ᵀ L⁻¹ is the gain
        out[used] = white
        used += 1
        for i in range(3):
            for a in range(3):
                x[i] += half[a, i] * white[a]
                for j in range(3):
                    P[i, j] -= half[a, i] * half[a, j]
    return out[:used].copy().ravel()
