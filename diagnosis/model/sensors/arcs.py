"""Arcs of constant rate of a recording with their sensor measurements, fitted under M0.

M0 at the level of the sensors: the nominal models (`gyrocal.sensors.sun.trmm_sun_sensors`, `gyrocal.sensors.earth` without
biases), white noise of the stated sigma, and a gyro of constant bias and white noise. While the rate is constant an error of G
acts as a bias, R (8), so each arc has an epoch attitude and a bias of its own, six nuisance parameters. What they leave is

    z = H γ_n + c δb + Σ_e X_e a_e + noise,    γ_n = γ_0 + walk of the gyro up to node n

with X_e the derivative of an effect's error by its amplitudes, each row divided by its sigma
(`gyrocal.estimation.least_squares`).

Gram matrices are all that is kept. With the walk's increments as the only prior on the γ_n, their information is
Λ = Jᵀ J + Σ 1/q² D Dᵀ, a band (J spreads the rows H to their nodes), and for any columns M = [c, X, z]

    Mᵀ V⁻¹ M  with the epoch attitude taken out  =  Mᵀ M − (JᵀM)ᵀ Λ⁻¹ (JᵀM)

exactly, V being the covariance of noise and walk; a Schur complement takes out the bias.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from gyrocal.arrays import Array, Indices
from gyrocal.errors import InputError, UnobservableError
from gyrocal.estimation.arc import Estimate, GyroArc, build_gyro_arc, choose_columns, linearise, list_measured_times
from gyrocal.estimation.batch import check_observable, correct_estimate
from gyrocal.estimation.least_squares import ExactLeastSquares, PlainLeastSquares, Rows
from gyrocal.recording import GyroStream, Interval, Recording, find_reference_rows
from gyrocal.recording.sensor_tables import SensorTables
from gyrocal.sensors.earth import EarthModel, EarthSensor
from gyrocal.sensors.series import SensorSeries
from gyrocal.sensors.sun import SunSensor, trmm_sun_sensors
from simulator.effects.sensor import Sightings

STEADY = float(np.deg2rad(0.01))  # rad/s, by which a mean rate over `steady_s` may depart from that of the interval
STEADY_S = 60.0  # s
TIMES = 12  # measurements of the Earth sensor that are worth the six unknowns of an arc
ITERATIONS = 12  # of a fit at most; nominal sensors take three or four
CONVERGED = 1e-4  # last correction, in sigmas
ARW = float(np.deg2rad(2e-6))  # rad/√s, least angle random walk; a smaller one would only cost digits


class MisfitError(InputError):
    """The measurements of an arc do not fit the nominal sensors at all."""


@dataclass(frozen=True)
class Arc:
    """One arc and its measurements."""

    name: str  # of the interval
    number: int  # its place among the arcs
    start: Array  # (3, 3) attitude at the first measurement, roughly
    gyro: GyroStream  # samples of the arc
    series: tuple[SensorSeries, ...]  # of the sensors that saw something; the sun sensors first
    numbers: tuple[int, ...]  # number of the sun sensor of each series, 0 for the Earth sensor
    sightings: Sightings  # what the sensors look at; angles and attitudes are those of M0's fit once there is one

    def vector(self, sun: Array, earth: Array) -> Array:
        """Stack errors (n, 2, …) and (m, 4, …) of both kinds as rows (r, …), each divided by its sigma."""
        parts = []
        for series, number in zip(self.series, self.numbers, strict=True):
            values = earth if number == 0 else sun[self.sightings.sun_sensor == number]
            sigma = series.sigma.reshape(series.sigma.shape + (1,) * (values.ndim - 2))
            parts.append((values / sigma)[series.used])
        return np.concatenate(parts)


@dataclass(frozen=True)
class FittedArc:
    """An arc fitted under M0."""

    arc: Arc  # with the sightings of the fit
    rows: Rows  # measurements, linearised at the fit
    path: GyroArc  # nodes of the gyro
    S: Array  # (N, 3, 3) bias columns carried back to the first node, of `GyroArc.carried`
    # of each series (n, m), measured minus predicted of a plain batch, rad; they hold the gyro's walk
    residuals: tuple[Array, ...]

    @cached_property
    def _exact(self) -> ExactLeastSquares:
        return ExactLeastSquares(self.rows, self.path.q, np.zeros((len(self.path.q), 3)))

    def gram(self, X: Array) -> tuple[Array, int]:
        """Compute products (p + 1, p + 1) of X (r, p) and the residuals, last, with M0's nuisance parameters projected out.

        The second value is the number of degrees of freedom.
        """
        return self._exact.project(np.column_stack([X, self.rows.z])), len(self.rows.z) - 6


def build_arcs(recording: Recording) -> tuple[list[Arc], list[str]]:
    """Build the arcs of a recording that can be used, and notes on the other intervals.

    An `InputError` if there are no raw tables with an ephemeris, or no arc can be used.
    """
    tables = recording.sensors
    if tables is None or (tables.sun is None and tables.earth is None):
        raise InputError("the recording has no raw sensor tables")
    if tables.ephemeris is None:
        raise InputError("there is no ephemeris table, which says where the spacecraft is and the Sun stands")
    arcs: list[Arc] = []
    turning, few = [], []
    for interval in recording.intervals:
        if not is_steady(recording.gyro, interval):
            turning.append(interval.name)
            continue
        arc = build_arc(recording, tables, interval, len(arcs))
        if arc is None:
            few.append(interval.name)
        else:
            arcs.append(arc)
    notes = []
    if turning:
        notes.append(f"Sensor tables are used at constant rate only, not in {_format_names(turning)}")
    if few:
        notes.append(f"Too few sensor measurements, or none of a sun or of the Earth sensor, in {_format_names(few)}")
    if not arcs:
        raise InputError(f"no arc of the recording can be used for the sensors; {'; '.join(notes)}")
    return arcs, notes


def _format_names(names: list[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")


def is_steady(gyro: GyroStream, interval: Interval) -> bool:
    """Find out whether the rates of an interval are constant, but for noise."""
    inside = (gyro.t_s >= interval.start_s) & (gyro.t_s < interval.stop_s)
    rates, length = gyro.rates[inside], max(1, round(STEADY_S / gyro.sample_s))
    if len(rates) < 2 * length:
        return False
    means = rates[: len(rates) // length * length].reshape(-1, length, 3).mean(axis=1)
    return bool(np.abs(means - means.mean(axis=0)).max() < STEADY)


def build_arc(recording: Recording, tables: SensorTables, interval: Interval, number: int = 0) -> Arc | None:
    """Build the arc of an interval; None with too few measurements, or none of a sun or of the Earth sensor."""
    assert tables.ephemeris is not None
    low, high = interval.start_s, interval.stop_s
    series, numbers = [], []
    sun_sensor, sun_angles = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    for sensor_number, sensor in enumerate(trmm_sun_sensors(), start=1):
        t, counts = tables.sun.select_sensor(sensor_number) if tables.sun is not None else (np.zeros(0), np.zeros((0, 2)))
        inside = (t >= low) & (t <= high)
        if not inside.any():
            continue
        measured = sensor.series(t[inside], counts[inside], tables.ephemeris.sun[tables.ephemeris.rows(t[inside])])
        if not measured.used.any():
            continue
        measured = replace(measured, sigma=_compute_sun_sigma(sensor, counts[inside], measured.sigma))
        series.append(measured)
        numbers.append(sensor_number)
        sun_sensor.append(np.full(measured.t.size, sensor_number))
        sun_angles.append(measured.y)
    if not series or tables.earth is None:
        return None
    inside = (tables.earth.t_s >= low) & (tables.earth.t_s <= high)
    t, used = tables.earth.t_s[inside], tables.earth.used[inside]
    if t.size < TIMES or not used.any():
        return None
    place = tables.ephemeris.rows(t)
    earth = EarthSensor(np.zeros(4))
    position, sun = tables.ephemeris.position[place], tables.ephemeris.sun[place]
    angles = np.where(used, tables.earth.angles[inside], np.nan)
    series.append(SensorSeries(EarthModel(earth, position), t, angles, np.where(used, earth.sigma, np.inf)))
    numbers.append(0)
    rows = find_reference_rows(recording.attitudes.t_s, interval)
    start = Rotation.from_quat(recording.attitudes.quaternions[rows[0]]).inv().as_matrix()
    gyro = recording.gyro
    kept = (gyro.t_s > low - 1.5 * gyro.sample_s) & (gyro.t_s < high)
    first = float(list_measured_times(series).min())
    gyro = replace(gyro, t_s=gyro.t_s[kept], rates=gyro.rates[kept], arw=max(gyro.arw, ARW))
    if first - float(recording.attitudes.t_s[rows[0]]) > 1e-6:
        carried = build_gyro_arc(gyro, np.array([recording.attitudes.t_s[rows[0]], first]), gyro.apriori_G)
        start = carried.propagate_nodes(gyro.apriori_bias)[0][-1] @ start
    sightings = Sightings(
        sun_sensor=np.concatenate(sun_sensor),
        sun_angles=np.concatenate(sun_angles),
        t_s=t,
        arc=np.full(t.size, number, dtype=np.intp),
        A=np.tile(start, (t.size, 1, 1)),
        position=position,
        sun=sun,
        used=used,
    )
    return Arc(interval.name, number, start, gyro, tuple(series), tuple(numbers), sightings)


def _compute_sun_sigma(sensor: SunSensor, counts: Array, sigma: Array) -> Array:
    """Compute the sigmas (n, 2) with the quantisation of each count; the sensor's sigma includes that at the boresight."""
    steps = (sensor.angles(counts + 0.5) - sensor.angles(counts - 0.5)) ** 2
    boresight = np.full((1, 2), float(2**13))
    largest = (sensor.angles(boresight + 0.5) - sensor.angles(boresight - 0.5)) ** 2
    return np.asarray(np.where(np.isfinite(sigma), np.sqrt(sensor.sigma**2 + (steps - largest) / 12), sigma))


