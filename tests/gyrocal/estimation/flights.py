"""What estimators are tried on: a flight with its gyro, and a sensor of known directions; the truth is the simulator's."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal import GyroParameters, GyroStream
from gyrocal.attitude import cross_matrix, rotation_matrix
from gyrocal.sensors.series import SensorSeries
from simulator.sensors.gyro import add_white_noise, compute_raw_rates
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def compute_nadir(t: ArrayLike, orbit: CircularOrbit) -> Array:
    """(n, 3) inertial direction to the Earth's centre from an orbit."""
    return np.asarray(compute_lvlh_attitude(orbit, np.asarray(t, dtype=float))[:, 2])


@dataclass(frozen=True)
class Flight:
    """Truth of a flight, and the gyro it is flown with."""

    t: Array
    A: Array
    rates: Array
    truth: GyroParameters
    arw: float
    apriori: GyroParameters

    def gyro(
        self, rng: np.random.Generator | None = None, apriori: GyroParameters | None = None, bias: Array | None = None
    ) -> GyroStream:
        """The samples."""
        sample_s = float(self.t[1] - self.t[0])
        raw = compute_raw_rates(self.rates, self.truth.G, self.truth.bias if bias is None else bias)
        if rng is not None:
            raw = add_white_noise(rng, raw, self.arw, np.full(len(raw), sample_s))
        start = apriori or self.apriori
        return GyroStream(self.t[:-1], raw, sample_s, self.arw, start.G, start.bias)

    def get_attitudes(self, times: ArrayLike) -> Array:
        """True attitudes (k, 3, 3) at times that are sample edges."""
        return np.asarray(self.A[np.rint((np.asarray(times) - self.t[0]) / (self.t[1] - self.t[0])).astype(int)])


@dataclass(frozen=True)
class DirectionSensor:
    """Sees inertial directions, each (n, 3): y = Mᵀ A r of one after the other; M ← exp([m×]) M by its parameters."""

    directions: tuple[Array, ...]
    name: str = "vectors"
    M: Array = field(default_factory=lambda: np.eye(3))
    parameters: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Numbers per measurement."""
        return 3 * len(self.directions)

    @cached_property
    def _inertial(self) -> Array:
        """(n, 3, directions): all of them side by side, which a filter then turns in one product at every measurement."""
        return np.stack(self.directions, axis=-1)

    def _rotate_to_body(self, A: Array, rows: Indices) -> Array:
        """(n, directions, 3)."""
        return np.asarray(np.swapaxes(A @ self._inertial[rows], -1, -2))

    def predict(self, A: Array, rows: Indices) -> Array:
        """As in `gyrocal.sensors.series.SensorModel`."""
        return (self._rotate_to_body(A, rows) @ self.M).reshape(len(A), self.size)

    def jacobian(self, A: Array, rows: Indices) -> Array:
        """As in `gyrocal.sensors.series.SensorModel`."""
        return (-self.M.T @ cross_matrix(self._rotate_to_body(A, rows))).reshape(len(A), self.size, 3)

    def partials(self, A: Array, rows: Indices) -> Array:
        """As in `gyrocal.sensors.series.SensorModel`."""
        if not self.parameters:
            return np.zeros((len(A), self.size, 0))
        return (self.M.T @ cross_matrix(self._rotate_to_body(A, rows))).reshape(len(A), self.size, 3)

    def corrected(self, change: Array) -> "DirectionSensor":
        """As in `gyrocal.sensors.series.SensorModel`."""
        return replace(self, M=rotation_matrix(change) @ self.M) if self.parameters else self

    def simulate_series(self, flight: Flight, t: Array, sigma: float, rng: np.random.Generator | None = None) -> SensorSeries:
        """A series along a flight, by the sensor's own truth."""
        y = self.predict(flight.get_attitudes(t), np.arange(len(t)))
        if rng is not None:
            y = y + sigma * rng.standard_normal(y.shape)
        return SensorSeries(self, t, y, np.full(y.shape, sigma))
