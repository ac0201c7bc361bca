"""Random discrepancies as groups of columns: Gaussian processes in time, on the rates or on the references.

A process with covariance s² K over the cells (or references) has K = F Fᵀ, and adds the columns U F with equal, independent
amplitudes of variance s², where U are the observations of a unit error in each cell. Rotated so that the columns are
orthogonal, and cut where they cannot be seen any more, a process is a group like any other (`diagnosis.inference.evidence`).

Named processes: the rate random walk (R(t, t') = min), flicker noise (a sum of first-order Markov processes an octave apart,
whose spectrum is 1/f between them), a correlated reference error (first-order Markov). Rivals: Markov rate errors that are
faster or slower, a level of its own in each interval, processes that follow the rate, correlated references about all axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.recording import Model

Array = NDArray[np.float64]

AXES = "xyz"
HOUR = 3600.0
DEG_H = float(np.deg2rad(1 / HOUR))  # rad/s
SEEN = 1e-4  # power relative to the strongest column below which a column is left out
MOST_COLUMNS = 96
OCTAVES = 2.0 ** np.arange(5, 19)  # s: time constants of the Markov processes that make up flicker noise


@dataclass(frozen=True)
class Process:
    """A random discrepancy about one axis.

    Attributes
    ----------
    name : effect, or the rival in words
    axis : body axis
    listed : whether it is an effect a diagnosis may name
    columns : per option (N, r) whitened columns of unit amplitude, orthogonal once projected
    parameters : per option
    """

    name: str
    axis: str
    listed: bool
    columns: list[Array]
    parameters: list[dict[str, float | str]]


def markov(t: Array, tau: float) -> Array:
    """Covariance of a first-order Markov process of unit variance at times t."""
    return np.asarray(np.exp(-np.abs(np.subtract.outer(t, t)) / tau))


def same(labels: NDArray[np.intp]) -> Array:
    """One where two belong together."""
    return np.equal.outer(labels, labels).astype(float)


def random_walk(model: Model, gaps: str) -> Array:
    """Covariance of a rate random walk over the cells, (deg/h)² per (deg/h/√h)², in (rad/s)².

    The level at the first sample is free in M0 anyway. Over the gaps between intervals the walk holds still, goes on, or
    each interval starts at a level of its own, in proportion to its length.
    """
    cells = model.cells
    t = {"hold": cells.run_s, "grow": cells.t_s, "reset": cells.run_s}[gaps]
    t = (t - t.min()) / HOUR
    if gaps == "reset":
        within = np.array([t[cells.interval == k].min() for k in cells.interval])
        K = same(cells.interval) * np.minimum.outer(t - within, t - within)
        return np.asarray((K + 0.5 * same(cells.interval) * np.ptp(t) / len(model.blocks)) * DEG_H**2)
    return np.asarray(np.minimum.outer(t, t) * DEG_H**2)


def flicker(t: Array, longest: float) -> Array:
    """Covariance of flicker noise of unit bias instability, deg/h, in (rad/s)².

    Markov processes an octave apart with variance v each have spectra v 2τ/(1 + (ωτ)²) that sum to v π/(ω ln 2) = v/(2 f ln 2)
    between the longest and the shortest. Two-sided, bias instability B is S(f) = B²/(2π f), so v = B² ln 2/π.
    IEEE Std 952, annex C.
    """
    total = np.zeros((len(t), len(t)))
    for tau in OCTAVES[8 * longest > OCTAVES]:
        total += markov(t, float(tau))
    return np.asarray(total * np.log(2) / np.pi * DEG_H**2)


def factor(K: Array) -> Array:
    """F with F Fᵀ = K, without its invisible part; (c, r)."""
    values, vectors = np.linalg.eigh(K)
    kept = values > 1e-7 * values[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))


def orthogonal(model: Model, columns: Array, F: Array) -> Array:
    """Whitened columns C F turned so that they are orthogonal once projected, without those that cannot be seen."""
    seen = model.projected(columns @ F)
    values, vectors = np.linalg.eigh(seen.T @ seen)
    kept = np.flatnonzero(values > SEEN * max(values[-1], 1e-300))[::-1][:MOST_COLUMNS]
    return np.asarray(columns @ (F @ vectors[:, kept]))


def on_cells(model: Model, axis: int, F: Array) -> Array:
    """(N, r) columns of rate errors F (c, r) over the cells."""
    return orthogonal(model, model.cell_columns[axis], F)


def on_references(model: Model, axis: int, F: Array) -> Array:
    """(N, r) columns of reference errors F (m, r)."""
    return orthogonal(model, model.reference_columns[axis], F)


def processes(model: Model, rivals: bool = True) -> Iterator[Process]:
    """All random discrepancies; every process exists for each axis."""
    cells, references = model.cells, model.references
    longest = max(float(block.elapsed_s[-1]) for block in model.blocks)
    spacing = float(np.median(np.diff(references.t_s)[np.diff(model.interval_of_reference) == 0]))
    walks = {gaps: factor(random_walk(model, gaps)) for gaps in ("hold", "reset")}
    pink = factor(flicker(cells.run_s, longest))
    separate = same(model.interval_of_reference)
    taus = [
        tau for tau in (1.5 * spacing, 3 * spacing, 6 * spacing, 12 * spacing, 24 * spacing, 48 * spacing) if tau < 2 * longest
    ]
    correlated = {tau: np.deg2rad(1.0) * factor(separate * markov(references.t_s, tau)) for tau in taus}
    for axis, name in enumerate(AXES):
        columns = [on_cells(model, axis, F) for F in walks.values()]
        yield Process("bias_random_walk", name, True, columns, [{"gaps": gaps} for gaps in walks])
        yield Process("noise_flicker", name, True, [on_cells(model, axis, pink)], [{}])
        if correlated:
            columns = [on_references(model, axis, F) for F in correlated.values()]
            yield Process("reference_correlated", name, True, columns, [{"time_constant_s": tau} for tau in correlated])
    if rivals:
        yield from _rivals(model, longest)


def _rivals(model: Model, longest: float) -> Iterator[Process]:
    cells = model.cells
    w = np.add.reduceat(model.rates * model.dt[:, None], cells.first, axis=0) / cells.duration_s[:, None]
    separate = same(cells.interval)
    fast = [factor(separate * markov(cells.t_s, tau)) for tau in (longest / 60, longest / 20, longest / 6)]
    levels = [factor(separate)]
    for axis, name in enumerate(AXES):
        rates: list[tuple[str, list[Array]]] = [
            ("random bias, correlated in time", fast),
            ("bias differs between intervals", levels),
        ]
        following = []
        for other in range(3):
            following += [levels[0] * w[:, [other]], fast[2] * w[:, [other]]]
        rates.append(("scale factor or misalignment differs between intervals", following[0::2]))
        rates.append(("scale factor or misalignment wanders", following[1::2]))
        for words, factors in rates:
            columns = [on_cells(model, axis, F) for F in factors]
            yield Process(words, name, False, columns, [{}] * len(columns))
    body = np.deg2rad(1.0) * same(model.interval_of_reference)
    offsets = factor(body)
    for axis, name in enumerate(AXES):
        yield Process(
            "references offset differently in each interval", name, False, [on_references(model, axis, offsets)], [{}]
        )
