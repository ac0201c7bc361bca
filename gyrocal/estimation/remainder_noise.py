"""Noise of a prediction by gyro with the remainder of a calibration in it.

Beside the stated noise, of which the variance counts φ times, the attitude error R(t) w(t) of `gyrocal.estimation.predict` has
the turns of all rate processes of the remainder, and the references have the errors of its reference and delay processes. With
M_k the columns of `gyrocal.calibration.remainder_processes`,

    cov(R w)(s, t) = φ ARW² min(s, t) R(s) R(t)ᵀ + Σ_k θ_k M_k(s) ρ_k M_k(t)ᵀ,
    cov(e_i, e_j) = φ δ_ij diag(σ_i²) + Σ_k θ_k ρ_k(t_i − t_j) d_i d_jᵀ,

d the direction of an error, a body axis or for a delay the body rate. `gyrocal.estimation.error_smoother` has them as a Markov
process.

A reading at time t has an error of its own, e, that correlates with those of the references used. With ê what these say of e,
it differs from the prediction ĉ by a covariance of cov(c − ĉ) + cov(e) + X + Xᵀ, X = cov(c − ĉ, e − ê).
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gyrocal.arrays import Array
from gyrocal.calibration.parameters import GyroParameters
from gyrocal.calibration.remainder_processes import (
    WITH_REMAINDER,
    Process,
    read_processes,
)
from gyrocal.calibration.result import DEGREES, CalibrationResult
from gyrocal.errors import InputError
from gyrocal.recording import Recording

LARGEST_BYTES = 200_000_000  # of a result of a calibration, with all its residuals


@dataclass(frozen=True)
class RemainderNoise:
    """Noise beside the stated one, and the factor of that."""

    processes: tuple[Process, ...] = ()  # of the gyro, the references and their time tags
    factor: float = 1.0  # φ, of the variance of the stated noise

    def build_reference_columns(self, rates: Array) -> Array:
        """Build the error (n, 3, q) of references by a unit of each state of `gyrocal.estimation.error_smoother`.

        rates: (n, 3) body rates at the references, rad/s.
        """
        columns = [np.zeros((*rates.shape, 0))]
        for process in self.processes:
            size = (*rates.shape, len(process.members))
            if process.kind == "delay":
                columns.append(rates[:, :, None])
            elif process.kind == "reference":
                columns.append(np.broadcast_to(np.eye(3)[:, list(process.members)], size))
            elif process.time_scale_s > 0:
                columns.append(np.zeros(size))
        return np.concatenate(columns, axis=2)


@dataclass(frozen=True)
class KnownCalibration:
    """A calibration that a prediction starts from."""

    parameters: GyroParameters  # G and b
    covariance: Array  # (12, 12) the recommended one; b in rad/s
    noise: RemainderNoise  # the remainder, without processes where the nominal covariance is recommended
    recording_sha256: str | None = None  # of the recording, where a file states it

    @classmethod
    def build(cls, result: CalibrationResult) -> KnownCalibration:
        """Build from a result of `gyrocal.calibrate`: its recommended covariance and its remainder."""
        if result.recommended != WITH_REMAINDER or result.remainder is None:
            return cls(result.parameters, result.covariance, RemainderNoise())
        remainder = result.remainder
        return cls(result.parameters, remainder.covariance, RemainderNoise(remainder.processes, remainder.noise_factor))

    def apply(self, recording: Recording) -> Recording:
        """Return the recording with these parameters as its a-priori ones."""
        gyro = replace(recording.gyro, apriori_G=self.parameters.G, apriori_bias=self.parameters.bias)
        return replace(recording, gyro=gyro)


def read_calibration(path: Path) -> KnownCalibration:
    """Read the JSON that ``gyrocal calibrate --json`` writes. An `InputError` if the file is no such result."""
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
            _check_processes(noise.processes, noise.factor)
        sha256 = document.get("provenance", {}).get("recording_sha256")
        return KnownCalibration(parameters, covariance / np.outer(DEGREES, DEGREES), noise, sha256)
    except OSError as fault:
        raise InputError(f"{path}: {fault.strerror}") from None
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as fault:
        reason = f"it has no {fault}" if isinstance(fault, KeyError) else fault
        raise InputError(f"{path}: not a result of 'gyrocal calibrate --json': {reason}") from None


def _check_processes(processes: Iterable[Process], factor: float) -> None:
    """Refuse processes of an unknown kind, and sizes that are no variances."""
    for process in processes:
        known_members: Sequence[int] = range(12) if process.kind == "rate" else range(3)
        if process.kind not in ("rate", "reference", "delay") or not set(process.members) <= set(known_members):
            raise ValueError(f"a process of kind {process.kind!r} with members {list(process.members)} is unknown")
        if not (0 <= process.variance < np.inf and process.time_scale_s >= 0):
            raise ValueError("a process has a variance or a time scale that is negative or not finite")
    if not 0 < factor < np.inf:
        raise ValueError("its noise factor is not positive and finite")
