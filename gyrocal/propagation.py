"""Propagation of the attitude and of its sensitivity to the gyro parameters along a stream of rates.

Over a step k of duration Δt with the adjusted rate ω = G ω_raw + b, φ = |ω|Δt:

    R_k = exp(−[ω×]Δt)                                                                       the rotation of N (28)
    ψ_k = ∫₀^Δt exp(−[ω×]τ) dτ = Δt (I − c [φ×] + d [φ×]²)                                              N (11)
    c = (1 − cos φ)/φ² = ½ν²(φ/2),    d = (φ − sin φ)/φ³ = 2η(φ),    [φ×] = [ω×]Δt

N prints η = ½(1 − sin φ)/φ², which diverges at φ → 0; it must be ½(1 − ν(φ))/φ² with ν = sin φ/φ, as the integral shows.
The linear ψ_k = I Δt is Davenport's conventional form. A rate error δω_k = Σ f_i Δx_i (N 13) moves the residual by
θ = Θ Δx with

    Θ_k = ψ_k F_k + R_k Θ_{k−1},    Θ_0 = 0                                                       N (15), (21)–(27)

`StreamingPropagation` is that recursion, one sample in and nothing kept, for any columns F_k.

`propagate` is the compiled pass over whole arrays. With P_k = A_kᵀ (A_0 = I), R_{k→n} = P_nᵀ P_k, so that

    Θ_n = P_nᵀ Σ_k P_k ψ_k F_k

and only P is serial. A column of the form f = e_i h(t) (axis i, regressor h) needs only S_h = Σ h_k M_k Δt_k with
M_k = P_k ψ_k / Δt_k; the twelve calibration columns are the regressors (ω_raw,x, ω_raw,y, ω_raw,z, 1) times three axes, and
any other column is a sum of such. M_k follows from P_{k−1} without a second matrix product: R_kᵀψ_k = ψ_kᵀ, hence
M_k = P_{k−1} E_k with E = I + c[φ×] + d[φ×]², and P_k = P_{k−1} + M_k [φ×].

Stretches compose, (R₂, Θ₂)∘(R₁, Θ₁) = (R₂R₁, R₂Θ₁ + Θ₂). So the stream is cut into pieces which run side by side as lanes
of one vector loop and are joined afterwards; a step of zero duration changes nothing and pads the short pieces.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Literal

import numba
import numpy as np
from numpy.typing import NDArray

from gyrocal.attitude import cross_matrix, rotation_matrix

Array = NDArray[np.float64]
Psi = Literal["full", "linear"]
Pieces = tuple[NDArray[np.intp], NDArray[np.intp]]
Columns = Callable[[Array, Array, float], Array]

LANES = 32
TILE = 4
GROUP = 4  # regressors carried by one pass

SERIES_LIMIT = 0.1  # rad; below it the series of c and d are exact to rounding, above it the closed forms are
C0, C1, C2, C3, C4 = 1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800
D0, D1, D2, D3, D4 = 1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800


def psi_coefficients(phi: Array) -> tuple[Array, Array]:
    """c = (1 − cos φ)/φ² and d = (φ − sin φ)/φ³, to rounding at every φ ≥ 0."""
    phi = np.asarray(phi, dtype=float)
    x = phi * phi
    small = phi < SERIES_LIMIT
    safe = np.where(small, 1.0, phi)
    half = np.sin(safe / 2) / safe
    c = np.where(small, C0 + x * (C1 + x * (C2 + x * (C3 + x * C4))), 2 * half * half)
    d = np.where(small, D0 + x * (D1 + x * (D2 + x * (D3 + x * D4))), (safe - np.sin(safe)) / safe**3)
    return c, d


def psi_matrix(omega: Array, dt: float | Array, psi: Psi = "full") -> Array:
    """Error sensitivity matrix ψ of N (11), in seconds.

    Parameters
    ----------
    omega : (..., 3) adjusted rate, rad/s
    dt : duration of the step, s; broadcast against omega's leading shape
    psi : "full", or "linear" for I Δt

    Returns
    -------
    (..., 3, 3)
    """
    omega = np.asarray(omega, dtype=float)
    step = np.asarray(dt, dtype=float)[..., None, None]
    if psi == "linear":
        return np.broadcast_to(np.eye(3), (*omega.shape[:-1], 3, 3)) * step
    rotvec = omega * np.asarray(dt, dtype=float)[..., None]
    c, d = psi_coefficients(np.linalg.norm(rotvec, axis=-1))
    K = cross_matrix(rotvec)
    return np.asarray((np.eye(3) - c[..., None, None] * K + d[..., None, None] * (K @ K)) * step)


def calibration_columns(raw: Array, adjusted: Array, t: float) -> Array:
    """F_k of the twelve calibration parameters: ∂ω/∂G[i,j] = e_i ω_raw,j, ∂ω/∂b_i = e_i; (3, 12)."""
    return np.hstack([np.kron(np.eye(3), raw), np.eye(3)])


class StreamingPropagation:
    """The recursion of N (15), (21)–(28): takes a sample, updates R and Θ, and forgets it.

    Memory does not depend on the number of samples. Use it where samples arrive one by one; for arrays use `propagate`.

    Parameters
    ----------
    G, bias : (3, 3) and (3,) rad/s; the parameters the rates are adjusted with
    columns : (raw, adjusted, t) → F_k, (3, p); the twelve calibration columns by default
    psi : "full" or "linear"

    Attributes
    ----------
    R : (3, 3) rotation from the start, A(t) = R A(0)
    Theta : (3, p) sensitivity of the residual at the present time
    t : s since the start
    """

    def __init__(self, G: Array, bias: Array, columns: Columns = calibration_columns, psi: Psi = "full"):
        self._G, self._bias, self._columns, self._psi = G, bias, columns, psi
        self.R = np.eye(3)
        self.t = 0.0
        self.Theta = np.zeros_like(columns(np.zeros(3), np.asarray(bias, dtype=float), 0.0))

    def update(self, raw: Array, dt: float) -> None:
        """Propagate over one sample: raw rate (3,) rad/s held for dt seconds."""
        omega = self._G @ raw + self._bias
        R = rotation_matrix(-omega * dt)
        self.Theta = psi_matrix(omega, dt, self._psi) @ self._columns(raw, omega, self.t) + R @ self.Theta
        self.R = R @ self.R
        self.t += dt


@dataclass(frozen=True)
class Arcs:
    """Stretches of gyro steps, each from its own start, with the times at which R and Θ are wanted.

    Attributes
    ----------
    raw : (n, 3) raw rate of each step, rad/s; the arcs one after another
    dt : (n,) duration of each step, s
    sample : (n,) index of the gyro sample behind each step
    first : (m,) first step of the stretch that leads to output j; an arc's first output starts where the arc starts
    last : (m,) one past the last step of that stretch
    arc : (m,) number of the arc output j belongs to, ascending
    """

    raw: Array
    dt: Array
    sample: NDArray[np.intp]
    first: NDArray[np.intp]
    last: NDArray[np.intp]
    arc: NDArray[np.intp]

    @cached_property
    def pieces(self) -> Pieces:
        """Start and length of the pieces that run as lanes."""
        return _cut(self)

    @cached_property
    def increments(self) -> Array:
        """[ω_raw Δt, Δt] of every step, packed for the lanes; kept, since every iteration and every ψ uses it again."""
        return _pack_increments(self.raw, self.dt, *self.pieces)

    @cached_property
    def largest_increment(self) -> float:
        """Largest |ω_raw Δt| of a step, rad."""
        return float(np.sqrt(np.max(np.einsum("ij,ij->i", self.raw, self.raw) * self.dt**2)))


@dataclass(frozen=True)
class Propagation:
    """R and Θ at each output of some `Arcs`.

    Attributes
    ----------
    R : (m, 3, 3) rotation from the arc's start
    S : (m, q, 3, 3) sensitivity to regressor q, a column for each body axis
    """

    R: Array
    S: Array

    @property
    def Theta(self) -> Array:
        """(m, 3, 12) in the order G_xx, G_xy, …, G_zz, b_x, b_y, b_z, of the first four regressors."""
        count = len(self.S)
        G_part = self.S[:, :3].transpose(0, 2, 3, 1).reshape(count, 3, 9)  # (row, axis i, gyro j)
        return np.concatenate([G_part, self.S[:, 3]], axis=2)


def propagate(arcs: Arcs, G: Array, bias: Array, psi: Psi = "full", regressors: Array | None = None) -> Propagation:
    """R and Θ at every output of the arcs, in one compiled pass.

    Parameters
    ----------
    arcs : the steps and the wanted times
    G, bias : (3, 3), and (3,) in rad/s
    psi : "full" or "linear"
    regressors : (n, q) value of further regressors h at each step, carried after the four of the calibration; the rate error
        of regressor q along axis i is h_q e_i, in rad/s for a unit of its size

    Returns
    -------
    Propagation
        S holds 4 + q regressors.
    """
    increments, pieces = arcs.increments, arcs.pieces
    G, bias = np.ascontiguousarray(G, dtype=float), np.ascontiguousarray(bias, dtype=float)
    # |G h + b Δt| ≤ ‖G‖ |h| + |b| Δt: one look at the largest step spares the loop a branch per step.
    bound = np.linalg.norm(G, 2) * arcs.largest_increment + np.linalg.norm(bias) * arcs.dt.max()
    options = (G, bias, psi == "linear", bool(bound >= SERIES_LIMIT))
    P, S = _run(increments, increments, *options)
    sums = [S]
    if regressors is not None:
        weights = np.asarray(regressors, dtype=float) * arcs.dt[:, None]
        count = weights.shape[1]
        weights = np.pad(weights, ((0, 0), (0, -count % GROUP)))
        for q in range(0, weights.shape[1], GROUP):
            group = np.ascontiguousarray(weights[:, q : q + GROUP])
            sums.append(_run(increments, _pack(group, *pieces), *options)[1])
    return _join(arcs, pieces, P, sums, 0 if regressors is None else np.shape(regressors)[1])


def _cut(arcs: Arcs) -> Pieces:
    """Start and length of pieces that fill the lanes evenly and end at every output."""
    target = max(1, -(-len(arcs.dt) // LANES))
    starts, lengths = [], []
    for first, last in zip(arcs.first, arcs.last, strict=True):
        count = max(1, round((last - first) / target))
        edges = first + (last - first) * np.arange(count + 1) // count
        starts.append(edges[:-1])
        lengths.append(np.diff(edges))
    return np.concatenate(starts), np.concatenate(lengths)


@numba.njit(cache=True, nogil=True)
def _pack_increments(
    raw: Array, dt: Array, starts: NDArray[np.intp], lengths: NDArray[np.intp]
) -> Array:  # pragma: no cover - compiled
    """[ω_raw Δt, Δt] of each step laid out as `_pack` does."""
    batches = (len(starts) + LANES - 1) // LANES
    depth = lengths.max()
    out = np.zeros((batches, depth, 4, LANES))
    for piece in range(len(starts)):
        batch, lane = piece // LANES, piece % LANES
        for k in range(lengths[piece]):
            step = starts[piece] + k
            for q in range(3):
                out[batch, k, q, lane] = raw[step, q] * dt[step]
            out[batch, k, 3, lane] = dt[step]
    return out


@numba.njit(cache=True, nogil=True)
def _pack(values: Array, starts: NDArray[np.intp], lengths: NDArray[np.intp]) -> Array:  # pragma: no cover - compiled
    """Rows of (n, 4) `values` laid out as (batch, step, 4, lane); steps a short piece lacks are zero."""
    batches = (len(starts) + LANES - 1) // LANES
    depth = lengths.max()
    out = np.zeros((batches, depth, 4, LANES))
    for piece in range(len(starts)):
        batch, lane = piece // LANES, piece % LANES
        for k in range(lengths[piece]):
            for q in range(4):
                out[batch, k, q, lane] = values[starts[piece] + k, q]
    return out


def _run(increments: Array, weights: Array, G: Array, bias: Array, linear: bool, beyond_series: bool) -> tuple[Array, Array]:
    """Run every batch of lanes; P (pieces, 3, 3) and S (pieces, 4, 3, 3) in each piece's own start frame."""
    out = np.empty((len(increments), 45, LANES))
    for batch in range(len(increments)):
        _lanes(increments[batch], weights[batch], G, bias, linear, beyond_series, out[batch])
    flat = out.transpose(0, 2, 1).reshape(-1, 45)
    return np.ascontiguousarray(flat[:, :9]).reshape(-1, 3, 3), flat[:, 9:].reshape(-1, GROUP, 3, 3)


