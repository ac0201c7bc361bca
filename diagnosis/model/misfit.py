"""Whether M0 leaves of all references what it should: white innovations of variance one.

The candidates of a diagnosis are seen in at most `MOST_OBSERVATIONS` attitudes, to which neighbouring references are averaged,
and each looks for something in particular. What is faster than that, or like none of them, has to show as well. So every
reference is compared with the attitude that the gyro has carried on from those before it: under M0 the residuals ζ of an
interval are a random walk, the gyro's integrated noise, seen with the references' white noise, and its start is unknown. The
innovations of a Kalman filter that starts from the interval's first reference,

    v_k = ζ_k − x,    S = P + ΔW_k + R_k,    e_k = L⁻¹ v_k  (L Lᵀ = S),    x ← x + K v_k,    K = (P + ΔW_k) S⁻¹,

are N(0, I) and independent (Kailath, IEEE Transactions on Automatic Control 13, 1968); those of the columns of G and b are
projected out of them. G turns the readings' errors into those of the rates and has an inverse, so that the columns may be
those of either. The distribution of the innovations being known, each statistic has its p-value without draws: the sum of
squares is χ², the share of one interval in it has a beta distribution, the Fourier coefficients exponential ones, and sums of
products are normal.

Recordings of several sensors have differences between these in place of it (`diagnosis.model.trackers`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from diagnosis.answer import Finding
from diagnosis.inference.checks import Check
from diagnosis.model.layout import motion
from diagnosis.model.recording import RANK, RecordingModel, parameter_errors
from gyrocal.compiled import compiled
from gyrocal.small_matrices import root, under
from simulator.effects.base import Effect, Value

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]

AXES = "xyz"
FEWEST = 30  # innovations, below which nothing is said
SAYS = {  # of each statistic, with its value and what is expected
    "size": "the innovations of all references have a χ² of {value:.4g} for {expected:.4g} degrees of freedom",
    "largest": "the largest innovation of all references is {value:.3g} sigma, where {expected:.3g} would be usual",
    "variance over the intervals": "its innovations have {value:.3g} times their share of the power of all",
    "shape": "the innovations of all references have a kurtosis of {value:.3g}, where normal ones have {expected:.3g}",
    "correlation in time": "the innovations of all references correlate in time: χ² {value:.4g} for {expected:.4g}",
    "line of any period": "the innovations of all references have a line of {value:.3g} times their mean power",
    "variance with the rate": "the power of the innovations of all references changes with the rate: {value:.3g} sigma",
    "dependence on the motion": "the innovations of all references follow the motion: χ² {value:.4g} for {expected:.4g}",
}
LAGS = 6
SHORTEST = 16  # innovations of an interval, from which on lines are looked for in it
FOLLOWS = 1e-3  # share of a motion that must be left beside the parameters, for the innovations to follow it
TINY = 1e-300


@dataclass(frozen=True)
class Departure(Check):
    """A statistic of the innovations, and where it is strongest: interval, axis and time since its start, if it has one."""

    interval: str | None = None
    axis: int | None = None
    since_s: float | None = None


def misfit(model: RecordingModel, beside: Sequence[Array] = ()) -> tuple[Departure, ...]:
    """Statistics of M0's innovations of all references; none where there are too few, or several sensors.

    Parameters
    ----------
    model : of the recording, about its calibration under M0
    beside : (m, 3, k) attitude errors that are estimated with G and b, such as those of a named effect
    """
    if model.recording.attitudes.sensor is not None:
        return ()
    e, later, taken = innovations(model, beside)
    dof = e.size - taken.shape[1]
    if dof < FEWEST:
        return ()
    owner = model.interval_of_reference[later]
    total = float(np.sum(e**2))
    ratio, p_share, number, axis = _over_intervals(e, owner)
    row, of_largest = np.unravel_index(int(np.argmax(np.abs(e))), e.shape)
    rates, change = (values[later] for values in motion(model, model.reference_rows, model.interval_of_reference))
    plain = {
        "size": (total, float(dof), _two_sided(scipy.stats.chi2(dof), total)),
        "shape": _shape(e),
        "correlation in time": _correlation(e, owner),
        "line of any period": _line(e, owner),
        "variance with the rate": _with_rate(e, np.linalg.norm(rates, axis=1)),
        "dependence on the motion": _on_motion(e, np.column_stack([rates, np.abs(rates), change]), taken),
    }
    return (
        *(Departure(name, value, expected, max(p, TINY)) for name, (value, expected, p) in plain.items()),
        Departure("variance over the intervals", ratio, 1.0, max(p_share, TINY), _name(model, number), axis),
        Departure("largest", *_largest(e), _name(model, owner[row]), int(of_largest), _since(model)[later][row]),
    )


def finding(checks: Sequence[Departure], event_p: float) -> tuple[Finding, ...]:
    """What the statistics say that speak, for the list of where a recording departs; p-values with an allowance for all."""
    return tuple(
        Finding(
            "attitude", one.interval, None if one.axis is None else AXES[one.axis],
            None, one.name, one.value, min(1.0, one.p_value * len(checks)),
            f"{_place(one)}{SAYS[one.name].format(value=one.value, expected=one.expected)}",
        )
        for one in checks
        if one.p_value * len(checks) < event_p
    )  # fmt: skip


def _place(one: Departure) -> str:
    """Where, as the beginning of a sentence."""
    if one.interval is None or one.axis is None:
        return ""
    when = "" if one.since_s is None else f", {one.since_s:.0f} s after its start"
    return f"{one.interval}, axis {AXES[one.axis]}{when}: "


def _name(model: RecordingModel, block: int) -> str:
    """Of the interval that a block is, or is a part of."""
    return model.recording.intervals[model.blocks[block].interval].name


def _since(model: RecordingModel) -> Array:
    """(m,) time of each reference since its block's start, s."""
    return np.concatenate([block.elapsed_s for block in model.blocks])


