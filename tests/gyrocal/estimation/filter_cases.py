"""Flights with slews, gyro streams and idealised sensors for filters and what runs beside them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gyrocal import GyroParameters, GyroStream, attitude
from gyrocal.estimation.full_filter import FullFilterResult, Leg, build_starting_covariance, run_legs
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import Maneuver, OnBoardCalibrator, replay
from gyrocal.sensors.series import SensorSeries
from simulator.truth.maneuvers import Profile, Slew, integrate_trajectory
from simulator.truth.orbit import CircularOrbit
from simulator.truth.rotation import convert_to_matrix
from tests.builders import TRUTH
from tests.gyrocal.estimation.flights import DirectionSensor, Flight, compute_nadir

Array = NDArray[np.float64]
Turn = tuple[Array, float, float, float]  # axis, angle in degrees, start, duration


FILTER_CASE_ARW = float(np.deg2rad(2.6e-4))
FILTER_CASE_ORBIT = CircularOrbit(altitude=350e3, inclination=np.deg2rad(35.0), node=0.7)
FILTER_CASE_SIGMA = float(np.deg2rad(0.02))
X, Y, Z = np.eye(3)

# Seven slews about all axes, and what a calibrator uses: modes, and spans that hold a slew.
FILTER_CASE_SAMPLE_S = 2.0  # s
DIRECTION_SENSOR_SIGMA = float(np.deg2rad(0.05))
FILTER_CASE_SLEWS: tuple[Turn, ...] = (
    (Z, 180.0, 3000.0, 700.0),
    (Z, -90.0, 6300.0, 350.0),
    (Z, 90.0, 8200.0, 350.0),
    (Y, -60.0, 9700.0, 500.0),
    (X, 40.0, 11000.0, 300.0),
    (X, -40.0, 11800.0, 300.0),
    (Z, -180.0, 13000.0, 700.0),
)
SPANS = (
    (700.0, 2700.0),
    (2800.0, 4200.0),
    (4400.0, 6100.0),
    (6200.0, 9000.0),
    (9500.0, 10700.0),
    (10900.0, 11500.0),
    (11700.0, 12500.0),
    (12800.0, 14200.0),
)
FILTER_START_SIGMA = np.repeat([np.deg2rad(0.5), np.deg2rad(1e-3)], 3)  # of attitude and bias
OPENING = np.diag(np.repeat([np.deg2rad(0.5), np.deg2rad(5e-4)], 3) ** 2)
OPENINGS = {start + duration: OPENING for _, _, start, duration in FILTER_CASE_SLEWS}
PRIOR_G, PRIOR_B = 1e-3, float(np.deg2rad(1e-4))
START_SIGMA = float(np.deg2rad(0.5))


def fly(
    slews: Sequence[Turn] = (), length: float = 6000.0, sample_s: float = 1.0, orbit: CircularOrbit = FILTER_CASE_ORBIT
) -> Flight:
    """Nadir pointing with slews (axis, angle in degrees, start, duration), and the gyro of the TRMM scenario."""
    turns = tuple(Slew(np.asarray(axis), np.deg2rad(angle), start, duration, 0.25) for axis, angle, start, duration in slews)
    t = sample_s * np.arange(round(length / sample_s) + 1, dtype=np.float64)
    path = integrate_trajectory(Profile(orbit, 0.0, length, 0.0, turns), t)
    return Flight(t, convert_to_matrix(path.quaternions), path.angles / sample_s, TRUTH, FILTER_CASE_ARW, TRUTH)


@lru_cache(maxsize=1)
def build_maneuver_timeline() -> Flight:
    """The flight with all of `FILTER_CASE_SLEWS`."""
    return fly(FILTER_CASE_SLEWS, 14400.0, sample_s=FILTER_CASE_SAMPLE_S)


def simulate_direction_series(
    flight: Flight,
    rng: np.random.Generator | None = None,
    every: float = 10.0,
    sigma: float = FILTER_CASE_SIGMA,
) -> SensorSeries:
    """The Sun, fixed, and nadir, turning."""
    times = np.arange(0.0, flight.t[-1] + 1e-9, every)
    sun = np.tile([0.36, -0.8, 0.48], (len(times), 1))
    return DirectionSensor((sun, compute_nadir(times, FILTER_CASE_ORBIT))).simulate_series(flight, times, sigma, rng)


def draw_apriori_parameters(rng: np.random.Generator, sigma_G: float, sigma_b: float) -> GyroParameters:
    """A-priori parameters off the truth by random amounts."""
    off = rng.standard_normal(12) * np.repeat([sigma_G, sigma_b], [9, 3])
    return GyroParameters.from_vector(TRUTH.vector + off)


def build_apriori_covariance(sigma_G: float = PRIOR_G, sigma_b: float = PRIOR_B) -> Array:
    """(12, 12) covariance that `draw_apriori_parameters` draws from."""
    return np.diag(np.repeat([sigma_G, sigma_b], [9, 3]) ** 2)


@dataclass(frozen=True)
class OnBoardCase:
    """One pass of the on-board form."""

    apriori: GyroParameters
    onboard: OnBoardCalibrator
    maneuvers: tuple[Maneuver, ...]
    gyro: GyroStream


def run_onboard_case(
    rng: np.random.Generator,
    openings: Mapping[float, Array] | None = None,
    apriori_covariance: Array | None = None,
    through_filter: bool = True,
    reference_sigma: Array | None = None,
) -> OnBoardCase:
    """A pass over the timeline from a-priori errors of 1e-3 in G."""
    flight = build_maneuver_timeline()
    apriori = draw_apriori_parameters(rng, PRIOR_G, PRIOR_B)
    gyro, series = flight.gyro(rng, apriori), simulate_direction_series(flight, rng, sigma=DIRECTION_SENSOR_SIGMA)
    off = rng.standard_normal(6) * FILTER_START_SIGMA
    A = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    estimator = KalmanFilter(
        A, GyroParameters(apriori.G, TRUTH.bias + off[3:]), np.diag(FILTER_START_SIGMA**2), FILTER_CASE_ARW
    )
    onboard = OnBoardCalibrator(estimator, apriori, "all", apriori_covariance, through_filter, reference_sigma)
    return OnBoardCase(apriori, onboard, replay(onboard, gyro, [series], 0.0, SPANS, openings), gyro)


def compute_independent_covariance(one: Maneuver, arw: float = FILTER_CASE_ARW) -> Array:
    """C (3, 3) of a maneuver with the ends and the gyro's noise taken for independent, rad²."""
    return np.asarray(one.P_end + one.R @ one.P_start @ one.R.T + arw**2 * one.elapsed_s * np.eye(3))


