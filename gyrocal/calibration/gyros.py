"""Calibration of any number of gyros: scale factor, axis and bias of each, from reference attitudes and from parity.

Gyro i reads ω_raw,i = K_i · ω + c_i + noise, 4n parameters (`gyrocal.recording.gyros`). With G = K⁺ of the gyros that are on,
ω_adj = G (ω_raw − c) is off by

    δω = ω_adj − ω_true = −G (ΔK ω + Δc)

so that attitude sees the twelve combinations (G ΔK, G Δc), by the compiled pass over the n columns of ω_raw, with b = −G c and
the regressors (ω_adj, 1), and nothing else. The other 4 (n − 3) are in the parity residuals

    e = Vᵀ (ω_raw − c) = −Vᵀ (ΔK ω + Δc) + Vᵀ noise,    VᵀK = 0.

Both at once determine all; gyros that are switched between intervals only change G and V there. Since G V = 0, the noise of
the attitude residuals and of the parity is uncorrelated, and each is an accumulation of its own.

Parity without a matrix of samples. e and ŵ = (ω_adj, 1) are linear in (ω_raw, 1), so that Y = Σ (ω_raw, 1)(ω_raw, 1)ᵀ Δt holds
all that is needed at any K and c: M̂ = Σ ŵ ŵᵀ Δt, X = Σ e ŵᵀ Δt. At the true parameters e and the noise of ŵ are uncorrelated,
hence E X = 0 and the solution of X = 0 is consistent; but M̂ counts the noise of ŵ as motion, M̂ = M + N with
N = (number of samples) ARW² G Gᵀ. The estimate Δ = −V X M⁻¹ has the information M_e = M M̂⁻¹ M, for X scatters as M̂ does.
Source of the correction: Fuller, Measurement Error Models, section 2.2.

The gyro noise that attitude residuals accumulate is that of ω_adj, ARW² G Gᵀ in body axes, which is isotropic for a
tetrahedron but not for any axes: R_a W R_bᵀ with W = ARW² ∫ Aᵀ G Gᵀ A dt up to the earlier of the two, from the start. Where
G Gᵀ = ν I that is ν ARW² T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.special
from numpy.typing import NDArray

from gyrocal.attitude import cross_matrix
from gyrocal.calibration.observability import Observability, evaluate_observability, list_combinations
from gyrocal.calibration.plausible_ranges import PlausibleRanges, estimate_plausible_ranges
from gyrocal.calibration.problem import Problem, State, tabulate_residuals
from gyrocal.calibration.propagation import Arcs, Psi, convert_to_body_sums, propagate
from gyrocal.calibration.sampling import prepare_measurements
from gyrocal.errors import InputError, UnobservableError
from gyrocal.jit_cache import compile_cached
from gyrocal.recording import Recording
from gyrocal.recording.gyros import (
    compute_gyro_gain,
    compute_nominal_gyros,
    compute_parity_basis,
    select_interval_samples,
    triad,
)

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SINGULAR_PRODUCT_TOLERANCE = 1e-12  # relative size of what a singular sum of products leaves
CONVERGED_SIGMAS = 1e-4  # sigmas of the last correction
EQUAL_NOISE_TOLERANCE = 1e-9  # relative difference of the noise about the axes that is none
LARGEST_TURN = 0.02  # rad, that the noise is taken over at once, at its middle: wrong by LARGEST_TURN²/24


@dataclass(frozen=True)
class GyroArray:
    """Parameters of n gyros: their raw rates are ω_raw = K ω + c at the body's rate ω.

    Attributes
    ----------
    names : of the gyros
    K : (n, 3) scale factor times axis, dimensionless
    c : (n,) what each reads at rest, rad/s
    """

    names: tuple[str, ...]
    K: Array
    c: Array

    @property
    def scale_factor(self) -> Array:
        """(n,) of each gyro."""
        return np.asarray(np.linalg.norm(self.K, axis=1))

    @property
    def axes(self) -> Array:
        """(n, 3) unit vectors in body axes."""
        return np.asarray(self.K / self.scale_factor[:, None])

    @property
    def G(self) -> Array:
        """(3, n) of R (7), with all gyros on."""
        return np.asarray(np.linalg.pinv(self.K))

    @property
    def bias(self) -> Array:
        """(3,) b of R (7), rad/s, with all gyros on."""
        return np.asarray(-self.G @ self.c)

    @property
    def bias_deg_s(self) -> Array:
        """(3,) b of R (7), deg/s."""
        return np.asarray(np.rad2deg(self.bias))

    @property
    def vector(self) -> Array:
        """(4n,) K_x, K_y, K_z and c, gyro by gyro."""
        return np.column_stack([self.K, self.c]).ravel()

    def at(self, vector: Array) -> GyroArray:
        """The same gyros with other parameters (4n,)."""
        values = np.reshape(vector, (len(self.names), 4))
        return GyroArray(self.names, values[:, :3].copy(), values[:, 3].copy())


@dataclass(frozen=True)
class ParitySums:
    """All that parity says of the intervals in which the same gyros were on.

    Attributes
    ----------
    chosen : (k,) columns of those gyros
    Y : (n + 1, n + 1) Σ (ω_raw, 1)(ω_raw, 1)ᵀ Δt; zero for the others
    samples : number of samples
    """

    chosen: Indices
    Y: Array
    samples: int

    def moments(self, gyros: GyroArray) -> tuple[Array, Array, Array, Array]:
        """V (n, m), M̂ (4, 4), X (m, 4) and Σ e eᵀ Δt (m, m) at these parameters."""
        G, V = compute_gyro_gain(gyros.K, self.chosen), compute_parity_basis(gyros.K, self.chosen)
        B = np.zeros((4, len(self.Y)))
        B[:3, :-1], B[:3, -1], B[3, -1] = G, -G @ gyros.c, 1.0
        E = np.column_stack([V.T, -V.T @ gyros.c])
        return V, B @ self.Y @ B.T, E @ self.Y @ B.T, E @ self.Y @ E.T

    def rows(self, gyros: GyroArray, arw: float) -> tuple[Array, Array]:
        """H (r, 4n) and z (r,) of Δ, whitened, whose normal equations are those of all samples; r is 4m or less."""
        V, seen, X, _ = self.moments(gyros)
        G = compute_gyro_gain(gyros.K, self.chosen)
        true = seen.copy()
        true[:3, :3] -= self.samples * arw**2 * G @ G.T
        # M = L Q diag(q) Qᵀ Lᵀ with L Lᵀ = M̂; what is only noise has q ≈ 0 and must not become negative.
        L, inverse = _compute_root_and_inverse(seen)
        q, Q = np.linalg.eigh(inverse @ true @ inverse.T)
        root = L @ Q * np.maximum(q, 0.0)  # root rootᵀ = M M̂⁻¹ M
        H = np.einsum("im,wk->mkiw", V, root).reshape(V.shape[1] * len(q), -1) / arw
        return H, -(X @ inverse.T @ Q).ravel() / arw

    def chi2(self, gyros: GyroArray, arw: float) -> float:
        """Σ eᵀe Δt / ARW²."""
        return float(np.trace(self.moments(gyros)[3]) / arw**2)


def _compute_root_and_inverse(M: Array) -> tuple[Array, Array]:
    """L (4, r) with L Lᵀ = M, and its pseudo-inverse; motion without noise may leave M singular."""
    scale = np.sqrt(np.maximum(np.diag(M), 0.0))  # rounding may leave a diagonal below zero
    scale = np.where(scale > 0, scale, 1.0)
    values, U = np.linalg.eigh(M / np.outer(scale, scale))
    kept = values > SINGULAR_PRODUCT_TOLERANCE * values[-1]
    root, U = np.sqrt(values[kept]), U[:, kept]
    return scale[:, None] * U * root, (U / root).T / scale


def compute_parity_sums(recording: Recording) -> tuple[ParitySums, ...]:
    """Sums over all samples inside the intervals, for each set of more than three gyros that was on."""
    found: dict[tuple[int, ...], list[int]] = {}
    for number in range(len(recording.intervals)):
        chosen = recording.switched_on(number)
        if chosen.size > 3:
            found.setdefault(tuple(chosen.tolist()), []).append(number)
    out = []
    for columns, numbers in found.items():
        n = len(recording.gyro.names)
        Y, count = np.zeros((n + 1, n + 1)), 0
        places = np.array([*columns, n])
        for number in numbers:
            part, dt = select_interval_samples(recording, number)
            values = np.column_stack([recording.gyro.rates[part][:, columns], np.ones(dt.size)])
            Y[np.ix_(places, places)] += (values * dt[:, None]).T @ values
            count += dt.size
        out.append(ParitySums(np.array(columns), Y, count))
    return tuple(out)


@dataclass(frozen=True)
class _Part:
    """Intervals in which the same gyros were on: their columns, their outputs' positions, and the steps."""

    chosen: Indices
    outputs: Indices
    arcs: Arcs

    def walk(self, G: Array, bias: Array, arw: float) -> Array:
        """ARW² ∫ Aᵀ G Gᵀ A dt up to each output, (outputs, 3, 3)."""
        steps, N = self.arcs, arw**2 * G @ G.T
        level = float(np.trace(N)) / 3
        total = np.concatenate([[0.0], np.cumsum(steps.dt)])
        begins = steps.first[np.searchsorted(steps.arc, steps.arc)]
        if np.abs(N - level * np.eye(3)).max() < EQUAL_NOISE_TOLERANCE * level:
            return np.asarray(level * (total[steps.last] - total[begins])[:, None, None] * np.eye(3))
        out = np.empty((steps.arc.size, 3, 3))
        for number in np.unique(steps.arc):
            own = steps.arc == number
            span = slice(int(steps.first[own][0]), int(steps.last[own][-1]))
            rates = steps.rates[steps.sample[span]] @ G.T + bias
            out[own] = integrate_noise_walk(rates, steps.dt[span], steps.last[own] - span.start, N)
        return out


