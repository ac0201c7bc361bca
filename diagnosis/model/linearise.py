"""Linearise a recording (`diagnosis.model.recording_model`): propagation, steps, averages, covariance.

Long recordings are condensed in two ways, neither of which touches the propagation itself. Columns are computed on *steps*,
each of one or more samples with their mean rate, of which there are at most `MOST_STEPS`. Where there are more than
`MOST_OBSERVATIONS` references, neighbouring ones are averaged to one observation; with W_i the covariance of g at the i-th of n
references that are averaged (counted from zero), the mean has the walk covariance Σ_i (2(n − i) − 1) W_i/n², and its covariance
with any later observation is Σ_i W_i/n.

Where the propagated attitude is too far from the references, the recording is linearised along another path. With A the true
and A_prop the propagated attitude, Aᵀ = E A_propᵀ, and E = exp([ζ×]) obeys Ė Eᵀ = [(Aᵀ δω)×] exactly, δω being the error of the
calibrated rates. The integral of Aᵀ δω, which is linear in δω once the path is known, therefore is the sum of the small turns
of E,

    z_k = Σ_{j<k} log(S_{j+1} S_jᵀ) + log(E_k S_kᵀ),

with S_j a path near E. First order in ζ gives ζ itself, which misses half the square of it: 0.9 deg for 10 deg. The sum misses
half the square of what a reference is off the path S. That is a moving average of ζ over as many references as bring their
noise to a small part of ζ, since noise in S adds up as ½ Σ ε_j × ε_{j+1}.

Source of the kinematics: Natanson (1998), (14) to (16); the sum is the integral of the left Jacobian of SO(3) times ζ̇.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.ndimage
from scipy.spatial.transform import Rotation

from diagnosis.model.recording_model import Block, RecordingModel
from gyrocal.arrays import Array, Indices
from gyrocal.calibration.propagation import Arcs, propagate
from gyrocal.calibration.sampling import Measurements, prepare_measurements
from gyrocal.recording import Interval, Recording, find_reference_rows

MOST_STEPS = 60_000  # steps on which columns are made
MOST_OBSERVATIONS = 500  # attitudes that enter the model; its cost grows with the square of them
FEWEST_OBSERVATIONS = 10  # of an interval that are left by averaging; with few of them its motion would be lost

SMALL = 0.3  # sigmas of a reference in half the square of ζ, up to which first order is enough
NOISE = 0.05  # of the largest ζ, that the noise of the path may be
WIDEST = 0.2  # of the references of an interval in an average


class _IntervalArrays(NamedTuple):
    """Arrays of an interval that are joined to those of a `RecordingModel` with the same names."""

    t_s: Array
    dt: Array
    raw: Array
    to_inertial: Array
    at_reference: Array
    zeta: Array
    residuals: Array
    off: Array
    errors: Array
    walk: Array


def linearise_recording(
    recording: Recording,
    G: Array,
    bias: Array,
    rates: Array | None = None,
    smooth: Array | None = None,
    density: Array | None = None,
    pieces: Sequence[Interval] | None = None,
    sigma: Array | None = None,
) -> RecordingModel:
    """Linearise a recording about a calibration.

    Parameters
    ----------
    recording : gyro stream and reference attitudes
    G, bias : (3, 3), (3,) rad/s: the parameters to linearise about, usually calibrated under M0
    rates : (samples, 3) raw rates in place of the recording's own, such as repaired ones
    smooth : (samples, 3) the same without noise, for the columns; a column that holds the noise of the residuals explains it
    density : (samples, 3) noise density of the raw rates in place of the stated ARW², rad²/s
    pieces : intervals to propagate over in place of the recording's own
    sigma : (references, 3) sigma of the references in place of the stated one, rad
    """
    parts, row_of = _measure_pieces(recording, pieces)
    stream = recording.gyro.rates if rates is None else rates
    motion = stream if smooth is None else smooth
    sigmas = recording.attitudes.sigma if sigma is None else sigma
    tags = recording.gyro.t_s
    references_per_observation = max(1, -(-parts.row.size // MOST_OBSERVATIONS))
    edges, first, last, arc = _choose_steps(parts)
    run = propagate(Arcs(stream, parts.arcs.dt, parts.arcs.sample, first, last, arc), G, bias)
    blocks: list[Block] = []
    arrays: list[_IntervalArrays] = []
    rows = steps = 0
    for number, interval_edges in enumerate(edges):
        outputs = np.flatnonzero(parts.arcs.arc == number)
        references = row_of[np.append(parts.start[outputs[0]], parts.row[outputs])]
        width = max(1, min(references_per_observation, references.size // FEWEST_OBSERVATIONS))
        groups = np.arange(0, references.size, width)
        samples = parts.arcs.sample[interval_edges[0] : interval_edges[-1]]
        dt = parts.arcs.dt[interval_edges[0] : interval_edges[-1]]
        begin = interval_edges[:-1] - interval_edges[0]
        length = np.add.reduceat(dt, begin)
        raw = np.add.reduceat(motion[samples] * dt[:, None], begin, axis=0) / length[:, None]
        angles = np.add.reduceat(stream[samples] * dt[:, None], begin, axis=0) @ G.T + np.outer(length, bias)
        start = Rotation.from_quat(recording.attitudes.quaternions[references[0]])  # as a matrix, Aᵀ
        turned = run.R[arc == number]
        A_T = start.as_matrix() @ np.concatenate([np.eye(3)[None], turned.transpose(0, 2, 1)])
        middle = A_T[:-1] @ Rotation.from_rotvec(0.5 * angles).as_matrix()
        ends = np.searchsorted(interval_edges, np.append(interval_edges[0], parts.arcs.last[outputs]))
        at = A_T[ends]
        observed = Rotation.from_quat(recording.attitudes.quaternions[references]).inv()
        theta = (observed * Rotation.from_matrix(at)).as_rotvec()
        off = -np.einsum("mij,mj->mi", at, theta)
        path, zeta = find_relinearised_path(off, sigmas[references]), off
        if path is not None:
            zeta, turns = path
            at, middle = Rotation.from_rotvec(turns).as_matrix() @ at, interpolate_turns(turns, ends) @ middle
        elapsed = np.append(0.0, parts.elapsed_s[outputs])
        begin_s = tags[samples[0]] + (recording.attitudes.t_s[references[0]] - tags[samples[0]])  # where the first step begins
        t_s = begin_s + np.cumsum(length) - 0.5 * length
        if density is None:
            walk = recording.gyro.arw**2 * elapsed[:, None, None] * np.eye(3)
        else:
            power = np.add.reduceat(density[samples] * dt[:, None], begin, axis=0)
            walk = _accumulate_gyro_noise(middle @ G, power, ends)
        error_axes = recording.attitudes.select_rows(references).build_error_axes(sigmas[references])
        axes = at if error_axes is None else at @ error_axes
        errors = np.einsum("mij,mj,mkj->mik", axes, sigmas[references] ** 2, axes)
        V = _build_interval_covariance(errors, walk, groups)
        whitener = np.asarray(np.linalg.cholesky(V))
        times = recording.attitudes.t_s[references]
        middle_time = 0.5 * (times.min() + times.max())
        interval = next(k for k, entry in enumerate(recording.intervals) if entry.start_s <= middle_time <= entry.stop_s)
        stop = rows + 3 * groups.size
        block = Block(
            interval, slice(steps, steps + begin.size), slice(rows, stop), references, ends, elapsed, groups, whitener
        )
        means = block.average_references(zeta).ravel()
        arrays.append(_IntervalArrays(t_s, length, raw, middle, at, means, zeta, off, errors, walk))
        blocks.append(block)
        rows, steps = stop, steps + begin.size
    joined = _IntervalArrays(*(np.concatenate(values) for values in zip(*arrays, strict=True)))
    return RecordingModel(recording, G, bias, rates=joined.raw @ G.T + bias, blocks=tuple(blocks), **joined._asdict())


def _choose_steps(parts: Measurements) -> tuple[list[Indices], Indices, Indices, Indices]:
    """Choose the edges of the steps of each arc among its samples; also first and last sample and arc of each step."""
    samples_per_step = max(1, -(-parts.arcs.dt.size // MOST_STEPS))
    edges, firsts, lasts, arcs = [], [], [], []
    for number in range(int(parts.arcs.arc[-1]) + 1):
        outputs = np.flatnonzero(parts.arcs.arc == number)
        low, stops = int(parts.arcs.first[outputs[0]]), parts.arcs.last[outputs]
        # Steps are counted again from every reference, so that none crosses one.
        between = [np.arange(a, b, samples_per_step) for a, b in pairwise([low, *stops.tolist()])]
        interval_edges = np.append(np.concatenate(between), stops[-1])
        edges.append(interval_edges)
        firsts.append(interval_edges[:-1])
        lasts.append(interval_edges[1:])
        arcs.append(np.full(interval_edges.size - 1, number))
    return edges, np.concatenate(firsts), np.concatenate(lasts), np.concatenate(arcs)


def _measure_pieces(recording: Recording, pieces: Sequence[Interval] | None) -> tuple[Measurements, Indices]:
    """Prepare the arcs of some pieces; also the recording's row of each of their references."""
    attitudes = recording.attitudes
    if pieces is None:
        return prepare_measurements(recording), np.arange(attitudes.t_s.size)
    rows = np.unique(np.concatenate([find_reference_rows(attitudes.t_s, piece) for piece in pieces]))
    return prepare_measurements(replace(recording, intervals=tuple(pieces), attitudes=attitudes.select_rows(rows))), rows


