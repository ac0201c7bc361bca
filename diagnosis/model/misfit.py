"""Innovations of all references under M0, and the misfit that they show.

The candidates of a diagnosis are fitted to at most `MOST_OBSERVATIONS` attitudes, to which neighbouring references are
averaged, and each has its own shape. To detect faster errors and errors of other shapes as well, every reference is compared
with the attitude that the gyro propagates from those before it. Under M0 the residuals ζ of an interval are a random walk, the
gyro's integrated noise, seen with the references' white noise, and its start is unknown. The innovations of a Kalman filter
that starts from the interval's first reference,

    v_k = ζ_k − x,    S = P + ΔW_k + R_k,    e_k = L⁻¹ v_k  (L Lᵀ = S),    x ← x + K v_k,    K = (P + ΔW_k) S⁻¹,

are N(0, I) and independent (Kailath, IEEE Transactions on Automatic Control 13, 1968); those of the columns of G and b are
projected out of them. G turns the readings' errors into those of the rates and has an inverse, so that the columns may be
those of either. The tests are those of `diagnosis.inference.criticism`.

The tests include whether innovations follow the rate and its changes. A measured rate contains the gyro's noise, and so do the
innovations of the references after it: for a body at rest, whose rates are mostly noise, the two would always correlate. An
innovation is independent of all noise that comes after it. The rate at a reference therefore is the mean of the readings that
follow it, of as many as bring their noise to `QUIET` of the scatter of the rates. An error of timing follows the change of the
rate since the reference before; where the noise of a reading is `HEARD` by that many innovations, the change until the
reference that comes next stands for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from diagnosis.answer import Finding
from diagnosis.arrays import LEAST_POSITIVE
from diagnosis.inference.criticism import FEWEST, Check, Innovations, Layout, check_innovations
from diagnosis.model.bins import find_steps
from diagnosis.model.recording_model import RecordingModel, build_basis, build_parameter_errors
from gyrocal.arrays import Array, Indices, Mask
from gyrocal.calibration.estimated_noise import count_noise_degrees
from gyrocal.jit_cache import compile_cached
from gyrocal.small_matrices import compute_lower_root, solve_lower
from simulator.effects.base import Effect, Value

TEXTS = {  # of each test, with its value and the expected one
    "size": "have a χ² of {value:.4g} for {expected:.4g} degrees of freedom",
    "dependence on what is known": "follow rates, temperatures or time: χ² {value:.4g} for {expected:.4g}",
    "correlation in time": "correlate in time: χ² {value:.4g} for {expected:.4g}",
    "scatter over intervals and rates": "scatter differently over intervals or rates: χ² {value:.4g} for {expected:.4g}",
    "shape": "have a kurtosis of {value:.3g}, where normal ones have {expected:.3g}",
}


QUIET = 0.25  # of the scatter of the rates, that their noise may have
# of the variance of the rates, from which on noise of readings times the number of innovations is too much
HEARD = 0.1
OUTLIER = 10.0  # sigma of a reading, beyond which it is replaced by the smoothed one


def check_baseline(model: RecordingModel) -> tuple[Check, ...]:
    """Test M0's innovations of all references, beside the lines in the readings; no tests where there are too few."""
    errors = [] if model.nuisance_errors is None else [model.compute_attitude_turns(model.nuisance_errors)]
    e, is_tested, fitted_basis = compute_innovations(model, errors)
    innovations = Innovations(e, fitted_basis.reshape(*e.shape, -1))
    if innovations.dof < FEWEST:
        return ()
    return tuple(
        check_innovations(
            innovations, tabulate_references(model, is_tested), count_noise_degrees(model.recording, innovations.dof)
        )
    )


def list_findings(checks: Sequence[Check], event_p: float) -> tuple[Finding, ...]:
    """List the significant tests for where a recording departs; p-values have an allowance for the number of tests."""
    return tuple(
        Finding(
            "attitude", None, None, None, check.name, check.value, min(1.0, check.p_value * len(checks)),
            f"the innovations of all references {TEXTS[check.name].format(value=check.value, expected=check.expected)}",
        )
        for check in checks
        if check.p_value * len(checks) < event_p
    )  # fmt: skip


def compute_attitude_errors(model: RecordingModel, effect: Effect, axis: str | None, parameters: Mapping[str, Value]) -> Array:
    """Compute the attitude errors (m, 3, k) of an effect with columns at every reference, inertial axes."""
    if effect.on_references:
        return -np.matmul(model.at_reference, effect.reference_columns(model.references, axis, parameters))
    return model.compute_attitude_turns(effect.columns(model.stream, axis, parameters))


