"""An arc of gyro data through the times of measurements, and measurements linearised along it.

The nodes are the times at which something is measured or wanted; times within a microsecond are one. The gyro, with G held
and the present bias, gives R_n and S_n = R_nᵀ Θ_n of the bias columns from the first node to every other. The attitude is
A_n = R_n C_n with C_n the estimate carried back to the first node; without a walk all C_n are one matrix.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gyrocal.arrays import Array, Indices
from gyrocal.calibration.propagation import Arcs, propagate
from gyrocal.calibration.sampling import cut_at, find_covering_samples
from gyrocal.errors import InputError
from gyrocal.estimation.least_squares import Rows
from gyrocal.recording import GyroStream
from gyrocal.sensors.series import SensorModel, SensorSeries

SAME_TIME_S = 1e-6


@dataclass(frozen=True)
class GyroArc:
    """Gyro steps through all nodes."""

    t: Array  # (N,) nodes, s
    arcs: Arcs  # one arc from the first node, an output at each other
    G: Array  # (3, 3) held
    q: Array  # (N − 1,) sigma per axis of the angle by the rates' white noise between a node and the next, rad

    def propagate_nodes(self, bias: Array) -> tuple[Array, Array]:
        """Propagate R_n and S_n, (N, 3, 3) each, under a bias (3,) rad/s."""
        propagation = propagate(self.arcs, self.G, bias)
        R = np.concatenate([np.eye(3)[None], propagation.R])
        Theta = np.concatenate([np.zeros((1, 3, 3)), propagation.S[:, 3]])
        return R, np.asarray(R.swapaxes(1, 2) @ Theta)

    def find_nodes(self, t: Array) -> Indices:
        """Find the nodes of times that are among them."""
        return np.searchsorted(self.t, np.asarray(t) - SAME_TIME_S)

    def carry_back(self, t_s: float, attitude: Array, bias: Array, models: Sequence[SensorModel]) -> "Estimate":
        """Build the estimate of an attitude (3, 3) at one of the nodes and a bias (3,), without a walk."""
        R = self.propagate_nodes(bias)[0][self.find_nodes(np.array([t_s]))[0]]
        return Estimate(np.tile(R.T @ attitude, (len(self.t), 1, 1)), np.array(bias), tuple(models))


def build_gyro_arc(gyro: GyroStream, times: Array, G: Array, name: str = "of the batch") -> GyroArc:
    """Build the arc through some times.

    An `InputError` if all times are one, or the stream does not cover them or has a gap.

    times: (any,) s, in any order
    G: (3, 3)
    name: of the interval in an error
    """
    ordered = np.sort(np.asarray(times, dtype=float))
    t = ordered[np.diff(ordered, prepend=-np.inf) > SAME_TIME_S]
    if t.size < 2:
        raise InputError("a batch needs measurements at two different times at least, or a bias has no effect")
    low, tags = find_covering_samples(gyro, name, t, gyro.sample_s + 0.5 * gyro.sample_s)
    dt, stretch, ends = cut_at(tags, t)
    arcs = Arcs(gyro.rates, dt, low + stretch, ends[:-1], ends[1:], np.zeros(t.size - 1, dtype=np.intp))
    return GyroArc(t, arcs, np.asarray(G, dtype=float), gyro.arw * np.sqrt(np.diff(t)))


@dataclass(frozen=True)
class Estimate:
    """The state of a batch."""

    C: Array  # (N, 3, 3) attitude at each node, carried back to the first
    bias: Array  # (3,) rad/s
    models: tuple[SensorModel, ...]  # sensor models with their present parameters


@dataclass(frozen=True)
class Columns:
    """Solved-for sensor parameters, after the three of the bias."""

    names: tuple[str, ...]  # (q,) "sensor parameter"
    sensor: Indices  # (q,) series each belongs to
    parameter: Indices  # (q,) its place among the model's

    def find_sensor_columns(self, sensor: int) -> tuple[Indices, Indices]:
        """Find the columns of one series, and their places among its model's parameters."""
        columns = np.flatnonzero(self.sensor == sensor)
        return columns, self.parameter[columns]

    def correct_models(self, models: Sequence[SensorModel], change: Array) -> tuple[SensorModel, ...]:
        """Correct the solved-for parameters of models by change (q,)."""
        out = list(models)
        for k in np.unique(self.sensor):
            columns, places = self.find_sensor_columns(int(k))
            correction = np.zeros(len(out[k].parameters))
            correction[places] = change[columns]
            out[k] = out[k].corrected(correction)
        return tuple(out)