def _accumulate_gyro_noise(turned: Array, power: Array, ends: Indices) -> Array:
    """Accumulate the noise power (n, 3), rad², of the steps to the covariance (m, 3, 3) at each reference."""
    ends, place = np.unique(ends, return_inverse=True)
    added = np.matmul(turned * power[:, None, :], turned.transpose(0, 2, 1))
    total = np.cumsum(np.add.reduceat(added, ends[:-1], axis=0), axis=0)
    return np.concatenate([np.zeros((1, 3, 3)), total])[place]


def _build_interval_covariance(errors: Array, walk: Array, groups: Indices) -> Array:
    """Build the covariance (3r, 3r) of an interval's observations from those (m, 3, 3) of its references, see the module."""
    counts = np.diff(np.append(groups, len(walk)))
    within = np.arange(len(walk)) - np.repeat(groups, counts)
    share = np.repeat(counts, counts)
    # Covariance of each observation with any later one, and with itself.
    later = np.add.reduceat(walk / share[:, None, None], groups, axis=0)
    weights = (2 * (share - within) - 1) / share**2
    variances = np.add.reduceat(walk * weights[:, None, None], groups, axis=0)
    variances += np.add.reduceat(errors / (share**2)[:, None, None], groups, axis=0)
    count = groups.size
    V = np.array(later[np.minimum.outer(np.arange(count), np.arange(count))])  # (r, r, 3, 3)
    V[np.arange(count), np.arange(count)] = variances
    return np.asarray(V.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count))