@numba.njit(cache=True, nogil=True, fastmath={"contract"})
def _lanes(
    increments: Array, weights: Array, G: Array, bias: Array, linear: bool, beyond_series: bool, out: Array
) -> None:  # pragma: no cover - compiled
    """One batch: (steps, 4, lanes) of [ω_raw Δt, Δt] and of [h Δt] → out (45, lanes) = P (9), then S of four regressors (36).

    The workspace is local with literal sizes: passed in, the compiler stops vectorising over the lanes.
    """
    steps = increments.shape[0]
    # Channels of a tile: φ (0–2), E (3–11).
    tile = np.empty((TILE, 12, LANES))
    # Row i of P (0–2), then row i of S for each regressor (3–14).
    state = np.zeros((3, 15, LANES))
    for i in range(3):
        for lane in range(LANES):
            state[i, i, lane] = 1.0
    first = 0
    while first < steps:
        size = min(TILE, steps - first)
        for t in range(size):
            k = first + t
            for lane in range(LANES):
                h0, h1, h2 = increments[k, 0, lane], increments[k, 1, lane], increments[k, 2, lane]
                dt = increments[k, 3, lane]
                x = G[0, 0] * h0 + G[0, 1] * h1 + G[0, 2] * h2 + bias[0] * dt
                y = G[1, 0] * h0 + G[1, 1] * h1 + G[1, 2] * h2 + bias[1] * dt
                z = G[2, 0] * h0 + G[2, 1] * h1 + G[2, 2] * h2 + bias[2] * dt
                f = x * x + y * y + z * z
                c = C0 + f * (C1 + f * (C2 + f * (C3 + f * C4)))
                d = D0 + f * (D1 + f * (D2 + f * (D3 + f * D4)))
                _sensitivity(tile, t, lane, x, y, z, c, d)
            if beyond_series:
                for lane in range(LANES):
                    x, y, z = tile[t, 0, lane], tile[t, 1, lane], tile[t, 2, lane]
                    f = x * x + y * y + z * z
                    if f >= SERIES_LIMIT * SERIES_LIMIT:
                        c, d = _closed_coefficients(f)
                        _sensitivity(tile, t, lane, x, y, z, c, d)
        for i in range(3):
            for t in range(size):
                k = first + t
                for lane in range(LANES):
                    px, py, pz = state[i, 0, lane], state[i, 1, lane], state[i, 2, lane]
                    mx = px * tile[t, 3, lane] + py * tile[t, 6, lane] + pz * tile[t, 9, lane]
                    my = px * tile[t, 4, lane] + py * tile[t, 7, lane] + pz * tile[t, 10, lane]
                    mz = px * tile[t, 5, lane] + py * tile[t, 8, lane] + pz * tile[t, 11, lane]
                    x, y, z = tile[t, 0, lane], tile[t, 1, lane], tile[t, 2, lane]
                    px, py, pz = px + my * z - mz * y, py + mz * x - mx * z, pz + mx * y - my * x
                    state[i, 0, lane], state[i, 1, lane], state[i, 2, lane] = px, py, pz
                    if linear:  # ψ = I Δt: M_k = P_k
                        mx, my, mz = px, py, pz
                    for q in range(4):
                        h = weights[k, q, lane]
                        state[i, 3 + 3 * q, lane] += h * mx
                        state[i, 4 + 3 * q, lane] += h * my
                        state[i, 5 + 3 * q, lane] += h * mz
        first += TILE
    for i in range(3):
        for j in range(3):
            for lane in range(LANES):
                out[3 * i + j, lane] = state[i, j, lane]
                for q in range(4):
                    out[9 + 9 * q + 3 * i + j, lane] = state[i, 3 + 3 * q + j, lane]


