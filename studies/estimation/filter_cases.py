"""Flights with slews, gyro streams and idealised sensors for filters and what runs beside them.

Nadir pointing with analytic slews (`simulator.truth.maneuvers`), a sensor that sees the Sun and nadir with equal noise on each
component, and one timeline of seven slews about all axes, `maneuver_timeline`, with the spans that a calibrator uses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrocal import GyroParameters, GyroStream, attitude
from gyrocal.estimation.full_filter import FullFilterResult, Leg, run_legs, starting_covariance
from gyrocal.estimation.mekf import KalmanFilter
from gyrocal.estimation.onboard import Maneuver, OnBoardCalibrator, replay
from gyrocal.sensors.series import SensorSeries
from simulator import scenario as scenarios
from simulator.sensors.gyro import raw_rates, with_white_noise
from simulator.truth.maneuvers import Profile, Slew, trajectory
from simulator.truth.orbit import CircularOrbit, lvlh_attitude
from simulator.truth.rotation import matrix
from studies.calibration.prepared import true_parameters

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
Turn = tuple[Array, float, float, float]  # axis, angle in degrees, start, duration


TRUTH = true_parameters(scenarios.load("trmm"))
ARW = float(np.deg2rad(2.6e-4))
ORBIT = CircularOrbit(altitude=350e3, inclination=np.deg2rad(35.0), node=0.7)
NOISE = float(np.deg2rad(0.02))
X, Y, Z = np.eye(3)

# Seven slews about all axes, and what a calibrator uses: modes, and spans that hold a slew.
STEP = 2.0  # s
SENSOR = float(np.deg2rad(0.05))
SLEWS: tuple[Turn, ...] = (
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
START = np.repeat([np.deg2rad(0.5), np.deg2rad(1e-3)], 3)  # of attitude and bias
OPENING = np.diag(np.repeat([np.deg2rad(0.5), np.deg2rad(5e-4)], 3) ** 2)
OPENINGS = {start + duration: OPENING for _, _, start, duration in SLEWS}
PRIOR_G, PRIOR_B = 1e-3, float(np.deg2rad(1e-4))
START_SIGMA = float(np.deg2rad(0.5))


@dataclass(frozen=True)
class VectorModel:
    """Sees inertial directions, each (n, 3), in the body: y = A r for all of them."""

    directions: tuple[Array, ...]
    name: str = "vectors"
    parameters: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        """Numbers per measurement."""
        return 3 * len(self.directions)

    def _seen(self, A: Array, rows: Indices) -> list[Array]:
        return [np.asarray(np.einsum("nij,nj->ni", A, r[rows])) for r in self.directions]

    def predict(self, A: Array, rows: Indices) -> Array:
        """As in `gyrocal.sensors.series.SensorModel`."""
        return np.hstack(self._seen(A, rows))

    def jacobian(self, A: Array, rows: Indices) -> Array:
        """As in `gyrocal.sensors.series.SensorModel`."""
        return np.concatenate([-attitude.cross_matrix(v) for v in self._seen(A, rows)], axis=1)

    def partials(self, A: Array, rows: Indices) -> Array:
        """As in `gyrocal.sensors.series.SensorModel`."""
        return np.zeros((len(A), self.size, 0))

    def corrected(self, change: Array) -> "VectorModel":
        """As in `gyrocal.sensors.series.SensorModel`."""
        return self


@dataclass(frozen=True)
class SlewFlight:
    """Truth of a flight with slews.

    Attributes
    ----------
    profile : what is flown
    t : (n + 1,) edges of the gyro samples, s
    A : (n + 1, 3, 3) attitudes there
    rates : (n, 3) mean rates over the samples, rad/s
    """

    profile: Profile
    t: Array
    A: Array
    rates: Array

    def at(self, times: ArrayLike) -> Array:
        """True attitudes at times that are sample edges."""
        return np.asarray(self.A[np.rint(np.asarray(times) / (self.t[1] - self.t[0])).astype(int)])


def fly(slews: Sequence[Turn] = (), length: float = 6000.0, sample_s: float = 1.0, orbit: CircularOrbit = ORBIT) -> SlewFlight:
    """Nadir pointing with slews (axis, angle in degrees, start, duration)."""
    turns = tuple(Slew(np.asarray(axis), np.deg2rad(angle), start, duration, 0.25) for axis, angle, start, duration in slews)
    profile = Profile(orbit, 0.0, length, 0.0, turns)
    t = sample_s * np.arange(round(length / sample_s) + 1, dtype=np.float64)
    path = trajectory(profile, t)
    return SlewFlight(profile, t, matrix(path.quaternions), path.angles / sample_s)


@lru_cache(maxsize=1)
def maneuver_timeline() -> SlewFlight:
    """The flight with all of `SLEWS`."""
    return fly(SLEWS, 14400.0, sample_s=STEP)


def stream(
    flight: SlewFlight,
    rng: np.random.Generator | None = None,
    arw: float = ARW,
    truth: GyroParameters = TRUTH,
    bias: Array | None = None,
    apriori: GyroParameters | None = None,
) -> GyroStream:
    """The gyro's samples; bias (n, 3) rad/s in place of the constant one."""
    sample_s = float(flight.t[1] - flight.t[0])
    raw = raw_rates(flight.rates, truth.G, truth.bias if bias is None else bias)
    if rng is not None:
        raw = with_white_noise(rng, raw, arw, np.full(len(raw), sample_s))
    start = apriori or truth
    return GyroStream(flight.t[:-1], raw, sample_s, arw, start.G, start.bias)


