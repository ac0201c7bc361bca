"""scipy's least_squares against the converged calibrator: the same propagation, the same answer, the cost of each."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.streams import Flight, run_packed
from gyrocal import GyroParameters, calibrate
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.problem import Problem

Array = NDArray[np.float64]

SCALE = np.array([1e-4] * 9 + [1e-7] * 3)  # of a parameter's correction, so that finite differences are of like size
SIGMA = np.deg2rad(0.01)  # equal weights: the minimum then does not depend on how a covariance moves with the parameters
AGREEMENT = 1e-9  # in G
DIFF_STEP = 1e-5  # scipy's own step, 1.5e-8, is lost in rounding here and leaves 1e-8 in G; three points cost twice as much


def solvers(flight: Flight) -> dict[str, Callable[[], Array]]:
    """Both solvers of case 0, prepared; each returns the parameters (12,)."""
    initial = flight.initial.vector
    problem = flight.problem
    C = np.tile(np.eye(3) * SIGMA**2, (len(problem.measurements.row), 1, 1))
    weighted = Problem.build(flight.recording, problem.measurements, given=C)
    iterations = len(calibrate(flight.recording, initial=flight.initial, interval_covariance=C).corrections)
    arcs = problem.measurements.arcs
    A_start, A_obs = problem.A[problem.measurements.start], problem.A[problem.measurements.row]

    def residuals(x: Array) -> Array:
        R = run_packed(arcs, GyroParameters.from_vector(initial + x * SCALE)).R
        return np.asarray(accumulation.compute_attitude_residuals(R, A_start, A_obs)).ravel() / SIGMA

    def by_least_squares() -> Array:
        found: Any = least_squares(residuals, np.zeros(12), diff_step=DIFF_STEP)
        return np.asarray(initial + SCALE * found.x)

    return {"least_squares": by_least_squares, "davenport": lambda: np.asarray(weighted.iterate(initial, iterations).x[-1])}


def agreement(solutions: dict[str, Array]) -> float:
    """Largest difference in G between the two; an `AssertionError` if they are not the same solution."""
    difference = float(np.abs(solutions["least_squares"] - solutions["davenport"])[:9].max())
    if not difference < AGREEMENT:
        raise AssertionError(f"least squares and the calibrator differ by {difference:.1e} in G, more than {AGREEMENT:g}")
    return difference