@numba.njit(inline="always")
def _sensitivity(
    tile: Array, t: int, lane: int, x: float, y: float, z: float, c: float, d: float
) -> None:  # pragma: no cover - compiled
    """Φ and E = I + c[φ×] + d[φ×]² of one step into the tile."""
    dx, dy, dz = d * x, d * y, d * z
    cx, cy, cz = c * x, c * y, c * z
    xx, yy, zz = dx * x, dy * y, dz * z
    xy, xz, yz = dx * y, dx * z, dy * z
    tile[t, 0, lane], tile[t, 1, lane], tile[t, 2, lane] = x, y, z
    tile[t, 3, lane], tile[t, 4, lane], tile[t, 5, lane] = 1 - yy - zz, xy - cz, xz + cy
    tile[t, 6, lane], tile[t, 7, lane], tile[t, 8, lane] = xy + cz, 1 - xx - zz, yz - cx
    tile[t, 9, lane], tile[t, 10, lane], tile[t, 11, lane] = xz - cy, yz + cx, 1 - xx - yy


@numba.njit(cache=True, nogil=True)
def _closed_coefficients(f: float) -> tuple[float, float]:  # pragma: no cover - compiled
    """c and d of φ² = f where the series no longer serves."""
    phi = sqrt(f)
    half = np.sin(phi / 2) / phi
    return 2 * half * half, (phi - np.sin(phi)) / (f * phi)