@dataclass(frozen=True)
class _Steps:
    """The steps of a recording, by the gyros that were on, and its references in the problem of its body rates."""

    arw: float
    problem: Problem
    parts: tuple[_Part, ...]

    @classmethod
    def build(cls, recording: Recording, psi: Psi, max_gap_s: float | None) -> _Steps:
        body = triad(recording)
        measured = prepare_measurements(body, max_gap_s=max_gap_s)
        arcs, found = measured.arcs, dict[tuple[int, ...], list[int]]()
        for output, number in enumerate(arcs.arc.tolist()):
            found.setdefault(tuple(recording.switched_on(number).tolist()), []).append(output)
        parts = []
        for columns, outputs in found.items():
            chosen, own = np.array(columns), np.array(outputs)
            rates = np.ascontiguousarray(recording.gyro.rates[:, chosen])
            ends = (arcs.first[own], arcs.last[own], arcs.arc[own])
            parts.append(_Part(chosen, own, Arcs(rates, arcs.dt, arcs.sample, *ends)))
        return cls(recording.gyro.arw, Problem.build(body, measured, psi=psi), tuple(parts))

    def state(self, gyros: GyroArray) -> State:
        """Evaluate at some parameters, of which H has all 4n.

        Raises
        ------
        InputError
            A residual is too large to be corrected by linearisation.
        """
        m = len(self.problem.measurements.arcs.arc)
        Theta, R, walk = np.empty((m, 3, 4 * len(gyros.names))), np.empty((m, 3, 3)), np.empty((m, 3, 3))
        with np.errstate(over="ignore", invalid="ignore"):
            for part in self.parts:
                gains = compute_gyro_gain(gyros.K, part.chosen)
                G, bias = gains[:, part.chosen], -gains @ gyros.c
                run = propagate(part.arcs, G, bias, self.problem.psi)
                R[part.outputs], walk[part.outputs] = run.R, part.walk(G, bias, self.arw)
                S = convert_to_body_sums(run.S, G, bias)
                Theta[part.outputs] = -np.einsum("mqra,ai->mriq", S, gains).reshape(len(S), 3, -1)
        return self.problem.compute_state(R, Theta.reshape(3 * m, -1), walk)