def errors_of(model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value]) -> Array:
    """(m, 3, k) attitude errors of an effect with columns at every reference, inertial axes."""
    if effect.on_references:
        return -np.matmul(model.at_reference, effect.reference_columns(model.references, axis, parameters))
    return model.turned_by(effect.columns(model.stream, axis, parameters))


def innovations(model: RecordingModel, beside: Sequence[Array] = ()) -> tuple[Array, Mask, Array]:
    """White innovations about the body axes (k, 3), whose they are (m,), and (3k, q) a basis of what the fit took."""
    left, later, U = innovations_of(model, model.residuals[:, :, None], beside)
    return left.reshape(-1, 3), later, U


def innovations_of(model: RecordingModel, errors: Array, beside: Sequence[Array] = ()) -> tuple[Array, Mask, Array]:
    """The same of any attitude errors at every reference, inertial axes: (m, 3, c) → (3k, c)."""
    count = errors.shape[2]
    white, later = whitened(model, np.concatenate([errors, model.turned_by(parameter_errors(model.raw)), *beside], axis=2))
    y, U = white[:, :count], basis(white[:, count:])
    return np.asarray(y - U @ (U.T @ y)), later, U


def whitened(model: RecordingModel, columns: Array) -> tuple[Array, Mask]:
    """Attitude errors at every reference, inertial axes, (m, 3, c), as innovations about the body axes (3k, c); whose (m,)."""
    first = np.diff(model.interval_of_reference, prepend=-1) != 0
    added = np.diff(model.walk, axis=0, prepend=model.walk[:1])
    added[first] = 0.0
    white = _whitened(columns, added, model.errors, first)[~first]
    body = np.matmul(model.at_reference[~first].transpose(0, 2, 1), white)
    return body.reshape(3 * len(body), -1), ~first


def basis(columns: Array) -> Array:
    """Orthonormal basis of columns (n, c), without what adds nothing to the others."""
    U, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), TINY), full_matrices=False)
    return np.asarray(U[:, s > RANK * s[0]])


def _two_sided(distribution: scipy.stats.rv_continuous, value: float) -> float:
    return float(min(1.0, 2 * min(distribution.sf(value), distribution.cdf(value))))


def _largest(e: Array) -> tuple[float, float, float]:
    """Of the sizes of all numbers."""
    value = float(np.abs(e).max())
    expected = float(scipy.stats.norm.isf(0.5 * (1 - 0.5 ** (1 / e.size))))
    return value, expected, max(float(-np.expm1(e.size * np.log1p(-2 * scipy.stats.norm.sf(value)))), TINY)


def _over_intervals(e: Array, owner: Indices) -> tuple[float, float, int, int]:
    """Oddest share of the power that a block has about an axis, over that of its numbers; its p-value, block and axis."""
    total, found = float(np.sum(e**2)), []
    for number in np.unique(owner):
        count = int(np.sum(owner == number))
        if 3 * count == e.size:
            continue
        share = scipy.stats.beta(0.5 * count, 0.5 * (e.size - count))
        own = np.sum(e[owner == number] ** 2, axis=0) / total
        found += [(_two_sided(share, float(own[k])), float(own[k]) * e.size / count, int(number), k) for k in range(3)]
    p, ratio, block, axis = min(found, default=(1.0, 1.0, 0, 0))
    return ratio, min(1.0, p * len(found)) if found else 1.0, block, axis


