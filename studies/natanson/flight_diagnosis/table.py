"""What the paper prints of a calibration, and what the simulator says of it: tables, baselines, residuals and Θ.

The last digits printed are those of Table 2, Table 3, R (9) and, for the intervals' times, Table 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from gyrocal import attitude, propagate
from gyrocal.calibration import normal_equations as accumulation
from gyrocal.calibration.sampling import prepare_measurements
from simulator import scenario as scenarios
from simulator.scenario import IntervalSection, Scenario
from studies.natanson import flight, flight_gap

Array = NDArray[np.float64]

# Last digits printed: Table 2 in deg; Table 3 before launch (its scale factors of one are exact), R (9); G, then b in deg/s.
CELL_DEG = 1e-3
CLOCK_S = 15.0  # Table 1's times are multiples of it
MILLIDEGREE = np.deg2rad(1e-3)
INITIAL_DIGITS = np.array(
    [0, MILLIDEGREE, MILLIDEGREE, MILLIDEGREE, 0, MILLIDEGREE, MILLIDEGREE, MILLIDEGREE, 0, *np.deg2rad([1e-6, 1e-6, 1e-6])]
)
PUBLISHED_DIGITS = np.array([1e-6, 1e-6, 1e-9, 1e-9, 1e-5, 1e-7, 1e-9, 1e-7, 1e-5, *np.deg2rad([1e-10, 1e-10, 1e-11])])


@dataclass(frozen=True)
class ResidualTable:
    """What the paper prints of a calibration."""

    before: Array  # before, after: (6, 3) residuals at 0.5 s before and after calibration, deg
    after: Array
    coarser: Array  # (2, 6, 3) residuals before calibration at 1 and 2 s, deg
    published: Array  # (12,) the calibration; G, and b in rad/s


def read_flight_residual_table() -> ResidualTable:
    """The flight's."""
    coarser = np.array([flight.read_published_residuals("prelaunch", step) for step in flight.FLIGHT_STEPS_S[1:]])
    return ResidualTable(
        flight.read_published_residuals("prelaunch"),
        flight.read_published_residuals("calibrated"),
        coarser,
        flight.read_published_calibration().vector,
    )


def round_to_digits(values: Array, digits: Array | float) -> Array:
    """Values as printed; digits of zero are exact."""
    digits = np.broadcast_to(digits, np.shape(values))
    return np.asarray(np.where(digits > 0, np.round(values / np.where(digits > 0, digits, 1.0)) * digits, values))


@dataclass(frozen=True)
class Baseline:
    """What the simulator is told."""

    name: str  # for people
    scenario: Scenario  # motion and noise
    noise_factor: float = 1.0  # on the scenario's noise
    done: frozenset[str] = frozenset()  # effects that it was made wrong by on purpose

    def variances(self) -> tuple[Array, Array]:
        """(6,) of a residual, and its gyro part a²T, deg²."""
        T = np.array([interval.stop_s - interval.start_s for interval in self.scenario.interval])
        gyro = self.noise_factor**2 * self.scenario.gyro.arw_deg_per_sqrt_s**2 * T
        sigma = np.mean(np.square(self.scenario.reference.sigma_deg))
        return gyro + 2 * self.noise_factor**2 * sigma, gyro


def load_present_baseline() -> Baseline:
    """The simulator as it is."""
    return Baseline("as assumed", scenarios.load("trmm"))


@cache
def load_coarse_trmm() -> Scenario:
    """The scenario every prediction takes orbit and sampling from, at coarse samples."""
    return scenarios.override(scenarios.load("trmm"), {"gyro.sample_s": flight_gap.COARSE_SAMPLE_S})


def simulate_residuals(sections: Sequence[IntervalSection]) -> tuple[Array, Array]:
    """Noise-free residuals (n, 3) deg and Θ (n, 3, 12) deg per unit, of R (9) as truth and Table 3 as a priori.

    The intervals are simulated one after the other, wherever they were: on a circular orbit their residuals do not depend on
    when they begin.
    """
    longest = max(section.stop_s - section.start_s for section in sections) + 1000.0
    moved = tuple(
        section.model_copy(
            update={"name": f"v{i}", "start_s": i * longest, "stop_s": i * longest + section.stop_s - section.start_s}
        )
        for i, section in enumerate(sections)
    )
    scenario = load_coarse_trmm().model_copy(update={"interval": moved})
    initial, recording = flight.read_published_parameters("prelaunch"), flight_gap.simulate_without_noise(scenario)
    prepared = prepare_measurements(recording)
    passed = propagate(prepared.arcs, initial.G, initial.bias)
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    theta = accumulation.compute_attitude_residuals(passed.R, A[prepared.start], A[prepared.row])
    return np.rad2deg(theta), np.rad2deg(passed.Theta)


@lru_cache(maxsize=1024)
def simulate_residuals_cached(sections: tuple[IntervalSection, ...]) -> tuple[Array, Array]:
    """Simulate residuals of the same intervals once; models about other timings use them again."""
    theta, Theta = simulate_residuals(sections)
    theta.setflags(write=False)
    Theta.setflags(write=False)
    return theta, Theta


def simulate_interval_residuals(section: IntervalSection) -> tuple[Array, Array]:
    """`simulate_residuals` of one interval, kept: (3,) and (3, 12)."""
    theta, Theta = simulate_residuals_cached((section,))
    return theta[0], Theta[0]


def simulate_each_interval(sections: Sequence[IntervalSection]) -> tuple[Array, Array]:
    """`simulate_residuals` of intervals each of which is kept by itself."""
    theta, Theta = zip(*map(simulate_interval_residuals, sections), strict=True)
    return np.array(theta), np.array(Theta)


def reverse_slews(section: IntervalSection) -> IntervalSection:
    """The interval with its slews the other way round: yaws reversed; −y forward becomes +y forward, of the other rate."""
    return section.model_copy(update={"slew": tuple(s.model_copy(update={"angle_deg": -s.angle_deg}) for s in section.slew)})
