"""Where a random process acts: the observations of unit errors, and what of them is seen once nuisance parameters are out.

Let C (N, c) hold the whitened observations of a unit error at each of c places: a rate error in a cell, or an error of the
references at an observation. A process of covariance s² K over them adds s² C K Cᵀ to the covariance of the observations. With
P, the projection that takes the nuisance parameters out, and B (c, g) a root of the products of the projected columns,
B Bᵀ = Cᵀ P C, let Bᵀ K B = W Λ Wᵀ. Then the columns

    X = C K B W Λ^−½    have    (P X)ᵀ (P X) = Λ    and    (P X)(P X)ᵀ = P C K Cᵀ P

so that they are orthogonal once projected, each of the power λ, and are together the whole process (put B Bᵀ for Cᵀ P C, and
W Λ Wᵀ for Bᵀ K B). The root depends on the place alone, and each covariance costs one decomposition.

A cell may be longer than a process keeps its value, and the body may turn in it. Its rate errors are taken in a few parts; what
they are together in each of three inertial directions is all that is seen of them once the cell is over.

References are averaged to observations. Within one observation the process is taken at a few of its references, the nodes, and
the body may turn between them. The mean of the errors e_k about one body axis, along u_k in inertial axes, is Σ u_k e_k / n; of
the three singular directions of [u_1 … u_n]/n those that matter are the unit errors of the observation. Where the body hardly
turns that is one, the mean itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse

from gyrocal.arrays import Array, Indices
from simulator.effects.common import markov

if TYPE_CHECKING:
    from diagnosis.model.recording_model import RecordingModel


LEAST_TRACE = 1e-200
ROOT_REGULARISATION = 1e-12  # of the power of all directions of unit errors, added to each: rounding leaves some negative
# Markov processes that stand for all, their time constants from the spacing of the times to the longest interval
TIME_CONSTANTS = 6
# of the power of a process, below which a direction is left out: the log evidence changes by less than 0.02 (tests)
LEAST_SHARE = 3e-4
PARTS = 3  # of a cell, at which a random process is taken
NODES = 4  # references of an observation at which a random process is taken
# Length of a singular direction beside that of an error that stays along one direction, below which it is left out: what it
# leaves out of an error that changes over the observation is the square of it.
LEAST_LENGTH = 0.02


@dataclass(frozen=True)
class ProcessProjection:
    """Observations of unit errors of a random process about one axis."""

    columns: Array  # (N, c) whitened observations of unit errors
    gram: Array  # (c, c) products of the projected columns
    root: Array  # (c, c) root of them
    # (c, q) the unit errors of errors at the times of a covariance; None where the times are those of the unit errors
    mean: scipy.sparse.csr_array | None = None
    # (c,) power along each direction of the root of Markov processes of all time constants, each of the power one in all
    shown: Array | None = None

    @classmethod
    def build_projection(cls, columns: Array, gram: Array, mean: scipy.sparse.csr_array | None = None) -> ProcessProjection:
        """Build the projection from whitened columns (N, c) and the products of the projected ones (c, c)."""
        added = ROOT_REGULARISATION * max(np.trace(gram), LEAST_TRACE)
        try:
            root = np.linalg.cholesky(gram + added * np.eye(len(gram)))
        except np.linalg.LinAlgError:  # nothing of the process is seen, and the products are rounding
            powers, turned = np.linalg.eigh(gram)
            root = turned * np.sqrt(np.maximum(powers, added))
        return cls(columns, gram, root, mean)

    def turn_root(self, t_s: Array, interval: Indices) -> ProcessProjection:
        """Rotate the root to the directions in which Markov processes at given times (q,) show, one after another."""
        spacing = max(float(np.median(np.diff(np.unique(t_s), append=np.max(t_s)))), LEAST_TRACE)
        longest = max(float(np.ptp(t_s[interval == number])) for number in np.unique(interval))
        total, same = np.zeros(self.root.shape), np.equal.outer(interval, interval)
        for tau in np.geomspace(spacing, max(longest, 2 * spacing), TIME_CONSTANTS):
            K = self.covariance(same * markov(t_s, tau))
            total += K / max(float(np.vdot(K, self.gram)), LEAST_TRACE)
        shown, turned = np.linalg.eigh(self.root.T @ total @ self.root)
        return replace(self, root=self.root @ turned, shown=shown)

    def covariance(self, K: Array) -> Array:
        """Compute the covariance (c, c) of the unit errors from that (q, q) at the times of a process."""
        return K if self.mean is None else np.asarray(self.mean @ (self.mean @ K).T)

    def powers(self, K: Array, share: float = 0.0, least: float = 0.0) -> tuple[Array, Callable[[Indices], Array]]:
        """Compute the powers of a process's columns, weakest first, and a function that builds chosen columns; see the module.

        Directions are left out in which a sum of Markov processes has less than the least power, or a share of that of all.
        """
        K = self.covariance(K)
        share = max(share, least / max(float(np.vdot(K, self.gram)), LEAST_TRACE))
        root = self.root if self.shown is None else self.root[:, self.shown > min(share, self.shown[-1] / 2)]
        moved = K @ root
        powers, turned = np.linalg.eigh(root.T @ moved)

        def columns(selected: Indices) -> Array:
            return np.asarray(self.columns @ (moved @ (turned[:, selected] / np.sqrt(powers[selected]))))

        return powers, columns


def split_cells(model: RecordingModel) -> tuple[Indices, Indices]:
    """Split the cells into parts; the first step of each part (q,), and the first part of each cell (c,)."""
    cells = model.cells
    counts = np.minimum(cells.last - cells.first, PARTS)
    first = np.cumsum(np.append(0, counts[:-1]))
    number = np.arange(counts.sum()) - np.repeat(first, counts)
    steps = np.repeat(cells.last - cells.first, counts)
    return np.repeat(cells.first, counts) + number * steps // np.repeat(counts, counts), first


def project_cells(model: RecordingModel) -> tuple[ProcessProjection, ...]:
    """Project rate errors about each body axis, in the parts of the cells."""
    cells, (parts, first) = model.cells, split_cells(model)
    turned = np.add.reduceat(model.to_inertial * model.dt[:, None, None], parts, axis=0)  # (q, inertial, body)
    counts = np.diff(np.append(first, parts.size))
    turned *= np.repeat(counts / cells.duration_s, counts)[:, None, None]
    passed = model.passed_shares
    out = []
    for axis in range(3):
        errors, mean = build_unit_errors(turned[:, :, axis], first)
        cell = np.argmax(np.any(errors.reshape(first.size, 3, -1) != 0, axis=1), axis=0)  # the cell of each unit error
        along = errors.reshape(first.size, 3, -1)[cell, :, np.arange(cell.size)] * cells.duration_s[cell, None]
        columns = model.whiten((passed[:, None, cell] * along.T).reshape(model.size, -1))
        place = ProcessProjection.build_projection(columns, columns.T @ model.project_out_nuisance(columns), mean)
        out.append(place.turn_root(model.t_s[parts], np.repeat(cells.interval, counts)))
    return tuple(out)


def select_nodes(model: RecordingModel) -> tuple[Indices, Indices]:
    """Select up to `NODES` references of each observation, rows (q,); and the first of each observation among them (r,).

    A process that changes while references are averaged has less of it in their mean, and no sharp peak of its covariance.
    """
    counts = np.concatenate([block.counts for block in model.blocks])
    first = model.reference_rows_of_observations - counts // 2
    chosen = [a + np.linspace(0, n - 1, min(n, NODES)).round().astype(np.intp) for a, n in zip(first, counts, strict=True)]
    return np.concatenate(chosen), np.cumsum([0, *(len(nodes) for nodes in chosen[:-1])])


def project_references(model: RecordingModel) -> tuple[ProcessProjection, ...]:
    """Project errors of the references about each body axis, at the nodes."""
    rows, _ = select_nodes(model)
    return tuple(_project_nodes(model, -model.at_reference[rows][:, :, axis]) for axis in range(3))


def project_tags(model: RecordingModel) -> ProcessProjection:
    """Project errors of the references' time tags, at the nodes: one that is tagged late by δt has the error ω δt."""
    rows, _ = select_nodes(model)
    along = -np.einsum("nij,nj->ni", model.at_reference[rows], model.reference_rates[rows])
    return _project_nodes(model, along)