def vectors(
    flight: SlewFlight,
    rng: np.random.Generator | None = None,
    every: float = 10.0,
    sigma: float = NOISE,
    sun_offset: Array | None = None,
) -> SensorSeries:
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


def nadir_directions(times: ArrayLike) -> Array:
    """Inertial nadir directions (n, 3)."""
    return np.asarray(lvlh_attitude(ORBIT, np.asarray(times, dtype=float))[:, 2])


def parameters_near(rng: np.random.Generator, sigma_G: float, sigma_b: float, truth: GyroParameters = TRUTH) -> GyroParameters:
    """A-priori parameters off the truth by random amounts."""
    off = rng.standard_normal(12) * np.repeat([sigma_G, sigma_b], [9, 3])
    return GyroParameters.from_vector(truth.vector + off)


def prior(sigma_G: float = PRIOR_G, sigma_b: float = PRIOR_B) -> Array:
    """(12, 12) covariance that `parameters_near` draws from."""
    return np.diag(np.repeat([sigma_G, sigma_b], [9, 3]) ** 2)


@dataclass(frozen=True)
class OnBoardCase:
    """One pass of the on-board form.

    Attributes
    ----------
    apriori : what both adjust the rates with
    onboard : after the last maneuver
    maneuvers : what each contributed
    gyro : the samples
    """

    apriori: GyroParameters
    onboard: OnBoardCalibrator
    maneuvers: tuple[Maneuver, ...]
    gyro: GyroStream


def on_board_case(
    rng: np.random.Generator,
    openings: Mapping[float, Array] | None = None,
    start: GyroParameters | None = None,
    truth: GyroParameters = TRUTH,
    arw: float = ARW,
    apriori_covariance: Array | None = None,
    through_filter: bool = True,
    reference_sigma: Array | None = None,
) -> OnBoardCase:
    """A pass over the timeline from a-priori errors of 1e-3 in G, or from given parameters.

    Parameters
    ----------
    rng : source of the errors and of the noise
    openings : as of `gyrocal.estimation.onboard.replay`
    start : a-priori parameters, drawn by default
    truth, arw : of the gyro
    apriori_covariance, through_filter, reference_sigma : as of `gyrocal.estimation.onboard.OnBoardCalibrator`
    """
    flight = maneuver_timeline()
    near = parameters_near(rng, PRIOR_G, PRIOR_B, truth)
    apriori = start or near
    gyro, series = stream(flight, rng, arw, truth, apriori=apriori), vectors(flight, rng, sigma=SENSOR)
    off = rng.standard_normal(6) * START
    A = attitude.rotation_matrix(-off[:3]) @ flight.A[0]
    estimator = KalmanFilter(A, GyroParameters(apriori.G, truth.bias + off[3:]), np.diag(START**2), arw)
    onboard = OnBoardCalibrator(estimator, apriori, "all", apriori_covariance, through_filter, reference_sigma)
    return OnBoardCase(apriori, onboard, replay(onboard, gyro, [series], 0.0, SPANS, openings), gyro)