def fit_arc(arc: Arc, sun_error: Array | None = None, earth_error: Array | None = None) -> FittedArc:
    """Fit epoch attitude and bias of an arc under M0, with errors (n, 2) and (m, 4), rad, subtracted from the measurements.

    An `UnobservableError` if the arc does not determine both, a `MisfitError` if the fit does not converge.
    """
    series = arc.series
    if sun_error is not None and earth_error is not None:
        errors = [earth_error if number == 0 else sun_error[arc.sightings.sun_sensor == number] for number in arc.numbers]
        series = tuple(
            replace(measurements, y=measurements.y - error) for measurements, error in zip(series, errors, strict=True)
        )
    path = build_gyro_arc(arc.gyro, list_measured_times(series), arc.gyro.apriori_G)
    solved = choose_columns(series, {})
    estimate = Estimate(
        np.tile(arc.start, (len(path.t), 1, 1)), arc.gyro.apriori_bias, tuple(measurements.model for measurements in series)
    )
    for iteration in range(ITERATIONS):
        state = linearise(path, series, estimate, solved)
        if not np.isfinite(state.rows.z).all():
            break
        if iteration == 0:
            check_observable(state.rows, arc.start, ())
        gamma, delta, length = PlainLeastSquares(state.rows, len(path.t)).step()
        estimate = correct_estimate(estimate, gamma, delta, solved)
        if length < CONVERGED:
            state = linearise(path, series, estimate, solved)
            A = state.R @ estimate.C
            return FittedArc(_update_sightings(arc, series, path, A), state.rows, path, state.S, state.residuals)
    raise MisfitError(f"{arc.name}: the sensors' measurements do not fit the nominal models at all")