def _project_nodes(model: RecordingModel, along: Array) -> ProcessProjection:
    """Project errors along directions (q, 3) at the nodes."""
    rows, first = select_nodes(model)
    largest = max(float(np.linalg.norm(along, axis=1).max()), LEAST_TRACE)
    errors, mean = build_unit_errors(along / largest, first)
    columns = model.whiten(largest * errors)
    place = ProcessProjection.build_projection(columns, columns.T @ model.project_out_nuisance(columns), mean)
    return place.turn_root(model.references.t_s[rows], model.interval_of_reference[rows])


def build_unit_errors(along: Array, first: Indices) -> tuple[Array, scipy.sparse.csr_array]:
    """Build the unit errors of the observations, (3r, c), and the errors at each node in terms of them, (c, q); see the module.

    An error at a node has the direction `along` (q, 3); `first` (r,) is the first node of each observation.
    """
    counts = np.diff(np.append(first, len(along)))
    places = first[:, None] + np.arange(counts.max())
    is_node = places < (first + counts)[:, None]
    parts = np.where(is_node[:, :, None], along[np.minimum(places, len(along) - 1)], 0.0) / counts[:, None, None]
    U, s, Vt = np.linalg.svd(np.swapaxes(parts, 1, 2), full_matrices=False)  # (r, 3, d), (r, d), (r, d, n)
    block, which = np.nonzero(s * np.sqrt(counts)[:, None] > LEAST_LENGTH)
    numbers = np.arange(block.size)
    errors = np.zeros((3 * first.size, block.size))
    errors[3 * block[:, None] + np.arange(3), numbers[:, None]] = U[block, :, which] * s[block, which][:, None]
    row, node = np.nonzero(is_node[block])
    mean = scipy.sparse.csr_array(
        (Vt[block, which][row, node], (row, places[block][row, node])), shape=(block.size, len(along))
    )
    return errors, mean
