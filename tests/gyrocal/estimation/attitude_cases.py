"""Flights at piecewise constant rates with the sensors a batch or an alignment is made from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyrocal import GyroParameters
from gyrocal.attitude import matrix_from_quaternion, quaternion_from_matrix
from gyrocal.estimation.alignment import AlignmentResult
from gyrocal.sensors.earth import TRMM_BIASES, EarthModel, EarthSensor
from gyrocal.sensors.series import SensorSeries
from gyrocal.sensors.sun import trmm_sun_sensors
from simulator.sensors import sun as true_sun
from simulator.sensors.horizon import Horizon, compute_orbit_position, compute_penetration
from simulator.truth.integration import integrate
from simulator.truth.orbit import CircularOrbit, compute_lvlh_attitude
from tests.gyrocal.estimation.flights import DirectionSensor, Flight

Array = NDArray[np.float64]
Vector = Sequence[float] | Array

ATTITUDE_CASE_ORBIT = CircularOrbit(350e3, np.deg2rad(35.0), node=0.7, latitude_argument=0.2)
RPO = ATTITUDE_CASE_ORBIT.mean_motion
ORBIT_S, SAMPLE_S = 5490.0, 2.0
ALIGNED = ("m_x", "m_y", "m_z")
TRUE_BIAS = np.deg2rad([-1.5e-4, 2.0e-4, 0.8e-4])
ATTITUDE_CASE_ARW = float(np.deg2rad(2.5e-4))  # rad/sqrt(s)

# R (3), and the rotation nearest to it, as a rotation vector.
M_DSS2 = 1e-3 * np.array([[999.996, -1.98736, -1.99437], [1.99280, 999.994, 2.72920], [1.98893, -2.73316, 999.994]])
M_TRUE = Rotation.from_matrix(M_DSS2).as_matrix()
TRUE_MISALIGNMENT_ANGLES = Rotation.from_matrix(M_TRUE).as_rotvec()
SQUARE = (np.zeros(3), np.zeros(3))  # β heads at right angles


def make_direction_sensor(name: str, directions: Array, M: Array | None = None) -> DirectionSensor:
    """A sensor of one direction (n, 3) whose misalignment may be solved for; it has none by default."""
    return DirectionSensor((directions,), name, np.eye(3) if M is None else M, ALIGNED)


def build_orbit_flight() -> Flight:
    """One orbit +x forward in LVLH."""
    start = compute_lvlh_attitude(ATTITUDE_CASE_ORBIT, np.zeros(1))[0]
    return build_timeline_flight([((0.0, -RPO, 0.0), ORBIT_S)], np.eye(3), start=start)


def build_timeline_flight(
    parts: Sequence[tuple[Vector, float]],
    G: Array,
    arw: float = ATTITUDE_CASE_ARW,
    start: Array | None = None,
    bias: Array = TRUE_BIAS,
) -> Flight:
    """Parts at constant rate, ((rate, duration), …), with a gyro of that G and bias whose a-priori G is the identity."""
    edges = SAMPLE_S * np.arange(round(sum(length for _, length in parts) / SAMPLE_S) + 1, dtype=np.float64)
    knots = np.cumsum([length for _, length in parts])
    rates = np.array([rate for rate, _ in parts], dtype=float)
    A0 = np.eye(3) if start is None else start
    path = integrate(
        lambda t: rates[np.minimum(np.searchsorted(knots, t, side="right"), len(rates) - 1)], edges, quaternion_from_matrix(A0)
    )
    A, known = matrix_from_quaternion(path.quaternions), GyroParameters(np.eye(3), np.zeros(3))
    return Flight(edges, A, path.angles / SAMPLE_S, GyroParameters(G, bias), arw, known)


@dataclass(frozen=True)
class AlignmentOrbit:
    """One orbit +x forward with the Sun 25° on the −Y side, so that both sun sensors see it; measurements every 30 s."""

    motion: Flight
    t: Array
    A: Array
    sun: Array
    position: Array
    angles: Array

    def series(self, rng: np.random.Generator | None = None) -> list[SensorSeries]:
        """DSS-1, DSS-2 and ESA as an estimator gets them, with nominal models."""
        out = []
        pairs = zip(
            true_sun.build_trmm_sensors(misalignments=(np.eye(3), M_TRUE), heads=SQUARE), trmm_sun_sensors(), strict=True
        )
        for true, nominal in pairs:
            counts, visible = true_sun.observe(rng, true, self.A, self.sun)
            out.append(nominal.series(self.t, counts, self.sun, visible))
        esa = EarthSensor(np.zeros(4))
        sigma = esa.sigma
        noise = 0.0 if rng is None else sigma * rng.standard_normal(self.angles.shape)
        model = EarthModel(esa, self.position)
        out.append(SensorSeries(model, self.t, self.angles + TRMM_BIASES + noise, np.full(self.angles.shape, sigma)))
        return out

    def exact(self) -> list[SensorSeries]:
        """The same without noise and without counting, by the models themselves."""
        out = []
        rows = np.arange(self.t.size)
        for one, change in zip(self.series(), (np.zeros(3), TRUE_MISALIGNMENT_ANGLES, TRMM_BIASES), strict=True):
            y = one.model.corrected(change).predict(self.A, rows)
            out.append(SensorSeries(one.model, self.t, y, one.sigma))
        return out


def build_alignment_orbit() -> AlignmentOrbit:
    motion = build_orbit_flight()
    t = np.arange(0, ORBIT_S, 30.0)
    A = motion.get_attitudes(t)
    toward = compute_lvlh_attitude(ATTITUDE_CASE_ORBIT, np.zeros(1))[0].T @ np.array([np.cos(0.436), -np.sin(0.436), 0.0])
    horizon, position = Horizon(), compute_orbit_position(ATTITUDE_CASE_ORBIT, t)
    angles = np.array(
        [
            [compute_penetration(A[k], position[k], q, *horizon.semi_axes, horizon.nominal) for q in range(4)]
            for k in range(t.size)
        ]
    )
    return AlignmentOrbit(motion, t, A, np.tile(toward, (t.size, 1)), position, angles)


def compute_alignment_error(result: AlignmentResult) -> Array:
    """True minus estimate (7,) of DSS-2's angles and ESA's biases, rad."""
    turn = Rotation.from_matrix(M_TRUE @ result.misalignment["DSS-2"].T).as_rotvec()
    return np.concatenate([turn, TRMM_BIASES - result.penetration_biases["ESA"]])