@compile_cached
def integrate_noise_walk(rates: Array, dt: Array, ends: Indices, N: Array) -> Array:
    """∫ Aᵀ N A dt from the start of an arc to each of some steps, (m, 3, 3), with A = I at the start.

    Steps are taken together until they turn by `LARGEST_TURN`, or an output comes.

    Parameters
    ----------
    rates, dt : (n, 3) rad/s and (n,) s of the steps
    ends : (m,) steps done at each output, ascending
    N : (3, 3) power of the noise in body axes, rad²/s
    """
    out, total = np.empty((len(ends), 3, 3)), np.zeros((3, 3))
    P, middle, turned = np.eye(3), np.eye(3), np.empty((3, 3))
    k = 0
    for j in range(len(ends)):
        while k < ends[j]:
            x, y, z, span = 0.0, 0.0, 0.0, 0.0
            while k < ends[j] and x * x + y * y + z * z < LARGEST_TURN**2:
                x, y, z = x + rates[k, 0] * dt[k], y + rates[k, 1] * dt[k], z + rates[k, 2] * dt[k]
                span += dt[k]
                k += 1
            middle[:] = P
            _rotate_in_place(middle, 0.5 * x, 0.5 * y, 0.5 * z)
            _rotate_in_place(P, x, y, z)
            for a in range(3):
                for b in range(3):
                    turned[a, b] = middle[a, 0] * N[0, b] + middle[a, 1] * N[1, b] + middle[a, 2] * N[2, b]
            for a in range(3):
                for b in range(3):
                    total[a, b] += span * (
                        turned[a, 0] * middle[b, 0] + turned[a, 1] * middle[b, 1] + turned[a, 2] * middle[b, 2]
                    )
        out[j] = total
    return out