def _shape(e: Array) -> tuple[float, float, float]:
    """Kurtosis; Anscombe and Glynn, Biometrika 70, 1983."""
    values = e.ravel()
    return float(scipy.stats.kurtosis(values, fisher=False)), 3.0, float(scipy.stats.kurtosistest(values).pvalue)


def _correlation(e: Array, owner: Indices) -> tuple[float, float, float]:
    """Square sum of the correlations at some lags about each axis, each over its own scatter."""
    total, count = 0.0, 0
    for lag in range(1, LAGS + 1):
        products = (e[lag:] * e[:-lag])[owner[lag:] == owner[:-lag]]
        if len(products) < FEWEST:
            continue
        total += float(np.sum(products.sum(axis=0) ** 2 / np.sum(products**2, axis=0)))
        count += 3
    return total, float(count), float(scipy.stats.chi2.sf(total, count)) if count else 1.0


def _line(e: Array, owner: Indices) -> tuple[float, float, float]:
    """Strongest Fourier coefficient of any interval and axis, as power over the mean; that at half the rate is χ²(1)."""
    variance = float(np.mean(e**2))
    best, count, tried = 1.0, 0, 0.0
    for number in np.unique(owner):
        own = e[owner == number]
        if len(own) < SHORTEST:
            continue
        power = np.abs(np.fft.rfft(own - own.mean(axis=0), axis=0)[1:]) ** 2 / (len(own) * variance)
        p = np.exp(-power)
        if len(own) % 2 == 0:
            p[-1] = scipy.stats.chi2.sf(power[-1], 1)
        count += p.size
        best, tried = min(best, float(p.min())), max(tried, float(power.max()))
    return tried, float(np.log(max(count, 1))), float(-np.expm1(count * np.log1p(-best))) if best < 1 else 1.0


def _with_rate(e: Array, rate: Array) -> tuple[float, float, float]:
    """Slope of the squares over the rate, in its own sigmas: of numbers with the variance 2 v², v their mean."""
    weights = rate - rate.mean()
    if np.sum(weights**2) ** 2 < FEWEST * np.sum(weights**4):  # of a few references alone, which are not normal together
        return 0.0, 0.0, 1.0
    squares = np.sum(e**2, axis=1)
    z = float(np.sum(weights * squares) / np.sqrt(2 / 3 * np.sum(weights**2)) / np.mean(squares))
    return z, 0.0, float(2 * scipy.stats.norm.sf(abs(z)))


def _on_motion(e: Array, motion: Array, taken: Array) -> tuple[float, float, float]:
    """Square sum of the innovations' part that follows the motion, in units of their variance."""
    centred = motion - motion.mean(axis=0)
    X = np.kron(centred / np.maximum(np.linalg.norm(centred, axis=0), TINY), np.eye(3))
    U, s, _ = np.linalg.svd(X - taken @ (taken.T @ X), full_matrices=False)
    U = U[:, s > FOLLOWS]
    value, count = float(np.sum((U.T @ e.ravel()) ** 2) / np.mean(e**2)), U.shape[1]
    return value, float(count), float(scipy.stats.chi2.sf(value, count)) if count else 1.0


@compiled
def _whitened(z: Array, added: Array, R: Array, first: Mask) -> Array:  # pragma: no cover - compiled
    """(m, 3, k) innovations over their root covariance, column by column; zero at the first reference of each interval."""
    out = np.zeros(z.shape)
    P, x = np.zeros((3, 3)), np.zeros((3, z.shape[2]))
    for k in range(len(z)):
        if first[k]:
            P, x = R[k].copy(), z[k].copy()
            continue
        P = P + added[k]
        S = P + R[k]
        L = root(S)
        white, half = under(L, z[k] - x), under(L, P)  # K v = (L⁻¹P)ᵀ L⁻¹v, and K P = (L⁻¹P)ᵀ L⁻¹P
        out[k] = white
        for i in range(3):
            for a in range(3):
                for j in range(x.shape[1]):
                    x[i, j] += half[a, i] * white[a, j]
                for j in range(3):
                    P[i, j] -= half[a, i] * half[a, j]
    return out
