"""Any number of gyros joined to the three rates of the body by least squares, and how well they agree.

Each gyro reads the rate about its own axis, ω_raw,i = K_i · ω + c_i, with white noise σ_i. With W = diag(σ_i⁻²),

    ω = G ω_raw + b,    G = (KᵀWK)⁻¹ KᵀW,    b = −G c                                                     R (7)

Errors of the gyros' scale factors, axes and biases are errors of the joined G and b, which a calibration estimates. The parity
residual of a gyro is its reading less what the others say, the leave-one-out residual of least squares,

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
MOST_REST_SHARE = 0.25  # of the sum of squares a degree of freedom: so little is left without a gyro that stands out


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
        """Say how well the gyros agree, a sentence each; unit is rad/s of one unit of the gyros' `noise`, for one sample."""
        said = [f"the gyros {', '.join(self.names)} are joined to the rates about x, y and z by least squares"]
        for name, mean, rms, ratio in zip(self.names, *self._summarise(unit), strict=True):
            differs = f"{np.rad2deg(rms):.4g} deg/s RMS (mean {np.rad2deg(mean):.4g}), {ratio:.3g} times its noise"
            said.append(
                f"gyro {name} differs from what the others say by {differs}"
                if np.isfinite(rms)
                else f"gyro {name}: the others do not tell the rate about its axis"
            )
        return said

    def find_disagreement(self, unit: float) -> str:
        """Name the gyro that does not agree with the others, and the remedy; empty where all agree within their noise."""
        _, rms, ratio = self._summarise(unit)
        if not np.isfinite(ratio).any():
            return ""
        worst, free = int(np.nanargmax(ratio)), len(self.names) - 3
        total = float(np.nansum(self.freedom * np.square(ratio)))  # weighted sum of squares of a row
        left = (total - ratio[worst] ** 2) / (free - 1) if free > 1 else np.inf
        others = ",".join(name for number, name in enumerate(self.names) if number != worst)
        if ratio[worst] > MOST_NOISES and left < MOST_REST_SHARE * total / free:
            how = f"by {np.rad2deg(rms[worst]):.3g} deg/s RMS, {ratio[worst]:.3g} times its noise"
            return f"gyro {self.names[worst]} does not agree with the others, {how}: leave it out with --gyros {others}"
        return ""

    def _summarise(self, unit: float) -> tuple[Array, Array, Array]:
        """Mean and RMS of the parity residuals (k,), rad/s, and the RMS in units of their noise; NaN where not known."""
        seen = np.isfinite(self.residuals)
        count = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
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
    read, K = np.asarray(raw, dtype=np.float64), np.asarray(axes, dtype=np.float64)
    if read.ndim != 2 or K.shape != (read.shape[1], 3):
        raise InputError(f"gyros: {read.shape} readings need an axis of three numbers for each gyro, not {K.shape}")
    count = len(K)
    sigma = np.ones(count) if noise is None else np.asarray(noise, dtype=np.float64)
    if sigma.shape != (count,) or not (sigma > 0).all():
        raise InputError(f"gyros: the noise must be {count} positive numbers, one a gyro")
    rates, residuals = np.full((len(read), 3), np.nan), np.full(read.shape, np.nan)
    variance, freedom, power, joined = np.zeros(count), np.zeros(count), 0.0, 0
    seen = np.isfinite(read)
    sets, number = np.unique(seen @ (1 << np.arange(count)), return_inverse=True)
    for which, code in enumerate(sets):
        chosen = np.flatnonzero(code >> np.arange(count) & 1)
        if not measure_all_directions(K[chosen]):
            continue
        rows = np.flatnonzero(number == which)
        weight = sigma.mean() / sigma[chosen]
        G = np.linalg.pinv(K[chosen] * weight[:, None]) * weight
        own = read[np.ix_(rows, chosen)]
        rates[rows] = own @ G.T
        f = 1 - np.sum(K[chosen] * G.T, axis=1)
        told = f > SMALLEST_FREEDOM
        at = chosen[told]
        residuals[np.ix_(rows, at)] = (own - rates[rows] @ K[chosen].T)[:, told] / f[told]
        variance[at] += rows.size * np.square(sigma[at]) / f[told]
        freedom[at] += rows.size * f[told]
        power += rows.size * float(np.sum(np.square(G * sigma[chosen]))) / 3
        joined += rows.size
    if not joined:
        raise InputError("gyros: no row has three gyros that measure all three directions; are their axes as stated?")
    rows_of = np.maximum(np.isfinite(residuals).sum(axis=0), 1)
    return JoinedGyros(
        tuple(str(k + 1) for k in range(count)) if names is None else tuple(names),
        rates,
        float(np.sqrt(power / joined)),
        residuals,
        np.asarray(np.sqrt(variance / rows_of)),
        np.asarray(freedom / rows_of),
    )


def measure_all_directions(axes: Array) -> bool:
    """Whether gyros with these axes (k, 3) measure the rate about all three."""
    if len(axes) < 3:
        return False
    values = np.linalg.svd(axes, compute_uv=False)
    return bool(values[-1] > SMALLEST_SPREAD_RATIO * values[0])
