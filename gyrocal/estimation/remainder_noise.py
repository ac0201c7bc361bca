"""Noise of a prediction by gyro with the remainder of a calibration in it.

Beside the stated noise, of which the variance counts φ times, the attitude error R(t) w(t) of `gyrocal.estimation.predict` has
the turns of all rate processes of the remainder, and the references have the errors of its reference and delay processes. With
M_k the columns of `gyrocal.calibration.remainder_processes`,

    cov(R w)(s, t) = φ ARW² min(s, t) R(s) R(t)ᵀ + Σ_k θ_k M_k(s) ρ_k M_k(t)ᵀ,
    cov(e_i, e_j) = φ δ_ij diag(σ_i²) + Σ_k θ_k ρ_k(t_i − t_j) d_i d_jᵀ,

d the direction of an error, a body axis or for a delay the body rate. White rate errors accumulate between any two times. The
others are constant in each of at most `MOST_BINS` equal bins of the stretch, with the covariance of the means over these.

A reading at time t has an error of its own that correlates with those of the references used. With the gain K of the attitude
estimate, the reading differs from the prediction by a covariance of

    cov(c − ĉ) + cov(e) − K C − (K C)ᵀ,    C = cov(e_used, e(t)).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrocal.calibration.parameters import GyroParameters
from gyrocal.calibration.remainder_processes import (
    WITH_REMAINDER,
    Process,
    Stretches,
    compute_turns,
    correlate_references,
    read_processes,
)
from gyrocal.calibration.result import DEGREES, CalibrationResult
from gyrocal.errors import InputError
from gyrocal.recording import Recording

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST_BINS = 60  # that rate errors are constant in; time grows with the square
LARGEST_BYTES = 200_000_000  # of a result of a calibration, with all its residuals


@dataclass(frozen=True)
class RemainderNoise:
    """Noise beside the stated one, and the factor of that.

    Attributes
    ----------
    processes : of the gyro, the references and their time tags
    factor : φ, of the variance of the stated noise
    """

    processes: tuple[Process, ...] = ()
    factor: float = 1.0

    def compute_reference_covariance(self, t_s: Array, rates: Array, others_s: Array, other_rates: Array) -> Array:
        """Compute the covariance (n, 3, k, 3) of the errors of references at two sets of times without the stated noise, rad².

        Parameters
        ----------
        t_s, others_s : (n,) and (k,) s
        rates, other_rates : (n, 3) and (k, 3) body rates there, rad/s
        """
        total = np.zeros((t_s.size, 3, others_s.size, 3))
        for process in self.processes:
            if process.kind == "rate":
                continue
            correlation = process.variance * correlate_references(process, t_s, others_s)
            if process.kind == "delay":
                total += np.einsum("ai,bj,ab->aibj", rates, other_rates, correlation)
            else:
                for axis in process.members:
                    total[:, axis, :, axis] += correlation
        return total


@dataclass(frozen=True)
class GyroWalk:
    """The gyro's integrated noise at the start and at the outputs of a stretch.

    Attributes
    ----------
    R : (n + 1, 3, 3) from the start to each node
    elapsed_s : (n + 1,) s
    arw : root PSD of the rates' noise, the factor φ included, rad/√s
    turns : (n, 3, 12) of `compute_turns`
    noise : of the remainder
    """

    R: Array
    elapsed_s: Array
    arw: float
    turns: Array
    noise: RemainderNoise
    edges: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))  # nodes between which bins lie

    @classmethod
    def build(cls, R: Array, Theta: Array, elapsed_s: Array, arw: float, noise: RemainderNoise) -> GyroWalk:
        """Build from R (n + 1, 3, 3) and Θ (n + 1, 3, 12) at the nodes."""
        turns = compute_turns(R[1:], Theta[1:], np.zeros(len(R) - 1, dtype=np.intp))
        wanted = np.linspace(0.0, elapsed_s[-1], MOST_BINS + 1)
        edges = np.unique(np.append(np.searchsorted(elapsed_s, wanted[:-1]), elapsed_s.size - 1))
        return cls(R, elapsed_s, arw * float(np.sqrt(noise.factor)), turns, noise, edges)

    def covariance(self, left: Indices, right: Indices) -> Array:
        """Compute the covariance (3 left, 3 right) of R w at two sets of nodes, rad²."""
        white = self.arw**2 * np.minimum.outer(self.elapsed_s[left], self.elapsed_s[right])
        total = np.einsum("aik,bjk,ab->aibj", self.R[left], self.R[right], white, optimize=True)
        if self._white is not None:
            total += np.einsum(
                "aik,abkl,bjl->aibj", self.R[left], self._white[np.minimum.outer(left, right)], self.R[right], optimize=True
            )
        total = total.reshape(3 * left.size, 3 * right.size)
        for process, member in self._correlated_processes:
            correlation = process.variance * self._stretches.covariance(process)
            total += self._build_columns(member, left) @ correlation @ self._build_columns(member, right).T
        return np.asarray(total)

    def variances(self, nodes: Indices) -> Array:
        """Compute the covariance (nodes, 3, 3) of R w at each node by itself, rad²."""
        R = self.R[nodes]
        total = self.arw**2 * self.elapsed_s[nodes][:, None, None] * np.eye(3)
        if self._white is not None:
            total = total + R @ self._white[nodes] @ R.transpose(0, 2, 1)
        for process, member in self._correlated_processes:
            columns = self._build_columns(member, nodes)
            spread = (columns @ (process.variance * self._stretches.covariance(process))).reshape(nodes.size, 3, -1)
            total = total + spread @ columns.reshape(nodes.size, 3, -1).transpose(0, 2, 1)
        return np.asarray(total)

    @property
    def _correlated_processes(self) -> list[tuple[Process, int]]:
        own = [one for one in self.noise.processes if one.kind == "rate" and one.time_scale_s > 0]
        return [(one, member) for one in own for member in one.members]

    @property
    def _white(self) -> Array | None:
        """(n + 1, 3, 3) covariance of the turns by white rate errors in the axes of the start; None without such errors."""
        own = [one for one in self.noise.processes if one.kind == "rate" and one.time_scale_s == 0]
        if not own:
            return None
        steps = np.zeros((self.turns.shape[0], 3, 3))
        for process in own:
            for member in process.members:
                u = self.turns[:, :, member]
                steps += process.variance * u[:, :, None] * u[:, None, :] / np.diff(self.elapsed_s)[:, None, None]
        return np.concatenate([np.zeros((1, 3, 3)), steps.cumsum(axis=0)])

    @property
    def _stretches(self) -> Stretches:
        times = self.elapsed_s[self.edges]
        return Stretches(times[:-1], times[1:], np.zeros(times.size - 1, dtype=np.intp))

    def _build_columns(self, member: int, nodes: Indices) -> Array:
        """(3 nodes, bins) turn at each node by an error of one parameter in each bin."""
        turned = np.concatenate([np.zeros((1, 3)), self.turns[:, :, member].cumsum(axis=0)])
        low, high = self.edges[:-1], self.edges[1:]
        along = turned[np.clip(nodes[:, None], low, high)] - turned[low]
        return np.asarray(np.einsum("aij,abj->aib", self.R[nodes], along).reshape(3 * nodes.size, -1))


@dataclass(frozen=True)
class KnownCalibration:
    """A calibration that a prediction starts from.

    Attributes
    ----------
    parameters : G and b
    covariance : (12, 12) the recommended one; b in rad/s
    noise : the remainder, without processes where the nominal covariance is recommended
    """

    parameters: GyroParameters
    covariance: Array
    noise: RemainderNoise

    @classmethod
    def build(cls, result: CalibrationResult) -> KnownCalibration:
        """Take the recommended covariance of a result of `gyrocal.calibrate`, and its remainder."""
        if result.recommended != WITH_REMAINDER or result.remainder is None:
            return cls(result.parameters, result.covariance, RemainderNoise())
        found = result.remainder
        return cls(result.parameters, found.covariance, RemainderNoise(found.processes, found.noise_factor))

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with these parameters as its a-priori ones."""
        gyro = replace(recording.gyro, apriori_G=self.parameters.G, apriori_bias=self.parameters.bias)
        return replace(recording, gyro=gyro)


