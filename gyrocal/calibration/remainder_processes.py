"""Random processes that a remainder consists of, and how each reaches the attitude residuals.

With the signs of `gyrocal.calibration.covariance`, residual j of an interval is

    θ_j = Θ_j Δx + e_j − R_j e_0 + R_j Σ_{l ≤ j} u_l,p x_p,l,    u_l,p = R_lᵀ (Θ_l − R_l R_{l−1}ᵀ Θ_{l−1})_p.

u_l,p is the turn, in the axes of the start, by an error of parameter p that lasts from reference l − 1 to l only. A *rate*
process is a wander x_p(t) of some of the twelve parameters: of a bias it is a rate error about a body axis, of an element of G
it is a rate error proportional to a raw rate. A *reference* process is an error e of the references about a body axis. A
*delay* process is an error d of their time tags, e = ω d with the body rate ω.

Each process has unit variance times its size. It is white (time scale 0), an Ornstein-Uhlenbeck process with the correlation
exp(−|Δt|/τ), or constant (time scale ∞): a wander of a parameter keeps constant within an interval, a delay for good. Between
references stands the mean of x over the stretch. Over stretches of lengths a and b, whose nearest ends are g apart,

    cov = τ²/(a b) (1 − e^{−a/τ}) (1 − e^{−b/τ}) e^{−g/τ},    var = 2 τ/a (1 − τ/a (1 − e^{−a/τ})),

and for white x of power spectral density q, var = q/a.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gyrocal.arrays import Array, Indices

Kind = Literal["rate", "reference", "delay"]

BIAS_INDICES = (9, 10, 11)  # places of b_x, b_y, b_z among the twelve parameters
SCALE_FACTOR_INDICES = (0, 4, 8)
MISALIGNMENT_INDICES = (1, 2, 3, 5, 6, 7)
NOMINAL, WITH_REMAINDER = "nominal", "with_remainder"  # which sigmas are recommended
SIGNIFICANT = 0.01  # p-value of the likelihood ratio below which the sigmas with remainder are recommended
DEG_H_PER_RAD_S = float(np.rad2deg(3600.0))
CORRELATION_BLOCK_ROWS = 1000  # rows of a correlation matrix that are made at a time
VARIANCE_SERIES_LIMIT = 1e-4  # of a stretch over a time scale, below which the series of its variance is used


@dataclass(frozen=True)
class Process:
    """One random process of a remainder."""

    kind: Kind  # "rate" for a wander of parameters, "reference" or "delay"
    # places of the parameters among the twelve, or body axes of the references; each has a process of its own
    members: tuple[int, ...]
    time_scale_s: float  # 0 for white, infinite for constant
    # of a rate process in units of the parameter, (rad/s)² or 1, times s where it is white; of references in rad²; of a delay
    # in s²
    variance: float = 1.0

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values; a constant process has no time scale."""
        finite = np.isfinite(self.time_scale_s)
        return {
            "kind": self.kind,
            "members": list(self.members),
            "time_scale_s": self.time_scale_s if finite else None,
            "variance": self.variance,
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> Process:
        """Read what `to_json` gives."""
        scale = value["time_scale_s"]
        return cls(value["kind"], tuple(value["members"]), np.inf if scale is None else float(scale), float(value["variance"]))


@dataclass(frozen=True)
class Remainder:
    """The remainder of a calibration."""

    processes: tuple[Process, ...]  # with their sizes; those of size zero are left out
    noise_factor: float  # φ, of the variance of all stated noise
    log_likelihood_gain: float  # above that of the stated noise alone
    p_value: float  # probability of a larger gain without a remainder
    covariance: Array  # (12, 12) of G and b with the remainder; b in rad/s

    @property
    def is_significant(self) -> bool:
        """Whether the residuals do not fit the stated noise."""
        return self.p_value < SIGNIFICANT

    @property
    def sigma(self) -> Array:
        """(12,) 1-sigma of G and b with the remainder; b in rad/s."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def gyro(self) -> Array:
        """(3,) 1-sigma of the rate error about each body axis that lasts, rad/s."""
        return self._sum_sizes(BIAS_INDICES, lambda process: process.kind == "rate" and process.time_scale_s > 0)

    @property
    def rate_noise(self) -> Array:
        """(3,) root PSD of the white rate error about each body axis beside the stated one, rad/√s."""
        return self._sum_sizes(BIAS_INDICES, lambda process: process.kind == "rate" and process.time_scale_s == 0)

    @property
    def reference(self) -> Array:
        """(3,) 1-sigma of the references' error about each body axis beside the stated one, rad."""
        return self._sum_sizes(range(3), lambda process: process.kind == "reference")

    def _sum_sizes(self, members: Sequence[int], is_chosen: Callable[[Process], bool]) -> Array:
        """Compute the root of the summed variances of the chosen processes of each member."""
        chosen = [process for process in self.processes if is_chosen(process)]
        return np.array(
            [np.sqrt(sum(selected.variance for selected in chosen if member in selected.members)) for member in members]
        )

    @property
    def delay_s(self) -> float:
        """1-sigma of the delay of the references' time tags, s."""
        return float(np.sqrt(sum(process.variance for process in self.processes if process.kind == "delay")))

    @property
    def time_scale_s(self) -> Array:
        """(3,) time scale of the rate error about each axis, s: geometric mean of finite ones by variance; NaN if none."""
        return np.array([_average_time_scale(self.processes, axis) for axis in BIAS_INDICES])

    def to_json(self) -> dict[str, Any]:
        """Convert to plain values; lists are by body axis."""
        scales = [float(value) if np.isfinite(value) else None for value in self.time_scale_s]
        return {
            "gyro_deg_h": (self.gyro * DEG_H_PER_RAD_S).tolist(),
            "rate_noise_deg_per_sqrt_s": np.rad2deg(self.rate_noise).tolist(),
            "reference_deg": np.rad2deg(self.reference).tolist(),
            "time_scale_s": scales,
            "delay_s": self.delay_s,
            "noise_factor": self.noise_factor,
            "log_likelihood_gain": self.log_likelihood_gain,
            "p_value": self.p_value,
            "processes": [process.to_json() for process in self.processes],
        }


def read_processes(value: Mapping[str, Any]) -> tuple[Process, ...]:
    """Read the processes of what `Remainder.to_json` gives."""
    return tuple(Process.from_json(entry) for entry in value["processes"])


@dataclass(frozen=True)
class Stretches:
    """Times over which a wander of parameters is averaged."""

    # from_s, to_s: (n,) s
    from_s: Array
    to_s: Array
    interval: Indices  # (n,) that each belongs to

    def covariance(self, process: Process, rows: slice = slice(None)) -> Array:
        """Compute the covariance (rows, n) of the means of a process of unit variance."""
        low, high, interval = self.from_s[rows, None], self.to_s[rows, None], self.interval[rows, None]
        a, b, tau = high - low, self.to_s - self.from_s, process.time_scale_s
        same = (low == self.from_s) & (high == self.to_s) & (interval == self.interval)
        if tau == 0:
            return np.where(same, 1 / a, 0.0)
        if np.isinf(tau):
            return np.asarray((interval == self.interval).astype(np.float64))
        gap = np.maximum(np.maximum(low - self.to_s, self.from_s - high), 0.0)
        between = _compute_mean_decay(a / tau) * _compute_mean_decay(b / tau) * np.exp(-gap / tau)
        return np.where(same, _compute_mean_variance(a / tau), between)


def correlate_references(process: Process, t_s: Array, others_s: Array) -> Array:
    """Compute the correlation (n, k) of a process of references or delays at times (n,) and (k,) s."""
    lag = np.abs(np.subtract.outer(t_s, others_s))
    if process.time_scale_s == 0:
        return np.asarray((lag == 0).astype(np.float64))
    return np.asarray(np.exp(-lag / process.time_scale_s))


def compute_turns(R: Array, Theta: Array, interval: Indices) -> Array:
    """Compute u (m, 3, 12), the attitude error in the start's axes per unit parameter error since the output before.

    R, Theta: (m, 3, 3) rotation and (m, 3, 12) sensitivity since the interval's start, by interval in the order of time
    interval: (m,) number of each output's interval
    """
    cumulative = np.einsum("mji,mjp->mip", R, Theta)
    turns = cumulative.copy()
    same_interval = interval[1:] == interval[:-1]
    turns[1:][same_interval] -= cumulative[:-1][same_interval]
    return turns


def _compute_mean_decay(x: Array) -> Array:
    """Compute (1 − e^{−x})/x."""
    return np.asarray(-np.expm1(-x) / x)


def _compute_mean_variance(x: Array) -> Array:
    """Compute 2/x (1 − (1 − e^{−x})/x)."""
    return np.asarray(np.where(x < VARIANCE_SERIES_LIMIT, 1 - x / 3, 2 / x * (1 - _compute_mean_decay(x))))


def _average_time_scale(processes: Sequence[Process], axis: int) -> float:
    """Average the logarithms of the finite time scales of one axis by variance; NaN if there are none."""
    correlated = [
        process
        for process in processes
        if process.kind == "rate" and axis in process.members and 0 < process.time_scale_s < np.inf
    ]
    if not correlated:
        return float("nan")
    weights = np.array([member.variance for member in correlated])
    return float(np.exp(weights @ np.log([member.time_scale_s for member in correlated]) / weights.sum()))