def choose_columns(series: Sequence[SensorSeries], free: Mapping[str, Sequence[str]]) -> Columns:
    """Choose the columns of the freed parameters.

    An `InputError` if two sensors have one name, or a sensor or parameter is unknown.

    free: names of solved-for parameters by name of sensor
    """
    names = [measurements.model.name for measurements in series]
    if len(set(names)) < len(names):
        raise InputError(f"two series have a sensor of one name; sensors: {', '.join(names)}")
    chosen: list[tuple[str, int, int]] = []
    for sensor, parameters in free.items():
        if sensor not in names:
            raise InputError(f"no measurements of sensor {sensor!r}; sensors: {', '.join(names)}")
        k = names.index(sensor)
        known = series[k].model.parameters
        for parameter in parameters:
            if parameter not in known:
                raise InputError(f"{sensor} has no parameter {parameter!r}; known: {', '.join(known) or 'none'}")
            chosen.append((f"{sensor} {parameter}", k, known.index(parameter)))
    return Columns(
        tuple(name for name, _, _ in chosen),
        np.array([k for _, k, _ in chosen], dtype=np.intp),
        np.array([place for _, _, place in chosen], dtype=np.intp),
    )


@dataclass(frozen=True)
class LinearisedMeasurements:
    """Measurements along the arc, linearised about an estimate."""

    rows: Rows  # all used numbers, series by series
    residuals: tuple[Array, ...]  # (n, m) of each series, in its own unit; NaN where a number is not used
    # R, S: (N, 3, 3) as of `GyroArc.propagate_nodes`
    R: Array
    S: Array


def linearise(path: GyroArc, series: Sequence[SensorSeries], estimate: Estimate, solved: Columns) -> LinearisedMeasurements:
    """Linearise measurements at an estimate: residuals and sensitivities, each divided by its sigma."""
    R, S = path.propagate_nodes(estimate.bias)
    A = R @ estimate.C
    q = len(solved.names)
    parts: list[Rows] = []
    residuals = []
    for k, measurements in enumerate(series):
        model = estimate.models[k]
        used = measurements.used
        row = np.flatnonzero(used.any(axis=1))
        node = path.find_nodes(measurements.t[row])
        error = np.full(measurements.y.shape, np.nan)
        error[row] = np.where(used[row], measurements.y[row] - model.predict(A[node], row), np.nan)
        residuals.append(error)
        H = model.jacobian(A[node], row) @ R[node]
        c = np.zeros((*H.shape[:2], 3 + q))
        c[:, :, :3] = -H @ S[node]
        columns, places = solved.find_sensor_columns(k)
        if columns.size:
            c[:, :, 3 + columns] = model.partials(A[node], row)[:, :, places]
        is_used = used[row]
        sigma = measurements.sigma[row][is_used]
        parts.append(
            Rows(
                np.broadcast_to(node[:, None], is_used.shape)[is_used],
                H[is_used] / sigma[:, None],
                c[is_used] / sigma[:, None],
                error[row][is_used] / sigma,
            )
        )
    return LinearisedMeasurements(join_rows(parts), tuple(residuals), R, S)


def join_rows(parts: Sequence[Rows]) -> Rows:
    """Join rows, one part after another."""
    return Rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in Rows.__dataclass_fields__))


def list_measured_times(series: Sequence[SensorSeries]) -> Array:
    """List the times at which a number is to be used, s, series by series."""
    return np.concatenate([measurements.t[measurements.used.any(axis=1)] for measurements in series] or [np.zeros(0)])