def compute_innovations(model: RecordingModel, further_columns: Sequence[Array] = ()) -> tuple[Array, Mask, Array]:
    """Compute white innovations (k, 3) about body axes, a mask (m,) of their references, and the basis (3k, q) of the fit."""
    first = np.diff(model.interval_of_reference, prepend=-1) != 0
    walk_increments = np.diff(model.walk, axis=0, prepend=model.walk[:1])
    walk_increments[first] = 0.0
    parameter_errors = model.compute_attitude_turns(build_parameter_errors(model.raw))
    columns = np.concatenate([model.residuals[:, :, None], parameter_errors, *further_columns], axis=2)
    white = _whiten_innovations(columns, walk_increments, model.errors, first)[~first]
    body = np.matmul(model.at_reference[~first].transpose(0, 2, 1), white)
    body = body.reshape(3 * len(body), -1)
    y, U = body[:, :1], build_basis(body[:, 1:])
    return (y - U @ (U.T @ y)).reshape(-1, 3), ~first, U


@compile_cached
def _whiten_innovations(z: Array, added: Array, R: Array, first: Mask) -> Array:
    """Compute whitened innovations (m, 3, k), column by column; zero at the first reference of each interval."""
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


def tabulate_references(model: RecordingModel, selected: Mask) -> Layout:
    """Tabulate the axes, intervals and regressors of the innovations of some references (m,)."""
    t_s, block = model.recording.attitudes.t_s[model.reference_rows], model.interval_of_reference
    rates, change = measure_motion(model, model.reference_rows, block)
    place = find_steps(model, t_s, block)
    housekeeping = [values[place] for values in model.stream.housekeeping.values()]
    mission = (t_s - t_s.mean()) / max(float(np.ptp(t_s)), 1.0)
    regressors = np.column_stack([rates, np.abs(rates), change, mission, mission**2, *housekeeping])
    axes, speed = model.at_reference.transpose(0, 2, 1), np.linalg.norm(rates, axis=1)
    return Layout(axes[selected], block[selected], regressors[selected], speed[selected])


def measure_motion(model: RecordingModel, references: Indices, block: Indices) -> tuple[Array, Array]:
    """Measure the rate about each axis at references (r,), and its change, without the noise of their innovations.

    References are rows of the recording, in the order of time within each block. The change (r, 3), rad/s, is that since the
    reference before, or where that would hold their noise until the next; 0 without one.
    """
    gyro, t_s = model.recording.gyro, model.recording.attitudes.t_s[references]
    first, stop = np.array([(entry.steps.start, entry.steps.stop - 1) for entry in model.blocks])[block].T
    smooth = model.rates[np.clip(np.searchsorted(model.t_s, t_s), first, stop)]
    noise = (gyro.arw**2 / gyro.sample_s) / np.maximum(smooth.var(axis=0), LEAST_POSITIVE)
    first, stop = np.searchsorted(gyro.t_s, model.t_s[first]), np.searchsorted(gyro.t_s, model.t_s[stop])
    available = np.maximum(1, (stop - first) // np.bincount(block)[block])  # no more than lie between two references
    count = np.clip(np.ceil(noise / QUIET**2).astype(np.intp), 1, available[:, None])
    next_sample = np.searchsorted(gyro.t_s, t_s - 0.5 * gyro.sample_s)[:, None]
    total = _accumulate_readings(model)
    rates = _average_readings(total, next_sample, np.minimum(next_sample + count, stop[:, None]), smooth)
    low, high = np.maximum(next_sample - count, first[:, None]), np.minimum(next_sample, stop[:, None])
    before = _average_readings(total, low, high, smooth)
    starts = np.diff(block, prepend=-1) != 0
    since, until = np.zeros_like(rates), np.zeros_like(rates)
    since[1:], until[:-1] = rates[1:] - before[:-1], np.diff(rates, axis=0)
    since[starts] = until[np.append(starts[1:], True)] = 0.0
    return rates, np.where(noise * references.size < HEARD, since, until)


def _accumulate_readings(model: RecordingModel) -> Array:
    """Sum the calibrated readings up to each sample, (samples + 1, 3); single outliers are replaced by the smooth rate."""
    gyro = model.recording.gyro
    smooth = model.rates[np.clip(np.searchsorted(model.t_s, gyro.t_s), 0, model.t_s.size - 1)]
    readings = gyro.rates @ model.G.T + model.bias
    is_outlier = np.abs(readings - smooth) > OUTLIER * gyro.arw / np.sqrt(gyro.sample_s)
    return np.vstack([np.zeros(3), np.cumsum(np.where(is_outlier, smooth, readings), axis=0)])


def _average_readings(total: Array, low: Indices, high: Indices, otherwise: Array) -> Array:
    """Average the readings from `low` to before `high`, (r, 3) each, by running sums; `otherwise` where there are none."""
    low, high, axes = np.broadcast_arrays(low, high, np.arange(3))
    return np.where(high > low, (total[high, axes] - total[low, axes]) / np.maximum(high - low, 1), otherwise)
