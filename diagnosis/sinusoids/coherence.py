"""Sinusoids with one phase over several intervals: χ² and evidence at many frequencies from a few numbers for each interval.

In an interval with the middle c_i, of the length D, a wave of the frequency f near f_j is

    exp(2πi f t) ≈ exp(2πi f c_i) a_ij(t),    a_ij(t) = exp(2πi f_j (t − c_i)),

which with |f − f_j| ≤ 1/(32D) loses at most 0.3 % of χ². Columns C turn waves into observations y. The nuisance parameters are
those of single intervals, which C is free of, and a few directions Q common to all. The products of
v = Σ_i exp(2πi f c_i) C a_ij, whose real and imaginary part are the columns of cosine and sine, are then

    vᵀy = Σ_i e_i z_i,    vᴴPv = Σ_i h_i − |Σ_i e_i g_i|²,    vᵀPv = Σ_i e_i² s_i − Σ (Σ_i e_i g_i)²,

P the projection, e_i = exp(2πi f c_i), and z, g, h, s those of a_ij in its interval.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Indices = NDArray[np.intp]

# signal-to-noise ratios of the amplitudes by which frequencies are compared
SCALES = (3.0, 10.0, 30.0, 100.0, 300.0)


@dataclass(frozen=True)
class IntervalProducts:
    """Products of waves at some frequencies f_j in each of n intervals, see the module."""

    middle_s: Array  # (n,) c_i
    zg: Complex  # (j, n, 1 + q) z and g
    h: Array  # (j,) Σ_i h_i
    s: Complex  # (j, n, 1)

    def compute_log_evidence(self, frequency: Array, made: Indices | slice = slice(None)) -> Array:
        """Return the (j, m) log evidence of waves with their phase free, at the best of some sizes.

        Parameters
        ----------
        frequency : (j, m) Hz
        made : which f_j each row of them is near to
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


def find_tops(score: Array, most: int) -> Indices:
    """Return the places of the highest local maxima of (m,) scores, the highest first."""
    sides = np.pad(score, 1, constant_values=-np.inf)
    tops = np.flatnonzero((score > sides[:-2]) & (score >= sides[2:]))
    return np.asarray(tops[np.argsort(-score[tops])][:most])