def independent_covariance(one: Maneuver, arw: float = ARW) -> Array:
    """C (3, 3) of a maneuver with the ends and the gyro's noise taken for independent, rad²."""
    return np.asarray(one.P_end + one.R @ one.P_start @ one.R.T + arw**2 * one.elapsed_s * np.eye(3))


def solved_with(apriori: GyroParameters, maneuvers: Sequence[Maneuver], covariances: Sequence[Array]) -> tuple[Array, Array]:
    """Parameters (12,) and covariance (12, 12) from on-board maneuvers with other C (3, 3) each."""
    scale = np.repeat([1e-3, 1e-6], [9, 3])
    W, u = np.zeros((12, 12)), np.zeros(12)
    for one, C in zip(maneuvers, covariances, strict=True):
        H = one.Theta * scale
        W += H.T @ np.linalg.solve(C, H)
        u += H.T @ np.linalg.solve(C, one.residual)
    return apriori.vector - scale * np.linalg.solve(W, u), np.asarray(np.linalg.inv(W) * np.outer(scale, scale))


def timeline_legs() -> list[Leg]:
    """Maneuvers of the timeline, and the modes between them."""
    legs, present = [], 0.0
    for number, (start, stop) in enumerate(SPANS):
        if start > present:
            legs.append(Leg("mode", present, start))
        legs.append(Leg(f"m{number + 1}", start, stop))
        present = stop
    return legs


def full_and_separate(
    rng: np.random.Generator,
    offset_sigma: float = 0.0,
    reference_sigmas: Sequence[float] = (0.0,),
    truth: GyroParameters = TRUTH,
    arw: float = ARW,
) -> tuple[FullFilterResult, list[tuple[GyroParameters, Array]]]:
    """The full filter, and filter and calibrator side by side, on one pass with a random alignment error of the Sun sensor.

    Parameters
    ----------
    offset_sigma : of the alignment error about each axis, rad
    reference_sigmas : stated to the separate scheme for each of its references, rad; a solution for each

    Returns
    -------
    What the full filter found, and parameters and covariance (12, 12) of the separate scheme for each reference_sigma.
    """
    flight = maneuver_timeline()
    apriori = parameters_near(rng, PRIOR_G, PRIOR_B, truth)
    offset = offset_sigma * rng.standard_normal(3)
    gyro, series = stream(flight, rng, arw, truth, apriori=apriori), vectors(flight, rng, sigma=SENSOR, sun_offset=offset)
    A = attitude.rotation_matrix(-START_SIGMA * rng.standard_normal(3)) @ flight.A[0]
    estimator = KalmanFilter(A, apriori, starting_covariance(START_SIGMA, prior()), arw, names="all")
    full = run_legs(estimator, gyro, [series], timeline_legs())
    separate = []
    for sigma in reference_sigmas:
        alone = KalmanFilter(A, apriori, starting_covariance(START_SIGMA, np.eye(3) * np.deg2rad(1e-3) ** 2), arw)
        side = OnBoardCalibrator(alone, apriori, apriori_covariance=prior(), reference_sigma=np.full(3, sigma))
        replay(side, gyro, [series], 0.0, SPANS)
        separate.append(side.solve())
    return full, separate