def solve_with_covariances(
    apriori: GyroParameters, maneuvers: Sequence[Maneuver], covariances: Sequence[Array]
) -> tuple[Array, Array]:
    """Parameters (12,) and covariance (12, 12) from on-board maneuvers with other C (3, 3) each."""
    scale = np.repeat([1e-3, 1e-6], [9, 3])
    W, u = np.zeros((12, 12)), np.zeros(12)
    for one, C in zip(maneuvers, covariances, strict=True):
        H = one.Theta * scale
        W += H.T @ np.linalg.solve(C, H)
        u += H.T @ np.linalg.solve(C, one.residual)
    return apriori.vector - scale * np.linalg.solve(W, u), np.asarray(np.linalg.inv(W) * np.outer(scale, scale))


def list_timeline_legs() -> list[Leg]:
    """Maneuvers of the timeline, and the modes between them."""
    legs, present = [], 0.0
    for number, (start, stop) in enumerate(SPANS):
        if start > present:
            legs.append(Leg("mode", present, start))
        legs.append(Leg(f"m{number + 1}", start, stop))
        present = stop
    return legs


def run_full_and_separate(rng: np.random.Generator) -> tuple[FullFilterResult, tuple[GyroParameters, Array]]:
    """The full filter, and filter and calibrator side by side, on one pass."""
    flight, P0 = build_maneuver_timeline(), build_apriori_covariance()
    apriori = draw_apriori_parameters(rng, PRIOR_G, PRIOR_B)
    gyro = flight.gyro(rng, apriori)
    series = simulate_direction_series(flight, rng, sigma=DIRECTION_SENSOR_SIGMA)
    A = attitude.rotation_matrix(-START_SIGMA * rng.standard_normal(3)) @ flight.A[0]
    estimator = KalmanFilter(A, apriori, build_starting_covariance(START_SIGMA, P0), FILTER_CASE_ARW, names="all")
    full = run_legs(estimator, gyro, [series], list_timeline_legs())
    start = build_starting_covariance(START_SIGMA, np.eye(3) * np.deg2rad(1e-3) ** 2)
    alone = KalmanFilter(A, apriori, start, FILTER_CASE_ARW)
    side = OnBoardCalibrator(alone, apriori, apriori_covariance=P0)
    replay(side, gyro, [series], 0.0, SPANS)
    return full, side.solve()