@compile_cached
def _rotate_in_place(P: Array, x: float, y: float, z: float) -> None:
    """P ← P exp([(x, y, z)×]), with A = Pᵀ."""
    f = x * x + y * y + z * z
    angle = np.sqrt(f)
    s, c = (np.sin(angle) / angle, (1 - np.cos(angle)) / f) if angle > 1e-4 else (1 - f / 6, 0.5 - f / 24)
    for i in range(3):
        a, b, d = P[i, 0], P[i, 1], P[i, 2]
        along = c * (a * x + b * y + d * z)
        rest = 1 - c * f
        P[i, 0] = rest * a + along * x + s * (b * z - d * y)
        P[i, 1] = rest * b + along * y + s * (d * x - a * z)
        P[i, 2] = rest * d + along * z + s * (a * y - b * x)


@dataclass(frozen=True)
class GyrosResult:
    """Result of a calibration of any number of gyros.

    Attributes
    ----------
    recording : title of the recording
    gyros, initial : calibrated, and as started from
    covariance : (4n, 4n) of K_x, K_y, K_z and c, gyro by gyro; c in rad/s
    psi : "full" or "linear"
    iterations, converged : how it was found
    residuals : a row per interval and reference time: interval, t_s, before and after, and sigma, in degrees
    observability : singular values and combinations not found
    chi2, dof : of the attitude residuals and the parity together, a prior's term included
    parity_chi2, parity_dof : of the parity alone, with the parameters that only it sees taken off
    prior_sigma : of K and of c (rad/s), None without; the plausible ranges where the data leave a combination free and no
        prior is given
    plausible : grade of the gyros and plausible ranges of K and c
    prior_from : "given", "plausible ranges", or None without a prior
    """

    recording: str
    gyros: GyroArray
    initial: GyroArray
    covariance: Array
    psi: Psi
    iterations: int
    converged: bool
    residuals: pd.DataFrame
    observability: Observability
    chi2: float
    dof: int
    parity_chi2: float
    parity_dof: int
    prior_sigma: tuple[float, float] | None
    plausible: PlausibleRanges | None = None
    prior_from: str | None = None

    @property
    def G(self) -> Array:
        """(3, n) calibrated G."""
        return self.gyros.G

    @property
    def bias(self) -> Array:
        """(3,) calibrated b, rad/s."""
        return self.gyros.bias

    @property
    def bias_deg_s(self) -> Array:
        """(3,) calibrated b, deg/s."""
        return self.gyros.bias_deg_s

    @property
    def gain_covariance(self) -> Array:
        """(3n + 3, 3n + 3) of G by rows, then b."""
        J = compute_gain_jacobian(self.gyros)
        return np.asarray(J @ self.covariance @ J.T)

    @property
    def p_value(self) -> float:
        """Probability of larger residuals if the noise is as stated."""
        return float(scipy.special.chdtrc(self.dof, self.chi2)) if self.dof > 0 else float("nan")

    @property
    def parity_p_value(self) -> float:
        """The same of the parity alone."""
        return float(scipy.special.chdtrc(self.parity_dof, self.parity_chi2)) if self.parity_dof > 0 else float("nan")

    def summary(self) -> pd.DataFrame:
        """A row per gyro: scale factor, turn of its axis from the a-priori one, and bias, each with its sigma."""
        return tabulate_gyros(self.gyros, self.initial.axes, self.covariance)

    def to_json(self) -> dict[str, Any]:
        """The result as plain values, degrees and deg/s."""
        n = len(self.gyros.names)
        sigma = np.sqrt(np.diag(self.gain_covariance))
        deg = np.tile([1.0, 1.0, 1.0, np.rad2deg(1.0)], n)
        return {
            "format": 2,
            "recording": self.recording,
            "psi": self.psi,
            "iterations": self.iterations,
            "converged": self.converged,
            "names": list(self.gyros.names),
            "G": self.G.tolist(),
            "bias_deg_s": np.rad2deg(self.bias).tolist(),
            "sigma_G": sigma[: 3 * n].reshape(3, n).tolist(),
            "sigma_bias_deg_s": np.rad2deg(sigma[3 * n :]).tolist(),
            "K": self.gyros.K.tolist(),
            "c_deg_s": np.rad2deg(self.gyros.c).tolist(),
            "parameters": list(list_gyro_parameters(self.gyros.names)),
            "covariance": (self.covariance * np.outer(deg, deg)).tolist(),
            "gyros": self.summary().to_dict("records"),
            "residuals": self.residuals.to_dict("records"),
            "unobservable": list(self.observability.unobservable),
            "plausible_ranges": None if self.plausible is None else self.plausible.to_json(),
            "prior_from": self.prior_from,
            "chi2": self.chi2,
            "degrees_of_freedom": self.dof,
            "p_value": self.p_value if self.dof > 0 else None,
            "parity": {
                "chi2": self.parity_chi2,
                "degrees_of_freedom": self.parity_dof,
                "p_value": self.parity_p_value if self.parity_dof > 0 else None,
            },
        }


