r"""How strongly an effect shows to an analyst, beside G, b, the start attitudes and the motion of the body.

**In the attitude** a change δ of the raw rates and an error e of the references change the residual by y(t) = ∫ Aᵀ G δ dt +
Aᵀ e, to first order and in inertial axes. A Kalman filter whitens y, what the twelve parameters take up is projected out, and
the norm of the rest is √Δχ² of a fit of just this change. Of a random change w and w' in two draws, E|w|² = tr Λ and E(w·w')²
= tr Λ²; r = (tr Λ)²/tr Λ² equal eigenvalues λ = tr Λ²/tr Λ have these moments, and the ratio is √(2D), D = (r/2)(λ −
ln(1 + λ)).

**In the samples** nobody who does not know the motion can look for a waveform. Third differences over √20 have the samples'
white noise and next to nothing of a smooth motion; of frequencies a tenth of the sampling rate and more are looked at. The
level of cells of sixteen numbers is compared with that of noise and motion: √(2D), D = ½ Σ 16 (ρ − 1 − ln ρ), ρ the ratio of a
cell's power with and without the change, in time or in frequency, whichever shows more.
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
CELL = 16  # numbers whose level is compared together
LOWEST_HZ = 0.1  # of the sampling rate, from where on frequencies of the samples are looked at
SERIES = 1e-4  # of λ, below which λ − ln(1 + λ) = λ²/2 − λ³/3


class Change(NamedTuple):
    """What differs between two recordings of a plan: raw rates (n, 3), rad/s, and references e (m, 3), rad."""

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
        u = (motion.reference_t_s - times[self.interval]) / self.sample_s
        last = np.array([part.stop - part.start for part in motion.intervals])[self.interval] - 1
        inside = np.minimum(np.floor(u + 1e-6).astype(np.intp), last)
        self.begin, self.first, self.share = starts[self.interval], starts[self.interval] + inside, u - inside
        mean = motion.rates * self.sample_s
        self.to_inertial = np.empty((len(mean), 3, 3))
        error = np.zeros((len(motion.reference_t_s), 3))
        for number, part in enumerate(motion.intervals):
            rows = np.flatnonzero(self.interval == number)
            path = accumulate(motion.quaternions[rows[0]], mean[part])
            self.to_inertial[part] = np.swapaxes(convert_to_matrix(apply_rotation_errors(path[:-1], -0.5 * mean[part])), 1, 2)
            at = apply_rotation_errors(path[inside[rows]], -self.share[rows, None] * mean[self.first[rows]])
            error[rows] = separation(at, motion.quaternions[rows])
        self.at_references = np.swapaxes(convert_to_matrix(motion.quaternions), 1, 2)
        zero = Change(np.zeros_like(mean), error)
        self.model_error = float(np.linalg.norm(self.whiten(zero)))  # of the plan's own samples

    @cached_property
    def parameters(self) -> Array:
        """(N, 12) whitened columns of G row by row, then b."""
        raw, columns = self.plan.plain.gyro.rates, []
        for body in range(3):
            turn = self.to_inertial[:, :, body]
            columns += [turn * raw[:, [gyro]] for gyro in range(3)]
        columns += [self.to_inertial[:, :, body] for body in range(3)]
        return np.stack([self._whiten_residuals(self._integrate(one)) for one in columns], axis=1)

    @cached_property
    def taken_up(self) -> tuple[Array, Array]:
        """(N, r) orthonormal basis of what G and b take up, and their (12,) formal sigmas; infinite where r is below 12."""
        scale = np.linalg.norm(self.parameters, axis=0)
        u, s, vt = np.linalg.svd(self.parameters / np.where(scale > 0, scale, 1.0), full_matrices=False)
        kept = s > RANK_TOLERANCE * s[0]
        sigmas = np.linalg.norm(vt.T / s, axis=1) / scale if kept.all() and scale.all() else np.full(12, np.inf)
        return u[:, kept], sigmas

    def whiten(self, change: Change) -> Array:
        """(N,) change of the whitened residuals, before anything is taken up."""
        turned = np.einsum("nij,nj->ni", self.to_inertial, change.raw @ self.plan.G.T)
        at = np.einsum("nij,nj->ni", self.at_references, change.reference)
        return self._whiten_residuals(self._integrate(turned) + at)

    def respond(self, change: Change) -> Array:
        """(N,) change of the whitened residuals that the calibration does not take up."""
        white, (basis, _) = self.whiten(change), self.taken_up
        return np.asarray(white - basis @ (basis.T @ white))

    def _integrate(self, inertial: Array) -> Array:
        """∫ of rates (n, 3) up to each reference since its interval's start, (m, 3)."""
        total = np.vstack([np.zeros((1, 3)), np.cumsum(inertial * self.sample_s, axis=0)])
        step = total[self.first + 1] - total[self.first]
        return np.asarray(total[self.first] - total[self.begin] + self.share[:, None] * step)

    def _whiten_residuals(self, y: Array) -> Array:
        """(m, 3) → (N,) white, of unit variance."""
        seen = self.plan.plain.attitudes
        return _whiten_random_walk(y, seen.t_s, self.interval, self.at_references, seen.sigma, self.plan.plain.gyro.arw)

    # ---- samples -----------------------------------------------------------------------------------------------------------

    @cached_property
    def sample_sigma(self) -> float:
        """White noise of a sample, rad/s."""
        return float(self.plan.plain.gyro.arw / np.sqrt(self.sample_s))

    def roughen(self, raw: Array) -> Array:
        """(k, 3) what a smooth motion leaves of samples (n, 3), over their noise."""
        parts = [np.diff(raw[part], 3, axis=0) for part in self.plan.motion.intervals]
        return np.concatenate(parts) / (np.sqrt(20) * self.sample_sigma)

    def transform(self, raw: Array) -> Array:
        """(k, 3) complex amplitudes of samples at high frequencies, over those of their noise, interval by interval."""
        out = []
        for part in self.plan.motion.intervals:
            count = part.stop - part.start
            window = np.hanning(count)[:, None]
            window /= self.sample_sigma * np.sqrt(np.sum(window**2))
            out.append(np.fft.rfft(raw[part] * window, axis=0)[int(np.ceil(LOWEST_HZ * count)) :])
        return np.concatenate(out)

    @cached_property
    def motion_levels(self) -> tuple[Array, Array]:
        """Power that the motion itself leaves in time and in frequency."""
        raw = self.plan.plain.gyro.rates
        return self.roughen(raw) ** 2, np.abs(self.transform(raw)) ** 2

    def measure_samples(self, raw: Array, noise: Array | None) -> float:
        """Signal-to-noise ratio of a change of the samples (n, 3); with their noise (n, 3) where it may go with that."""
        if not raw.any():
            return 0.0
        in_time, in_frequency = self.motion_levels
        own, spectrum = self.roughen(raw), self.transform(raw)
        cross = np.zeros(3) if noise is None else np.mean(self.roughen(noise) * own, axis=0)
        time = _measure_level(own**2 + 2 * cross, 1 + in_time, CELL)
        return max(time, _measure_level(np.abs(spectrum) ** 2, 1 + in_frequency, CELL // 2))  # an amplitude is two numbers


def _measure_level(change: Array, before: Array, rows: int) -> float:
    """√(2D) of a change of power beside that before, both (k, 3), in cells of so many rows."""
    cuts = np.arange(0, len(change) - rows + 1, rows)
    if not cuts.size:
        return 0.0
    ratio = np.maximum(1 + np.add.reduceat(change, cuts, axis=0) / np.add.reduceat(before, cuts, axis=0), 1e-12)
    return float(np.sqrt(np.sum(CELL * (ratio - 1 - np.log(ratio)))))


def measure_attitude(responses: Sequence[Array], noises: Sequence[Array]) -> float:
    """Signal-to-noise ratio in the attitude of a change from draws of what is seen of it (N,), and of the noise beside.

    A change that is the same in all draws, or nearly, has a waveform. Where it is random its process counts, or its level.
    """
    rows = np.array(responses)
    gram = rows @ rows.T
    power = float(np.trace(gram)) / len(rows)
    if power <= 0:
        return 0.0
    off = gram[~np.eye(len(rows), dtype=bool)]
    if not off.size or off.mean() > 0.5 * power:
        return float(np.sqrt(off.mean() if off.size else power))
    square = max(float(np.mean(off**2)), power**2 / rows.shape[1])  # no rank is above the number of observations
    size = square / power
    loss = size**2 / 2 - size**3 / 3 if size < SERIES else size - np.log1p(size)
    noise = np.array(noises)
    level = np.mean((rows + noise) ** 2 - noise**2)  # of unit variance
    ratio = max(1 + float(level), 1e-12)
    return float(max(np.sqrt(power / size * loss), np.sqrt(rows.shape[1] * (ratio - 1 - np.log(ratio)))))


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