def _join(arcs: Arcs, pieces: Pieces, P: Array, sums: list[Array], extra: int) -> Propagation:
    """Chain the pieces along each arc: P ← P P_l, S ← S + P S_l; at an output R = Pᵀ and Θ = Pᵀ S."""
    S = np.concatenate(sums, axis=1)[:, : GROUP + extra]
    ends = pieces[0] + pieces[1]
    R_out, S_out = np.empty((len(arcs.arc), 3, 3)), np.empty((len(arcs.arc), S.shape[1], 3, 3))
    _chain(P, np.ascontiguousarray(S), ends, arcs.last, arcs.arc, R_out, S_out)
    return Propagation(R_out, S_out)


@numba.njit(cache=True, nogil=True)
def _chain(
    P: Array,
    S: Array,
    ends: NDArray[np.intp],
    last: NDArray[np.intp],
    arc: NDArray[np.intp],
    R_out: Array,
    S_out: Array,
) -> None:  # pragma: no cover - compiled
    piece = 0
    regressors = S.shape[1]
    P_sum = np.eye(3)
    S_sum = np.zeros((regressors, 3, 3))
    R = np.eye(3)
    for output in range(len(arc)):
        if output == 0 or arc[output] != arc[output - 1]:
            P_sum[:] = np.eye(3)
            S_sum[:] = 0.0
        while True:
            for q in range(regressors):
                S_sum[q] += P_sum @ S[piece, q]
            P_sum = P_sum @ P[piece]
            piece += 1
            if ends[piece - 1] == last[output]:
                break
        R[:] = P_sum.T
        R_out[output] = R
        for q in range(regressors):
            S_out[output, q] = R @ S_sum[q]