def _update_sightings(arc: Arc, series: tuple[SensorSeries, ...], path: GyroArc, A: Array) -> Arc:
    """Update the sightings of an arc by those of a fit."""
    angles = [
        measurements.model.predict(A[_find_nearest_nodes(path, measurements.t)], np.arange(measurements.t.size))
        for measurements, number in zip(series, arc.numbers, strict=True)
        if number > 0
    ]
    nodes = _find_nearest_nodes(path, arc.sightings.t_s)
    return replace(arc, sightings=replace(arc.sightings, sun_angles=np.concatenate(angles), A=A[nodes]))


def _find_nearest_nodes(path: GyroArc, t: Array) -> Indices:
    """Find the nodes at some times; the next node where a time has none, since no measurement is used then."""
    return np.minimum(path.find_nodes(t), len(path.t) - 1)


def fit_arcs(arcs: list[Arc]) -> tuple[list[FittedArc], list[str], list[str]]:
    """Fit all arcs; also notes on arcs that cannot be fitted, and on those that do not fit the nominal sensors at all.

    If no arc can be fitted, a `MisfitError` where the measurements of one or more do not fit the nominal sensors at all, else
    an `InputError`.
    """
    fits: list[FittedArc] = []
    notes: list[str] = []
    misfits: list[str] = []
    for arc in arcs:
        try:
            fits.append(fit_arc(arc))
        except MisfitError as error:
            misfits.append(str(error))
        except (UnobservableError, InputError) as error:
            notes.append(f"{arc.name} is left out of the sensors' diagnosis: {error}")
    if not fits:
        raise (MisfitError if misfits else InputError)(
            f"no arc can be fitted under the nominal sensors; {[*misfits, *notes][0]}"
        )
    return fits, notes, misfits
