"""Any number of gyros joined to the three rates of the body by least squares, and how well they agree.

Each gyro reads the rate about its own axis, ω_raw,i = K_i · ω + c_i, with white noise σ_i. With W = diag(σ_i⁻²),

    ω = G ω_raw + b,    G = (KᵀWK)⁻¹ KᵀW,    b = −G c                                                     R (7)

Errors of the gyros' scale factors, axes and biases are errors of the joined G and b, which a calibration estimates. The parity
residual of a gyro is its reading minus the rate by the others about its axis, the leave-one-out residual of least squares,

    r_i = (ω_raw,i − K_i · G ω_raw) / f_i,    of variance σ_i² / f_i,    f_i = 1 − K_i · G_i,

which no motion changes. Leaving gyro i out takes f_i r_i² / σ_i² from the weighted sum of squares of all.
Source: Potter and Suman, Thresholdless redundancy management with arrays of skewed instruments, AGARDograph 224, 1977.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gyrocal.arrays import Array
from gyrocal.errors import InputError

SMALLEST_SPREAD_RATIO = 1e-3  # of the axes' singular values: gyros nearer to one plane do not measure all three directions
SMALLEST_FREEDOM = 1e-6  # f_i of a gyro that the others determine
MOST_NOISES = 3.0  # RMS of a parity residual in units of its noise: a gyro with more does not agree
MOST_REST_SHARE = 0.25  # of the sum of squares per degree of freedom that remains without a gyro that stands out


@dataclass(frozen=True)
class JoinedGyros:
    """Rates of the body by several gyros, and their parity."""

    names: tuple[str, ...]  # of the k gyros
    rates: Array  # (n, 3) G ω_raw, rad/s; NaN where fewer than three gyros with independent axes were read
    gain: float  # noise of the rates, root mean square about the three axes, in the unit of the gyros' `noise`
    residuals: Array  # (n, k) parity residuals r_i, rad/s; NaN where the gyro was not read or the others do not determine it
    spread: Array  # (k,) their noise σ_i / √f_i, root mean square over the rows
    freedom: Array  # (k,) f_i, mean over the rows

    def describe(self, unit: float) -> list[str]:
        """Describe the agreement of the gyros, a sentence each; unit is the noise of a sample, rad/s, in a unit of `noise`."""
        sentences = [f"the gyros {', '.join(self.names)} are joined to the rates about x, y and z by least squares"]
        for name, mean, rms, ratio in zip(self.names, *self._summarise(unit), strict=True):
            differs = f"{np.rad2deg(rms):.4g} deg/s RMS (mean {np.rad2deg(mean):.4g}), {ratio:.3g} times its noise"
            sentences.append(
                f"gyro {name} differs from what the others say by {differs}"
                if np.isfinite(rms)
                else f"gyro {name}: the others do not tell the rate about its axis"
            )
        return sentences

    def find_disagreement(self, unit: float) -> str:
        """Name the gyro that does not agree with the others, and the remedy; empty where all agree within their noise."""
        _, rms, ratio = self._summarise(unit)
        if not np.isfinite(ratio).any():
            return ""
        worst, redundancy = int(np.nanargmax(ratio)), len(self.names) - 3
        total = float(np.nansum(self.freedom * np.square(ratio)))  # weighted sum of squares of a row
        remaining = (total - ratio[worst] ** 2) / (redundancy - 1) if redundancy > 1 else np.inf
        others = ",".join(name for number, name in enumerate(self.names) if number != worst)
        if ratio[worst] > MOST_NOISES and remaining < MOST_REST_SHARE * total / redundancy:
            how = f"by {np.rad2deg(rms[worst]):.3g} deg/s RMS, {ratio[worst]:.3g} times its noise"
            return f"gyro {self.names[worst]} does not agree with the others, {how}: leave it out with --gyros {others}"
        return ""

    def _summarise(self, unit: float) -> tuple[Array, Array, Array]:
        """Compute mean and RMS of the parity residuals (k,), rad/s, and the RMS in units of their noise; NaN where unknown."""
        is_known = np.isfinite(self.residuals)
        count = np.where(is_known.any(axis=0), is_known.sum(axis=0), np.nan)
        mean = np.nansum(self.residuals, axis=0) / count
        rms = np.sqrt(np.nansum(np.square(self.residuals), axis=0) / count)
        return mean, rms, rms / (self.spread * unit)


def join_gyros(
    raw: ArrayLike, axes: ArrayLike, *, noise: ArrayLike | None = None, names: Sequence[str] | None = None
) -> JoinedGyros:
    """Join the readings of gyros to the three rates of the body by least squares, and compare them with one another.

    A row in which a gyro is missing uses the others, if three with independent axes are left.

    An `InputError` if shapes do not fit, or no row has three gyros that measure all three directions.

    Parameters
    ----------
    raw : (n, k) readings, rad/s; NaN where a gyro was not read
    axes : (k, 3) sensitive axis of each gyro in the body, times its scale factor if that is not one
    noise : (k,) white noise of each gyro, in any unit; equal, of one unit, by default
    names : of the gyros; their numbers from 1 by default
    """
    values, K = np.asarray(raw, dtype=np.float64), np.asarray(axes, dtype=np.float64)
    if values.ndim != 2 or K.shape != (values.shape[1], 3):
        raise InputError(f"gyros: {values.shape} readings need an axis of three numbers for each gyro, not {K.shape}")
    count = len(K)
    sigma = np.ones(count) if noise is None else np.asarray(noise, dtype=np.float64)
    if sigma.shape != (count,) or not (sigma > 0).all():
        raise InputError(f"gyros: the noise must be {count} positive numbers, one a gyro")
    rates, residuals = np.full((len(values), 3), np.nan), np.full(values.shape, np.nan)
    variance, freedom, power, joined_rows = np.zeros(count), np.zeros(count), 0.0, 0
    is_read = np.isfinite(values)
    # Rows with the same gyros have one G; the bits of a code are the gyros that were read.
    codes, number = np.unique(is_read @ (1 << np.arange(count)), return_inverse=True)
    for index, code in enumerate(codes):
        present = np.flatnonzero(code >> np.arange(count) & 1)
        if not spans_all_directions(K[present]):
            continue
        rows = np.flatnonzero(number == index)
        weight = sigma.mean() / sigma[present]
        G = np.linalg.pinv(K[present] * weight[:, None]) * weight
        readings = values[np.ix_(rows, present)]
        rates[rows] = readings @ G.T
        f = 1 - np.sum(K[present] * G.T, axis=1)
        is_compared = f > SMALLEST_FREEDOM
        compared = present[is_compared]
        residuals[np.ix_(rows, compared)] = (readings - rates[rows] @ K[present].T)[:, is_compared] / f[is_compared]
        variance[compared] += rows.size * np.square(sigma[compared]) / f[is_compared]
        freedom[compared] += rows.size * f[is_compared]
        power += rows.size * float(np.sum(np.square(G * sigma[present]))) / 3
        joined_rows += rows.size
    if not joined_rows:
        raise InputError("gyros: no row has three gyros that measure all three directions; are their axes as stated?")
    compared_rows = np.maximum(np.isfinite(residuals).sum(axis=0), 1)
    return JoinedGyros(
        tuple(str(k + 1) for k in range(count)) if names is None else tuple(names),
        rates,
        float(np.sqrt(power / joined_rows)),
        residuals,
        np.asarray(np.sqrt(variance / compared_rows)),
        np.asarray(freedom / compared_rows),
    )


def spans_all_directions(axes: Array) -> bool:
    """Whether gyros with these axes (k, 3) measure the rate about all three."""
    if len(axes) < 3:
        return False
    values = np.linalg.svd(axes, compute_uv=False)
    return bool(values[-1] > SMALLEST_SPREAD_RATIO * values[0])