def tabulate_gyros(gyros: GyroArray, before: Array, covariance: Array) -> pd.DataFrame:
    """Tabulate the scale factor, the turn of the axis and the bias of each gyro, each with its sigma.

    Parameters
    ----------
    gyros : calibrated
    before : (n, 3) axes that the turns count from
    covariance : (4n, 4n) of `GyroArray.vector`
    """
    import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

    rows = []
    for i, name in enumerate(gyros.names):
        own = covariance[4 * i : 4 * i + 4, 4 * i : 4 * i + 4]
        s, u = gyros.scale_factor[i], gyros.axes[i]
        # d s = u · dK, d u = (I − u uᵀ) dK / s.
        across = (np.eye(3) - np.outer(u, u)) / s
        turn, spread = u - before[i], np.sqrt(np.diag(across @ own[:3, :3] @ across.T))
        row: dict[str, Any] = {"gyro": name, "scale_factor": s, "sigma_scale_factor": float(np.sqrt(u @ own[:3, :3] @ u))}
        for k, axis in enumerate("xyz"):
            row |= {f"misalignment_{axis}_deg": np.rad2deg(turn[k]), f"sigma_{axis}_deg": np.rad2deg(spread[k])}
        row |= {"bias_deg_s": np.rad2deg(gyros.c[i]), "sigma_bias_deg_s": np.rad2deg(np.sqrt(own[3, 3]))}
        rows.append(row)
    return pd.DataFrame(rows)


def list_gyro_parameters(names: Sequence[str]) -> tuple[str, ...]:
    """List the names of the parameters of some gyros, in the order of `GyroArray.vector`."""
    return tuple(name for gyro in names for name in (*(f"K_{gyro}{axis}" for axis in "xyz"), f"c_{gyro}"))


def compute_gain_jacobian(gyros: GyroArray) -> Array:
    """∂(G by rows, b)/∂(K, c), (3n + 3, 4n): dG = −G dK G + G Gᵀ dKᵀ (I − K G), db = −dG c − G dc."""
    n, G, K = len(gyros.names), gyros.G, gyros.K
    J = np.zeros((3 * n + 3, 4 * n))
    for i in range(n):
        for j in range(3):
            dK = np.zeros((n, 3))
            dK[i, j] = 1.0
            dG = -G @ dK @ G + G @ G.T @ dK.T @ (np.eye(n) - K @ G)
            J[:, 4 * i + j] = np.concatenate([dG.ravel(), -dG @ gyros.c])
        J[3 * n :, 4 * i + 3] = -G[:, i]
    return J


