"""Random discrepancies as groups of columns: Gaussian processes in time, on the rates or on the references.

A process with covariance s² K over the cells (or references) has K = F Fᵀ, and adds the columns U F with equal, independent
amplitudes of variance s², where U are the observations of a unit error in each cell. Rotated so that the columns are
orthogonal, and cut where they cannot be seen any more, a process is a group like any other (`diagnosis.inference.evidence`).

Named processes are the effects with a covariance. Rivals: Markov rate errors that are
faster or slower, a level of its own in each interval, processes that follow the rate, correlated references about all axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagnosis.model.recording import Model
from simulator.effects import EFFECTS, ProcessTimes

Array = NDArray[np.float64]

AXES = "xyz"
SEEN = 1e-4  # power relative to the strongest column below which a column is left out
MOST_COLUMNS = 96


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
    cells = model.cells
    longest = max(float(block.elapsed_s[-1]) for block in model.blocks)
    on_rates = ProcessTimes(cells.t_s, cells.run_s, cells.interval)
    at_references = ProcessTimes(model.references.t_s, _run_at_references(model), model.interval_of_reference)
    for effect in EFFECTS.values():
        trials = effect.trials(model.around) if effect.is_process and effect.missing(model.around) is None else ()
        if not trials:
            continue
        parameters = [dict(trial.parameters) for trial in trials]
        factors = [factor(effect.covariance(at_references if effect.on_references else on_rates, one)) for one in parameters]
        observed = on_references if effect.on_references else on_cells
        for axis, name in enumerate(AXES):
            yield Process(effect.name, name, True, [observed(model, axis, F) for F in factors], parameters)
    if rivals:
        yield from _rivals(model, longest)


def _run_at_references(model: Model) -> Array:
    """(m,) sampled time at each reference, the gaps between the intervals left out."""
    before = np.cumsum([0.0] + [float(block.elapsed_s[-1]) for block in model.blocks])
    return np.concatenate([start + block.elapsed_s for start, block in zip(before[:-1], model.blocks, strict=True)])


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
