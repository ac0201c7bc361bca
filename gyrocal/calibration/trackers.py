"""Residuals of references by several sensors: their covariance, and the sensors' mountings as nuisance parameters.

A residual compares the reference of row r with the one of row s that its interval starts from, carried on by the gyro's R. With
the errors e of both and the walk g of the gyro, to first order

    θ = e_r − R e_s + g + Θ Δx,    e = Mᵀ (ν + m),    ν ~ N(0, diag(σ²)) about the axes of the sensor, body to sensor by M

so that with E the matrix of these ones and −R of all residuals,

    V = E diag(Mᵀ diag(σ²) M) Eᵀ + V_walk,    θ = Θ Δx − E Mᵀ Δm,    Δm = m_adj − m_true.

Rows may be shared in any way: two sensors at one time, or the end of an interval and the start of the next. The misalignments
m of sensors whose mounting is estimated enter beside G and b, with their priors if they have any. They are taken out of the
whitened equations before these are solved, and found after it:

    z = H Δx + H_m Δm,    P⊥ z = P⊥ H Δx,    Δm = H_m⁺ (z − H Δx),    P⊥ = I − H_m H_m⁺

which is the joint least-squares solution, and leaves all that looks at H and z as it is for a single sensor.

Two sensors see the same attitude: e_i − e_j = A_i A_jᵀ at one time, whatever the gyro does. `compare_sensors` tests whether
they agree, as parity does for gyros.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from gyrocal import attitude
from gyrocal.errors import UnobservableError
from gyrocal.recording.trackers import compute_body_covariance

if TYPE_CHECKING:
    import pandas as pd

    from gyrocal.recording import Attitudes, Recording

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MISALIGNMENT_RANK_TOLERANCE = 1e-7  # of whitened columns of misalignments, relative to the largest: below it they are not seen
SAME_TIME = 0.5  # of a gyro sample: references within it are of one time
AXES = "xyz"


@dataclass(frozen=True)
class Mountings:
    """The misalignments that are estimated.

    Attributes
    ----------
    sensors : names of their sensors
    turns : (references, 3, q) error of each in body axes per rad of each, three a sensor about its own axes
    prior : (q,) 1-sigma, rad; infinite without one
    misalignment : (q,) rad, as adjusted so far
    """

    sensors: tuple[str, ...]
    turns: Array
    prior: Array
    misalignment: Array

    @classmethod
    def build(cls, attitudes: Attitudes) -> Mountings:
        """All at zero."""
        chosen = [k for k, one in enumerate(attitudes.sensors) if one.estimated]
        turns = np.zeros((attitudes.t_s.size, 3, 3 * len(chosen)))
        prior = np.full(3 * len(chosen), np.inf)
        for place, k in enumerate(chosen):
            one, own = attitudes.sensors[k], slice(3 * place, 3 * place + 3)
            turns[attitudes.sensor == k, :, own] = one.M.T
            if one.mounting_sigma is not None:
                prior[own] = one.mounting_sigma
        return cls(tuple(attitudes.sensors[k].name for k in chosen), turns, prior, np.zeros(prior.size))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(f"m_{sensor}_{axis}" for sensor in self.sensors for axis in AXES)

    def correct_attitudes(self, A: Array) -> Array:
        """Observed body attitudes (references, 3, 3) with the misalignments taken off, exp(−[(Mᵀ m)×]) A."""
        if not self.misalignment.any():
            return A
        return np.asarray(attitude.rotation_matrix(-self.turns @ self.misalignment) @ A)

    def compute_sensitivity(self, R: Array, start: Indices, row: Indices) -> Array:
        """∂θ/∂Δm (3m, q)."""
        return np.asarray(-(self.turns[row] - R @ self.turns[start]).reshape(3 * len(row), -1))

    def apply_correction(self, free: ReducedEquations | None, change: Array) -> Mountings:
        """Apply a correction Δx (p,) of the other parameters, scaled as H is."""
        return self if free is None else replace(self, misalignment=self.misalignment - free.step(change))

    def eliminate(self, H: Array, z: Array, Hm: Array) -> ReducedEquations:
        """Whitened equations without them; H (3m, p), z (3m,) and Hm (3m, q), group by group.

        Raises
        ------
        UnobservableError
            Some of them cannot be found, and have no prior.
        """
        known = np.flatnonzero(np.isfinite(self.prior))
        Hm = np.vstack([Hm, np.diag(1 / self.prior)[known]])
        H, z = np.vstack([H, np.zeros((known.size, H.shape[1]))]), np.append(z, (self.misalignment / self.prior)[known])
        size = np.linalg.norm(Hm, axis=0)
        U, s, Vt = np.linalg.svd(Hm / np.maximum(size, 1e-300), full_matrices=False)
        if (size == 0).any() or (s < MISALIGNMENT_RANK_TOLERANCE * s[0]).any():
            weak = [name for name, part in zip(self.names, np.abs(Vt[-1]), strict=True) if part > 0.3]
            raise UnobservableError(
                f"the mounting of {', '.join(self.sensors)} cannot be found from these references ({', '.join(weak)}); "
                "give mounting_sigma_deg, or take it as stated",
                tuple(weak),
            )
        inverse = (Vt.T / s @ U.T) / size[:, None]
        return ReducedEquations(H - U @ (U.T @ H), z - U @ (U.T @ z), H, z, inverse)


@dataclass(frozen=True)
class ReducedEquations:
    """Equations with the misalignments taken out, and what they were before.

    Attributes
    ----------
    H, z : without them
    whole_H, whole_z : with them, the rows of their priors at the end
    inverse : (q, rows) H_m⁺
    """

    H: Array
    z: Array
    whole_H: Array
    whole_z: Array
    inverse: Array

    def step(self, change: Array) -> Array:
        """Δm (q,) rad that belongs to Δx (p,), scaled as H is."""
        return np.asarray(self.inverse @ (self.whole_z - self.whole_H @ change))

    def covariance(self, P: Array) -> Array:
        """(q, q) of the misalignments, rad², from that of x (p, p), scaled as H is."""
        gain = self.inverse @ self.whole_H
        return np.asarray(self.inverse @ self.inverse.T + gain @ P @ gain.T)


@dataclass(frozen=True)
class MountingEstimate:
    """Misalignments as a calibration found them.

    Attributes
    ----------
    sensors : names of their sensors
    misalignment : (3 sensors,) about each one's own axes, rad
    covariance : of those, rad²
    """

    sensors: tuple[str, ...]
    misalignment: Array
    covariance: Array

    def summary(self) -> pd.DataFrame:
        """A row for each sensor and axis: misalignment and its sigma, arcsec."""
        import pandas as pd  # late: 65 MiB that a Monte Carlo worker does without

        arcsec = np.rad2deg(3600.0)
        return pd.DataFrame(
            {
                "sensor": np.repeat(self.sensors, 3),
                "axis": list(AXES) * len(self.sensors),
                "misalignment_arcsec": arcsec * self.misalignment,
                "sigma_arcsec": arcsec * np.sqrt(np.diag(self.covariance)),
            }
        )


def estimate(mountings: Mountings | None, eliminated: ReducedEquations | None, P: Array) -> MountingEstimate | None:
    """Build the estimate, with the covariance P of the other parameters, scaled as H is; None if no mounting is estimated."""
    if mountings is None or eliminated is None:
        return None
    return MountingEstimate(mountings.sensors, mountings.misalignment, eliminated.covariance(P))


def count_free_mountings(mountings: Mountings | None) -> int:
    """Number of misalignments without a prior; one with a prior brings an equation of its own."""
    return 0 if mountings is None else int(np.sum(~np.isfinite(mountings.prior)))


# ---- sensors against one another -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Difference:
    """Two sensors compared at the times that both have.

    Attributes
    ----------
    first, second : their names
    t_s, interval : (k,) times and interval of each pair
    apart : (k, 3) attitude by the second minus by the first, in body axes, rad
    whitened : (k, 3) the same in units of their noise
    estimated : whether a constant misalignment was taken off, which had no prior
    """

    first: str
    second: str
    t_s: Array
    interval: Indices
    apart: Array
    whitened: Array
    estimated: bool

    @property
    def dof(self) -> int:
        """Numbers compared less parameters."""
        return self.whitened.size - 3 * self.estimated

    @property
    def chi2(self) -> float:
        """Square sum in units of the noise."""
        return float(np.sum(self.whitened**2))

    @property
    def p_value(self) -> float:
        """Probability of a larger one if both are as stated; NaN without degrees of freedom."""
        return float(chdtrc(self.dof, self.chi2)) if self.dof > 0 else float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        rms = np.rad2deg(3600.0) * np.sqrt(np.mean(self.apart**2, axis=0))
        return {
            "sensors": [self.first, self.second],
            "pairs": len(self.t_s),
            "rms_arcsec": rms.tolist(),
            "chi2": self.chi2,
            "degrees_of_freedom": self.dof,
            "p_value": self.p_value if self.dof > 0 else None,
        }


def compare_sensors(recording: Recording) -> tuple[Difference, ...]:
    """Each two sensors against one another, where both have a reference within half a gyro sample.

    The body turns by ω Δt between the two of a pair, which is taken off by the gyro as it is known beforehand. Where one of
    them has a mounting that is estimated, their best constant misalignment is taken off as well, as far as its prior allows.
    """
    attitudes = recording.attitudes
    if len(attitudes.sensors) < 2 or attitudes.sensor is None:
        return ()
    noise, inertial, out = compute_body_covariance(attitudes), Rotation.from_quat(attitudes.quaternions), []
    for i, j in combinations(range(len(attitudes.sensors)), 2):
        a, b = _pair_references(recording, i, j)
        if not a.size:
            continue
        # A_b A_aᵀ = exp([d×]), with d = e_b − e_a.
        apart = attitude.residual(inertial[b].as_matrix().transpose(0, 2, 1), inertial[a].as_matrix().transpose(0, 2, 1))
        apart = apart + _compute_pair_turns(recording, attitudes.t_s[b], attitudes.t_s[a])
        L = np.linalg.cholesky(noise[a] + noise[b])
        white = np.linalg.solve(L, apart[:, :, None])[:, :, 0]
        both = [attitudes.sensors[k] for k in (i, j) if attitudes.sensors[k].estimated]
        loose = any(one.mounting_sigma is None for one in both)
        if both:
            sides = [one.M.T * (1.0 if one.mounting_sigma is None else one.mounting_sigma) for one in both]
            white = _remove_turn(np.linalg.solve(L, np.broadcast_to(np.eye(3), L.shape)), np.hstack(sides), white, loose)
        names = attitudes.sensors[i].name, attitudes.sensors[j].name
        out.append(Difference(*names, attitudes.t_s[a], _find_intervals(recording, attitudes.t_s[a]), apart, white, loose))
    return tuple(out)


def _remove_turn(inverse: Array, spread: Array, white: Array, loose: bool) -> Array:
    """(k, 3) whitened differences under a constant turn: B Bᵀ = spread spreadᵀ of it is more noise, or it is taken out.

    With the columns C = L⁻¹ B of all pairs, (I + C Cᵀ)^−½ z is white again; a turn without a prior leaves z − C C⁺ z.
    """
    U, s, _ = np.linalg.svd((inverse @ spread).reshape(white.size, -1), full_matrices=False)
    U, s = U[:, s > MISALIGNMENT_RANK_TOLERANCE * s[0]], s[s > MISALIGNMENT_RANK_TOLERANCE * s[0]]
    factor = np.zeros_like(s) if loose else 1 / np.sqrt(1 + s**2)
    return np.asarray(white + (U @ ((factor - 1) * (U.T @ white.ravel()))).reshape(-1, 3))


def format_tracker_results(mountings: MountingEstimate | None, compared: Sequence[Difference]) -> dict[str, Any]:
    """Return the plain values of several sensors; none of one sensor."""
    found: dict[str, Any] = {}
    if mountings is not None:
        found["mountings"] = mountings.summary().to_dict("records")
    if compared:
        found["tracker_differences"] = [one.to_json() for one in compared]
    return found


def _pair_references(recording: Recording, i: int, j: int) -> tuple[Indices, Indices]:
    """Rows of references of two sensors at nearly the same time, each used once."""
    t_s, sensor = recording.attitudes.t_s, recording.attitudes.sensor
    first, second = np.flatnonzero(sensor == i), np.flatnonzero(sensor == j)
    if not first.size or not second.size:
        return first[:0], second[:0]
    after = np.clip(np.searchsorted(t_s[second], t_s[first]), 0, second.size - 1)
    before = np.maximum(after - 1, 0)
    nearer = np.where(np.abs(t_s[second][before] - t_s[first]) < np.abs(t_s[second][after] - t_s[first]), before, after)
    near = np.abs(t_s[second][nearer] - t_s[first]) <= SAME_TIME * recording.gyro.sample_s
    taken, once = np.unique(nearer[near], return_index=True)
    return first[near][once], second[taken]


def _compute_pair_turns(recording: Recording, later: Array, earlier: Array) -> Array:
    """(k, 3) angle in body axes that the body turns from the earlier to the later time of each pair, rad."""
    gyro, gap = recording.gyro, later - earlier
    if not gap.any():
        return np.zeros((later.size, 3))
    row = np.clip(np.searchsorted(gyro.t_s, np.minimum(later, earlier), side="right") - 1, 0, gyro.t_s.size - 1)
    rates = np.nan_to_num(gyro.rates[row]) @ gyro.apriori_G.T + gyro.apriori_bias
    return np.asarray(rates * gap[:, None])


def _find_intervals(recording: Recording, t_s: Array) -> Indices:
    starts = np.array([one.start_s for one in recording.intervals])
    order = np.argsort(starts)
    return np.asarray(order[np.clip(np.searchsorted(starts[order], t_s + 1e-6, side="right") - 1, 0, None)])