def calibrate_gyros(
    recording: Recording,
    *,
    initial: GyroArray | None = None,
    psi: Psi = "full",
    iterations: int | None = None,
    max_iterations: int = 10,
    max_gap_s: float | None = None,
    prior_sigma: tuple[float, float] | None = None,
    prior_covariance: Array | None = None,
    plausible_G: float | None = None,
    plausible_bias: float | None = None,
) -> GyrosResult:
    """Calibrate each gyro of a recording with three or more of them, in any directions, switched by interval or not.

    Parameters
    ----------
    recording : gyro stream, reference attitudes, intervals
    initial : gyros to start from; those of the recording's a-priori G and b by default
    psi : "full" or "linear"
    iterations : exactly so many; None iterates until they change nothing
    max_iterations : bound on those
    max_gap_s : see `gyrocal.calibration.sampling.prepare_measurements`
    prior_sigma : of every element of K, and of every c (rad/s), about `initial`
    prior_covariance : (4n, 4n) in its place, of K_x, K_y, K_z and c, gyro by gyro; see `build_prior_covariance`
    plausible_G, plausible_bias : how far elements of K, and c (rad/s), may plausibly be off; those of the gyros' grade by
        default, see `gyrocal.calibration.plausible_ranges`. A combination that the data do not determine better than that is
        not found; without a prior these ranges then are the a-priori sigmas of all parameters about `initial`

    Raises
    ------
    UnobservableError
        The data determine no combination, and no prior is given.
    InputError
        The recording cannot be used, or states no gyro noise, against which attitude and parity are weighed.
    """
    stream = recording.gyro
    limit = max_iterations if iterations is None else iterations
    if limit < 1:
        raise InputError(f"at least one iteration is needed, not {limit}")
    if not stream.arw > 0:
        raise InputError("the recording states no gyro noise; parity is weighed by it, so give arw_deg_per_sqrt_s")
    start = initial or GyroArray(stream.names, *compute_nominal_gyros(stream))
    names, n = list_gyro_parameters(start.names), len(start.names)
    steps, sums = _Steps.build(recording, psi, max_gap_s), compute_parity_sums(recording)
    ranges = estimate_plausible_ranges(recording, plausible_G, plausible_bias)
    plausible = ranges.vector(np.tile([False] * 3 + [True], n))
    prior = _build_prior_rows(n, prior_sigma, prior_covariance)
    prior_from = None if prior is None else "given"
    gyros, first = start, steps.state(start)
    state, converged, done = first, False, 0
    judged = None
    while True:
        parts = [(state.H, state.z), *(one.rows(gyros, stream.arw) for one in sums)]
        H, z = np.vstack([rows for rows, _ in parts]), np.concatenate([values for _, values in parts])
        if judged is None:
            judged = evaluate_observability(H, plausible, names)
            if judged.unobservable and prior is None:
                if judged.is_undetermined:
                    raise UnobservableError(_format_unobservable(judged.unobservable, ranges), judged.unobservable)
                prior_sigma, prior_from = (ranges.G, ranges.bias), "plausible ranges"
                prior = _build_prior_rows(n, prior_sigma, None)
        if done == limit or (converged and iterations is None):
            break
        if prior is not None:
            H, z = np.vstack([H, prior]), np.append(z, prior @ (gyros.vector - start.vector))
        scaled = H * plausible
        P = np.linalg.inv(scaled.T @ scaled) * np.outer(plausible, plausible)
        step = np.linalg.lstsq(scaled, z, rcond=None)[0] * plausible
        gyros = gyros.at(gyros.vector - step)
        state, done = steps.state(gyros), done + 1
        converged = bool(np.abs(step / np.sqrt(np.diag(P))).max() < CONVERGED_SIGMAS)
    parity_chi2 = sum(one.chi2(gyros, stream.arw) for one in sums)
    parity_rows = sum(one.samples * (one.chosen.size - 3) for one in sums)
    seen = np.linalg.matrix_rank(np.vstack([rows * plausible for rows, _ in parts[1:]])) if sums else 0
    chi2 = float(state.z @ state.z) + parity_chi2
    if prior is not None:
        chi2 += float(np.sum((prior @ (gyros.vector - start.vector)) ** 2))
    return GyrosResult(
        recording=recording.title,
        gyros=gyros,
        initial=start,
        covariance=P,
        psi=psi,
        iterations=done,
        converged=converged,
        residuals=tabulate_residuals(recording, steps.problem.measurements, first, state),
        observability=judged,
        chi2=chi2,
        dof=state.theta.size + parity_rows - (4 * n if prior is None else 0),
        parity_chi2=parity_chi2,
        parity_dof=parity_rows - int(seen),
        prior_sigma=prior_sigma,
        plausible=ranges,
        prior_from=prior_from,
    )