def find_relinearised_path(zeta: Array, sigma: Array) -> tuple[Array, Array] | None:
    """Integrate the errors (m, 3) of an interval along another path S; also the rotation vectors (m, 3) of S; inertial, rad.

    The errors of the propagation are `zeta`, the sigmas of the references `sigma`, (m, 3) each. None where first order is
    enough.
    """
    largest = float(np.linalg.norm(zeta, axis=1).max())
    if 0.5 * largest**2 < SMALL * float(sigma.min()):
        return None
    wanted = (float(sigma.max()) / (NOISE * largest)) ** 2
    count = int(np.clip(np.ceil(wanted), 1, max(1, WIDEST * len(zeta))))
    smooth = scipy.ndimage.uniform_filter1d(zeta, count, axis=0, mode="nearest")
    S, E = Rotation.from_rotvec(smooth), Rotation.from_rotvec(zeta)
    turns = np.cumsum((S[1:] * S[:-1].inv()).as_rotvec(), axis=0)
    # S begins at the average of the first references, not at the first, so that its own turn comes first.
    errors = smooth[0] + np.concatenate([np.zeros((1, 3)), turns]) + (E * S.inv()).as_rotvec()
    return errors, smooth


def interpolate_turns(turns: Array, ends: Indices) -> Array:
    """Interpolate S (n, 3, 3) to the middle of each step from its rotation vectors (m, 3) after `ends` (m,) steps."""
    middle = np.arange(ends[-1]) + 0.5
    return np.asarray(
        Rotation.from_rotvec(np.column_stack([np.interp(middle, ends, component) for component in turns.T])).as_matrix()
    )