def read_calibration(path: Path) -> KnownCalibration:
    """Read the JSON that ``gyrocal calibrate --json`` writes.

    Raises
    ------
    InputError
        The file is no such result.
    """
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST_BYTES + 1)
        if len(text) > LARGEST_BYTES:
            raise ValueError(f"it has more than {LARGEST_BYTES} bytes")
        document = json.loads(text)
        parameters = GyroParameters(np.array(document["G"], dtype=float), np.deg2rad(document["bias_deg_s"]))
        with_remainder = document.get("recommended") == WITH_REMAINDER
        covariance = np.array(document["covariance_with_remainder" if with_remainder else "covariance"], dtype=float)
        if covariance.shape != (12, 12) or not np.isfinite(covariance).all() or (np.diag(covariance) < 0).any():
            raise ValueError("its covariance is not 12×12, finite and with positive variances")
        noise = RemainderNoise()
        if with_remainder:
            noise = RemainderNoise(read_processes(document["remainder"]), float(document["remainder"]["noise_factor"]))
            _check(noise.processes, noise.factor)
        return KnownCalibration(parameters, covariance / np.outer(DEGREES, DEGREES), noise)
    except OSError as fault:
        raise InputError(f"{path}: {fault.strerror}") from None
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as fault:
        raise InputError(f"{path}: not a result of 'gyrocal calibrate --json': {fault}") from None


def _check(processes: Iterable[Process], factor: float) -> None:
    """Refuse sizes that are no variances."""
    for one in processes:
        most: Sequence[int] = range(12) if one.kind == "rate" else range(3)
        if one.kind not in ("rate", "reference", "delay") or not set(one.members) <= set(most):
            raise ValueError(f"a process of kind {one.kind!r} with members {list(one.members)} is unknown")
        if not (0 <= one.variance < np.inf and one.time_scale_s >= 0):
            raise ValueError("a process has a variance or a time scale that is negative or not finite")
    if not 0 < factor < np.inf:
        raise ValueError("its noise factor is not positive and finite")
