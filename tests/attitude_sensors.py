"""A stretch of flight with simple direction sensors, for tests of estimators: truth by the simulator, models written here."""

from dataclasses import dataclass, replace

import numpy as np

from gyrocal import GyroStream
from gyrocal.attitude import cross_matrix, matrix_from_quaternion, quaternion_from_matrix, rotation_matrix
from gyrocal.sensors import SensorSeries
from simulator.gyro import raw_rates, with_white_noise
from simulator.orbit import CircularOrbit, lvlh_attitude
from simulator.truth import integrate

ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=0.7, latitude_argument=0.2)
SUN = np.array([np.cos(0.4), np.sin(0.4) * np.cos(0.41), np.sin(0.4) * np.sin(0.41)])
TRUE_BIAS = np.deg2rad([-1.5e-4, 2.0e-4, 0.8e-4])
ARW = np.deg2rad(2.5e-4)  # rad/sqrt(s)


@dataclass(frozen=True)
class DirectionSensor:
    """Sees directions r: y = O = Mᵀ Nᵀ A r with noise on each of three components; M ← exp([m×]) M by its parameters."""

    name: str
    directions: np.ndarray
    N: np.ndarray
    M: np.ndarray
    size: int = 3
    parameters: tuple[str, ...] = ("m_x", "m_y", "m_z")

    def predict(self, A, rows):
        return np.einsum("ji,kj,nkl,nl->ni", self.M, self.N, A, self.directions[rows])

    def jacobian(self, A, rows):
        v = np.einsum("nkl,nl->nk", A, self.directions[rows])
        return -(self.N @ self.M).T @ cross_matrix(v)

    def partials(self, A, rows):
        u = np.einsum("kj,nkl,nl->nj", self.N, A, self.directions[rows])
        return self.M.T @ cross_matrix(u)

    def corrected(self, change):
        return replace(self, M=rotation_matrix(change) @ self.M)


def sensor(name, directions, M=None, N=None):
    return DirectionSensor(name, directions, np.eye(3) if N is None else N, np.eye(3) if M is None else M)


@dataclass(frozen=True)
class Flight:
    """Truth of a stretch at constant rate, and what draws noise on it."""

    t: np.ndarray  # gyro samples' starts
    sample_s: float
    raw: np.ndarray  # noise-free
    A: np.ndarray  # (n + 1, 3, 3) at the samples' starts and the end
    arw: float
    G: np.ndarray

    def gyro(self, rng=None, bias=None):
        rates = self.raw if rng is None else with_white_noise(rng, self.raw, self.arw, np.full(len(self.t), self.sample_s))
        return GyroStream(self.t, rates, self.sample_s, self.arw, self.G, np.zeros(3) if bias is None else bias)

    def at(self, t):
        """(n, 3, 3) true attitudes at times of the gyro grid."""
        return self.A[np.rint((np.asarray(t) - self.t[0]) / self.sample_s).astype(int)]


def flight(length_s=5490.0, sample_s=2.0, start_s=0.0, arw=ARW, rate=None, start=None, G=None, known_G=None):
    """A constant body rate, that of +x forward by default, from a start attitude, LVLH's by default."""
    edges = start_s + sample_s * np.arange(round(length_s / sample_s) + 1)
    omega = np.array([0.0, -ORBIT.mean_motion, 0.0] if rate is None else rate)
    A0 = lvlh_attitude(ORBIT, edges[:1])[0] if start is None else start
    path = integrate(lambda t: np.tile(omega, (len(t), 1)), edges, quaternion_from_matrix(A0))
    G = np.eye(3) if G is None else G
    raw = raw_rates(path.angles / sample_s, G, TRUE_BIAS)
    return Flight(edges[:-1], sample_s, raw, matrix_from_quaternion(path.quaternions), arw, G if known_G is None else known_G)


def measured(motion, model, t, sigma, visible=None, rng=None):
    """A series of a direction sensor, of the model's own truth."""
    y = model.predict(motion.at(t), np.arange(len(t)))
    if rng is not None:
        y = y + sigma * rng.standard_normal(y.shape)
    used = np.ones(len(t), bool) if visible is None else visible
    return SensorSeries(model, t, np.where(used[:, None], y, np.nan), np.where(used[:, None], sigma, np.inf) * np.ones(3))


def nadir(t):
    """(n, 3) inertial direction to the Earth's centre."""
    return lvlh_attitude(ORBIT, np.asarray(t))[:, 2]


RPO = ORBIT.mean_motion
DIRECTIONS = (np.array([1.0, 0.2, 0.1]) / np.sqrt(1.05), np.array([-0.3, 0.8, 0.5]) / np.sqrt(0.98))


def timeline(parts, G, sample_s=2.0, arw=ARW, start_s=0.0, start=None):
    """A flight of parts at constant rate, ((rate, duration), …), with a gyro of that G whose a-priori G is the identity."""
    edges = start_s + sample_s * np.arange(round(sum(length for _, length in parts) / sample_s) + 1)
    knots = start_s + np.cumsum([length for _, length in parts])
    rates = np.array([rate for rate, _ in parts])
    A0 = np.eye(3) if start is None else start
    path = integrate(
        lambda t: rates[np.minimum(np.searchsorted(knots, t, side="right"), len(rates) - 1)], edges, quaternion_from_matrix(A0)
    )
    raw = raw_rates(path.angles / sample_s, G, TRUE_BIAS)
    return Flight(edges[:-1], sample_s, raw, matrix_from_quaternion(path.quaternions), arw, np.eye(3))


def star_series(motion, low, high, every_s, sigma, rng):
    """Two sensors of fixed directions, always in view, between two times."""
    t = np.arange(low, high + 1e-9, every_s)
    return [
        measured(motion, sensor(f"star {k}", np.tile(direction, (t.size, 1))), t, sigma, rng=rng)
        for k, direction in enumerate(DIRECTIONS)
    ]
