"""Innovations of all references under M0, and the misfit that they show.

The candidates of a diagnosis are seen in at most `MOST_OBSERVATIONS` attitudes, to which neighbouring references are averaged,
and each has its own shape. Faster errors and errors of other shapes must show as well. So every reference is compared with the
attitude that the gyro propagates from those before it. Under M0 the residuals ζ of an interval are a random walk, the gyro's
integrated noise, seen with the references' white noise, and its start is unknown. The innovations of a Kalman filter that
starts from the interval's first reference,

    v_k = ζ_k − x,    S = P + ΔW_k + R_k,    e_k = L⁻¹ v_k  (L Lᵀ = S),    x ← x + K v_k,    K = (P + ΔW_k) S⁻¹,

are N(0, I) and independent (Kailath, IEEE Transactions on Automatic Control 13, 1968); those of the columns of G and b are
projected out of them. G turns the readings' errors into those of the rates and has an inverse, so that the columns may be
those of either. The tests are those of `diagnosis.inference.criticism`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from diagnosis.answer import Finding
from diagnosis.inference.criticism import FEWEST, Check, Innovations, check_innovations
from diagnosis.model.layout import tabulate_references
from diagnosis.model.recording_model import RANK, RecordingModel, build_parameter_errors
from gyrocal.calibration.estimated_noise import count_noise_degrees
from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, solve_lower
from simulator.effects.base import Effect, Value

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

TEXTS = {  # of each test, with its value and the expected one
    "size": "have a χ² of {value:.4g} for {expected:.4g} degrees of freedom",
    "dependence on what is known": "follow rates, temperatures or time: χ² {value:.4g} for {expected:.4g}",
    "correlation in time": "correlate in time: χ² {value:.4g} for {expected:.4g}",
    "scatter over intervals and rates": "scatter differently over intervals or rates: χ² {value:.4g} for {expected:.4g}",
    "shape": "have a kurtosis of {value:.3g}, where normal ones have {expected:.3g}",
}
LEAST_POSITIVE = 1e-300


def check_baseline(model: RecordingModel, beside: Sequence[Array] = ()) -> tuple[Check, ...]:
    """Test M0's innovations of all references; no tests where there are too few.

    Parameters
    ----------
    model : of the recording, about its calibration under M0
    beside : (m, 3, k) attitude errors that are estimated with G and b, such as those of an identified effect
    """
    lines = [] if model.lines is None else [model.compute_attitude_turns(model.lines)]
    e, later, taken = compute_innovations(model, [*beside, *lines])
    found = Innovations(e, taken.reshape(*e.shape, -1))
    if found.dof < FEWEST:
        return ()
    return tuple(check_innovations(found, tabulate_references(model, later), count_noise_degrees(model.recording, found.dof)))


def list_findings(checks: Sequence[Check], event_p: float) -> tuple[Finding, ...]:
    """List the significant tests for where a recording departs; p-values have an allowance for the number of tests."""
    return tuple(
        Finding(
            "attitude", None, None, None, one.name, one.value, min(1.0, one.p_value * len(checks)),
            f"the innovations of all references {TEXTS[one.name].format(value=one.value, expected=one.expected)}",
        )
        for one in checks
        if one.p_value * len(checks) < event_p
    )  # fmt: skip


def compute_attitude_errors(model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value]) -> Array:
    """Compute the attitude errors (m, 3, k) of an effect with columns at every reference, inertial axes."""
    if effect.on_references:
        return -np.matmul(model.at_reference, effect.reference_columns(model.references, axis, parameters))
    return model.compute_attitude_turns(effect.columns(model.stream, axis, parameters))


def compute_innovations(model: RecordingModel, beside: Sequence[Array] = ()) -> tuple[Array, Mask, Array]:
    """Compute white innovations about the body axes (k, 3), their references (m,), and a basis (3k, q) of what the fit took."""
    left, later, U = project_innovations(model, model.residuals[:, :, None], beside)
    return left.reshape(-1, 3), later, U


def project_innovations(model: RecordingModel, errors: Array, beside: Sequence[Array] = ()) -> tuple[Array, Mask, Array]:
    """Compute the same of any attitude errors at every reference, inertial axes: (m, 3, c) → (3k, c)."""
    count = errors.shape[2]
    white, later = whiten_errors(
        model, np.concatenate([errors, model.compute_attitude_turns(build_parameter_errors(model.raw)), *beside], axis=2)
    )
    y, U = white[:, :count], build_basis(white[:, count:])
    return np.asarray(y - U @ (U.T @ y)), later, U


def whiten_errors(model: RecordingModel, columns: Array) -> tuple[Array, Mask]:
    """Turn attitude errors (m, 3, c) in inertial axes into innovations (3k, c) about the body axes, of the references (m,)."""
    first = np.diff(model.interval_of_reference, prepend=-1) != 0
    added = np.diff(model.walk, axis=0, prepend=model.walk[:1])
    added[first] = 0.0
    white = _whiten_innovations(columns, added, model.errors, first)[~first]
    body = np.matmul(model.at_reference[~first].transpose(0, 2, 1), white)
    return body.reshape(3 * len(body), -1), ~first


def build_basis(columns: Array) -> Array:
    """Build an orthonormal basis of columns (n, c), without directions that add nothing to the others."""
    U, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), LEAST_POSITIVE), full_matrices=False)
    return np.asarray(U[:, s > RANK * s[0]])


@compile_cached
def _whiten_innovations(z: Array, added: Array, R: Array, first: Mask) -> Array:
    """(m, 3, k) innovations over their root covariance, column by column; zero at the first reference of each interval."""
    out = np.zeros(z.shape)
    P, x = np.zeros((3, 3)), np.zeros((3, z.shape[2]))
    for k in range(len(z)):
        if first[k]:
            P, x = R[k].copy(), z[k].copy()
            continue
        P = P + added[k]
        S = P + R[k]
        L = compute_lower_root(S)
        white, half = solve_lower(L, z[k] - x), solve_lower(L, P)  # K v = (L⁻¹P)ᵀ L⁻¹v, and K P = (L⁻¹P)ᵀ L⁻¹P
        out[k] = white
        for i in range(3):
            for a in range(3):
                for j in range(x.shape[1]):
                    x[i, j] += half[a, i] * white[a, j]
                for j in range(3):
                    P[i, j] -= half[a, i] * half[a, j]
    return out
