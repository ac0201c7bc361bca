"""Random processes as groups of columns, and those of them that are unlisted rivals.

A process of variance s² K over the cells (or over the references) has K = F Fᵀ, and adds the columns U F with equal,
independent amplitudes of variance s², where U are the observations of a unit error in each cell. Rotated so that the columns
are orthogonal, and cut where they cannot be seen any more, a process is a group like any other
(`diagnosis.inference.evidence`).

Listed processes bring their own covariance (`simulator.effects.base.Effect.covariance`). The unlisted rivals are Markov rate
errors of several time constants, unless a listed process is the same, a level of its own in each interval, processes that
follow the rate, and references that are off by another angle in each interval.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from diagnosis.model.recording import RecordingModel
from simulator.effects.base import ProcessTimes

Array = NDArray[np.float64]

AXES = "xyz"
SEEN = 1e-4  # power relative to the strongest column, below which a column is left out
# Near the smallest size that can be detected, a column of power λ adds to the expected evidence in proportion to λ². A larger
# process of slow variations shows in its weaker columns too.
INFORMATION = 0.95  # share of Σ λ² that the columns have together at least
WHOLE = 0.02  # variance of a column beside that of the noise, from which on it counts where the whole process is wanted
USUAL_COLUMNS = 72  # that are kept whatever they share
MOST_COLUMNS = 400
ALIKE = 0.95  # cosine of two covariances from which on they are one process


@dataclass(frozen=True)
class Process:
    """A random discrepancy about one axis.

    Attributes
    ----------
    name : what it does, in words
    axis : body axis
    columns : per option (N, r) whitened columns of unit amplitude, orthogonal once projected
    """

    name: str
    axis: str
    columns: list[Array]


def cell_times(model: RecordingModel) -> ProcessTimes:
    """Times of the cells, for a process of the rates."""
    cells = model.cells
    return ProcessTimes(t_s=cells.t_s, run_s=cells.run_s, interval=cells.interval)


def reference_times(model: RecordingModel) -> ProcessTimes:
    """Times of the observations, for a process of the references."""
    return _times(model, model.observation_t_s, model.observation_block)


def reference_nodes(model: RecordingModel) -> tuple[ProcessTimes, NDArray[np.intp]]:
    """Times of some references of each observation, and the first of each observation among them."""
    rows, owner = model.nodes
    return _times(model, model.references.t_s[rows], model.interval_of_reference[rows]), owner


def _times(model: RecordingModel, t_s: Array, interval: NDArray[np.intp]) -> ProcessTimes:
    """Times with those that ran while the gyro was sampled, the gaps between the intervals left out."""
    ends = np.cumsum([0.0, *(float(block.elapsed_s[-1]) for block in model.blocks)])
    begins = np.array([t_s[interval == number][0] for number in range(len(model.blocks))])
    return ProcessTimes(t_s=t_s, run_s=t_s - begins[interval] + ends[interval], interval=interval)


def averaged(K: Array, first: NDArray[np.intp]) -> Array:
    """(r, r) covariance of the means of consecutive nodes, from that of the nodes (q, q)."""
    if len(first) == len(K):
        return K
    counts = np.diff(np.append(first, len(K)))
    sums = np.add.reduceat(np.add.reduceat(K, first, axis=0), first, axis=1)
    return np.asarray(sums / np.outer(counts, counts))


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


def orthogonal(columns: Array, gram: Array, F: Array, least: float | None = None) -> Array:
    """Whitened columns C F turned so that they are orthogonal once projected, without those that cannot be seen.

    Parameters
    ----------
    columns : (N, c) whitened columns C
    gram : (c, c) their products once projected
    F : (c, k) factor of the covariance
    least : power of a column that is kept, where the whole process is wanted at a known scale; by default its strongest columns
    """
    if not F.shape[1]:  # a covariance of zero, such as that of a walk over cells of one time
        return columns[:, :0]
    if least is not None:
        return whole(columns, gram, F, least)
    moved = F.T @ gram @ F
    information = INFORMATION * float(np.sum(moved**2))
    # Divide and conquer finds all eigenvectors in a quarter of the time that others need for the strongest alone.
    values, vectors = np.linalg.eigh(moved)
    values, vectors = values[-MOST_COLUMNS:], vectors[:, -MOST_COLUMNS:]
    kept = np.flatnonzero(values > SEEN * max(values[-1], 1e-300))[::-1]
    enough = int(np.searchsorted(np.cumsum(values[kept] ** 2), information)) + 1
    kept = kept[: max(enough, USUAL_COLUMNS)]
    return np.asarray(columns @ (F @ vectors[:, kept]))


def whole(columns: Array, gram: Array, F: Array, least: float | None = None) -> Array:
    """All columns C F that can be seen, orthogonal once projected; parameters as for `orthogonal`, one at least.

    Where no scale is known, and `least` is None, those that can be seen beside the strongest.
    """
    if not F.shape[1]:
        return columns[:, :0]
    moved = F.T @ gram @ F
    # Checks draw data of the few processes that are named, which go with the signs of the vectors: they stay as they were.
    values, vectors = scipy.linalg.eigh(moved, subset_by_index=[0, len(moved) - 1], check_finite=False)
    kept = np.flatnonzero(values > (SEEN * values[-1] if least is None else least))[::-1]
    return np.asarray(columns @ (F @ vectors[:, kept if kept.size else [-1]]))


def on_cells(model: RecordingModel, axis: int, F: Array, least: float | None = None) -> Array:
    """(N, r) columns of rate errors F (c, k) over the cells."""
    return orthogonal(model.cell_columns[axis], model.cell_grams[axis], F, least)


def on_references(model: RecordingModel, axis: int, F: Array, least: float | None = None) -> Array:
    """(N, r) columns of reference errors F (r, k) at the observations."""
    return orthogonal(model.reference_columns[axis], model.reference_grams[axis], F, least)


def on_nodes(model: RecordingModel, axis: int, F: Array, least: float | None = None) -> Array:
    """(N, r) columns of reference errors F (q, k) at the nodes of a body that turns while references are averaged."""
    return orthogonal(model.node_columns[axis], model.node_grams[axis], F, least)


def is_one_of(K: Array, known: Sequence[Array]) -> bool:
    """Whether a covariance is that of a process among others, but for its size."""
    return any(float(np.sum(K * one)) > ALIKE * float(np.linalg.norm(K) * np.linalg.norm(one)) for one in known)


def unlisted(model: RecordingModel, known: Sequence[Array] = ()) -> Iterator[Process]:
    """Random discrepancies that are on no list, about each axis.

    Parameters
    ----------
    model : of the recording
    known : covariances over the cells of processes of the rates that are on the list: a rival is something else
    """
    cells = model.cells
    longest = max(float(block.elapsed_s[-1]) for block in model.blocks)
    w = np.add.reduceat(model.rates * model.dt[:, None], cells.first, axis=0) / cells.duration_s[:, None]
    separate = same(cells.interval)
    wandering = [separate * markov(cells.t_s, tau) for tau in (longest / 60, longest / 20, longest / 6)]
    fast, slow = [factor(K) for K in wandering if not is_one_of(K, known)], factor(wandering[-1])
    levels = factor(separate)
    level_each, slow_each = [], []
    for other in range(3):
        level_each.append(levels * w[:, [other]])
        slow_each.append(slow * w[:, [other]])
    offsets = factor(np.deg2rad(1.0) * same(model.observation_block))
    for axis, name in enumerate(AXES):
        for words, factors in (
            ("random bias, correlated in time", fast),
            ("bias differs between intervals", [levels]),
            ("scale factor or misalignment differs between intervals", level_each),
            ("scale factor or misalignment wanders", slow_each),
        ):
            if factors:
                yield Process(words, name, [on_cells(model, axis, F) for F in factors])
        yield Process("references offset differently in each interval", name, [on_references(model, axis, offsets)])
