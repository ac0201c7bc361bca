"""Flights, gyro streams and idealised sensors for the filters' tests."""

from dataclasses import dataclass

import numpy as np

from gyrocal import GyroParameters, GyroStream, attitude
from gyrocal.sensors import SensorSeries
from simulator.gyro import raw_rates, with_white_noise
from simulator.maneuvers import Profile, Slew, trajectory
from simulator.orbit import CircularOrbit, lvlh_attitude
from simulator.rotation import matrix
from tests.builders import TRUTH

ARW = np.deg2rad(2.6e-4)
ORBIT = CircularOrbit(altitude=350e3, inclination=np.deg2rad(35.0), node=0.7)
NOISE = np.deg2rad(0.02)
X, Y, Z = np.eye(3)


@dataclass(frozen=True)
class VectorModel:
    """Sees inertial directions, each (n, 3), in the body: y = A r for all of them."""

    directions: tuple[np.ndarray, ...]
    name: str = "vectors"
    parameters: tuple[str, ...] = ()

    @property
    def size(self):
        return 3 * len(self.directions)

    def _seen(self, A, rows):
        return [np.einsum("nij,nj->ni", A, r[rows]) for r in self.directions]

    def predict(self, A, rows):
        return np.hstack(self._seen(A, rows))

    def jacobian(self, A, rows):
        return np.concatenate([-attitude.cross_matrix(v) for v in self._seen(A, rows)], axis=1)

    def partials(self, A, rows):
        return np.zeros((len(A), self.size, 0))

    def corrected(self, change):
        return self


@dataclass(frozen=True)
class AttitudeModel:
    """Compares the attitude with measured ones A_obs (n, 3, 3); the measurement to go with it is zero."""

    A_obs: np.ndarray
    name: str = "attitudes"
    size: int = 3
    parameters: tuple[str, ...] = ()

    def predict(self, A, rows):
        return attitude.residual(A, self.A_obs[rows])

    def jacobian(self, A, rows):
        return np.tile(np.eye(3), (len(A), 1, 1))

    def partials(self, A, rows):
        return np.zeros((len(A), 3, 0))

    def corrected(self, change):
        return self


@dataclass(frozen=True)
class Flight:
    """Truth: sample edges t (n + 1,), attitudes A there, mean rates (n, 3) over the samples."""

    profile: Profile
    t: np.ndarray
    A: np.ndarray
    rates: np.ndarray

    def at(self, times):
        """True attitudes at times that are sample edges."""
        return self.A[np.rint(np.asarray(times) / (self.t[1] - self.t[0])).astype(int)]


def fly(slews=(), length=6000.0, sample_s=1.0, orbit=ORBIT):
    """Nadir pointing with slews (axis, angle in degrees, start, duration)."""
    turns = tuple(Slew(np.asarray(axis), np.deg2rad(angle), start, duration, 0.25) for axis, angle, start, duration in slews)
    profile = Profile(orbit, 0.0, length, 0.0, turns)
    t = sample_s * np.arange(round(length / sample_s) + 1)
    path = trajectory(profile, t)
    return Flight(profile, t, matrix(path.quaternions), path.angles / sample_s)


def stream(flight, rng=None, arw=ARW, truth=TRUTH, bias=None, apriori=None):
    """The gyro's samples; bias (n, 3) in place of the constant one."""
    sample_s = flight.t[1] - flight.t[0]
    raw = raw_rates(flight.rates, truth.G, truth.bias if bias is None else bias)
    if rng is not None:
        raw = with_white_noise(rng, raw, arw, np.full(len(raw), sample_s))
    start = apriori or truth
    return GyroStream(flight.t[:-1], raw, sample_s, arw, start.G, start.bias)


def vectors(flight, rng=None, every=10.0, sigma=NOISE, sun_offset=None):
    """The Sun, fixed, and nadir, turning; sun_offset (3,) rad is an alignment error of the sensor that sees the Sun."""
    times = np.arange(0.0, flight.t[-1] + 1e-9, every)
    A = flight.at(times)
    nadir = nadir_directions(times)
    sun = np.tile([0.36, -0.8, 0.48], (len(times), 1))
    model = VectorModel((sun, nadir))
    y = model.predict(A, np.arange(len(times)))
    if sun_offset is not None:
        y[:, :3] = y[:, :3] @ attitude.rotation_matrix(sun_offset).T
    if rng is not None:
        y = y + sigma * rng.standard_normal(y.shape)
    return SensorSeries(model, times, y, np.full(y.shape, sigma))


def nadir_directions(times):
    """Inertial nadir directions (n, 3)."""
    return lvlh_attitude(ORBIT, np.asarray(times))[:, 2]


def parameters_near(rng, sigma_G, sigma_b, truth=TRUTH):
    """A-priori parameters off the truth by random amounts."""
    off = rng.standard_normal(12) * np.repeat([sigma_G, sigma_b], [9, 3])
    return GyroParameters.from_vector(truth.vector + off)


def mean_bounds(size, cases, z=4.0):
    """Bounds of the mean of `cases` χ² values with `size` degrees of freedom."""
    return size - z * np.sqrt(2 * size / cases), size + z * np.sqrt(2 * size / cases)