def build_prior_covariance(
    K: Array, sigma_K: float, sigma_c: float, sigma_mounting: float = 0.0, sigma_scale: float = 0.0
) -> Array:
    """(4n, 4n) covariance of K_x, K_y, K_z and c, gyro by gyro, known beforehand, as `calibrate_gyros` takes it.

    To first order a rotation φ of all gyros about the body's axes changes K by −K [φ×], a common scale factor s of
    ω = G ω_raw + b by −s K.

    Parameters
    ----------
    K : (n, 3) as known beforehand, see `compute_nominal_gyros`
    sigma_K, sigma_c : 1-sigma of each element of K, and of each c, rad/s, by itself
    sigma_mounting : 1-sigma of a rotation of all gyros about each axis, rad
    sigma_scale : 1-sigma of a common scale factor
    """
    n = len(K)
    P = np.diag(np.tile(np.square([sigma_K] * 3 + [sigma_c]), n))
    turns = [sigma_mounting * K @ cross_matrix(e) for e in np.eye(3)]
    for change in [*turns, sigma_scale * K]:
        direction = np.column_stack([change, np.zeros(n)]).ravel()
        P += np.outer(direction, direction)
    return P


def _build_prior_rows(n: int, sigma: tuple[float, float] | None, covariance: Array | None) -> Array | None:
    """W (4n, 4n) with WᵀW the information of what is known beforehand; None where nothing is.

    Raises
    ------
    InputError
        Both are given, or the covariance is none.
    """
    if covariance is None:
        return None if sigma is None else np.diag(1 / np.tile([sigma[0]] * 3 + [sigma[1]], n))
    if sigma is not None:
        raise InputError("give prior_sigma or prior_covariance, not both")
    wrong = InputError(f"prior_covariance: not a positive definite matrix of {4 * n} rows")
    if np.shape(covariance) != (4 * n, 4 * n) or not (np.isfinite(covariance).all() and (np.diag(covariance) > 0).all()):
        raise wrong
    scale = np.sqrt(np.diag(covariance))
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance / np.outer(scale, scale))) / scale)
    except np.linalg.LinAlgError:
        raise wrong from None


def fit_to_parity(recording: Recording, start: GyroArray, plausible: tuple[float, float], iterations: int = 3) -> GyroArray:
    """The gyros whose parity is nearest to zero, within what is plausible; what only attitude sees is left as it was.

    Parameters
    ----------
    recording : with or without reference attitudes
    start : gyros to start from
    plausible : prior sigma of K, and of c, rad/s
    iterations : how many
    """
    sums, gyros = compute_parity_sums(recording), start
    prior = np.tile([plausible[0]] * 3 + [plausible[1]], len(start.names))
    for _ in range(iterations if sums else 0):
        parts = [one.rows(gyros, recording.gyro.arw) for one in sums]
        H = np.vstack([*(rows * prior for rows, _ in parts), np.eye(prior.size)])
        z = np.concatenate([*(values for _, values in parts), (gyros.vector - start.vector) / prior])
        gyros = gyros.at(gyros.vector - prior * np.linalg.lstsq(H, z, rcond=None)[0])
    return gyros


def _format_unobservable(combinations: Sequence[str], ranges: PlausibleRanges) -> str:
    return (
        f"none of {len(combinations)} parameter combination(s) can be found with the stated noise to within its plausible "
        f"range ({ranges.G:g} in K, {ranges.bias_deg_h:.3g} deg/h in c; {ranges.reason}): "
        f"{list_combinations(combinations)}; add maneuvers with other rates, state wider plausible ranges "
        "(--plausible-g, --plausible-bias), or give an a-priori sigma (--prior-sigma-g with --prior-sigma-bias)"
    )
