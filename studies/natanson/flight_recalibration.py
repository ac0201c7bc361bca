"""The flight's own 18 residuals calibrated, at each of N's steps: simulated motion, and nothing else of the simulator.

The observed attitudes at the intervals' ends are set so that the residuals under the pre-launch parameters of N Table 3 are the
flight's of N Table 2. Then the calibrator solves for the twelve parameters with equal weights, in gyro space as N did. What
comes out is set beside what N found: parameters beside N Table 3, residuals beside the calibrated columns of N Table 2. The
true parameters hardly take part: those the raw rates are made with turn the motion by a thousandth of itself, and the
pre-launch ones in place of R (9) move no residual by more than 0.0007 deg. The flight's noise is in its 18 numbers, on both
sides alike.

N Table 5's second iteration is the second-order term of the first one, and so tells which parameters N iterated in. Printed are
corrections to b and to G⁻¹; their signs are those of x_old − x_new, where the first iteration's are of x_new − x_old (all
twelve agree in gyro space if they are turned, and none of the larger ones as printed). In (G, b) there is no term of the
correction to G times that to b, so that its corrections to b nearly vanish. In gyro space that term is c = −G⁻¹ b.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from gyrocal import NAMES, Attitudes, CalibrationResult, GyroParameters, Recording, attitude, calibrate
from gyrocal.arrays import Array
from gyrocal.calibration.gyro_space import Parametrisation
from gyrocal.calibration.propagation import propagate
from gyrocal.calibration.sampling import prepare_measurements
from simulator.scenario import Scenario
from studies.natanson import flight, flight_gap
from studies.natanson.paper_forms import count_digit_changes

CALIBRATION_SPACES: dict[str, Parametrisation] = {"gyro_space": "gyro", "gain_space": "gain"}
BIAS_STEP_S = 1.0  # step of the corrections to b of N Table 5's first iteration
PRINTED = np.array([1e6] * 9 + [1e8] * 3)  # units of N Table 5's second iteration: 1e-6 in G, 1e-8 deg/s in b
EQUAL = np.deg2rad(0.01) ** 2 * np.tile(np.eye(3), (6, 1, 1))  # weights: their size does not matter
DOUBTED = (2.0, 2, 2)  # step, interval and axis of the sign that N Table 4 contradicts


def set_final_attitudes(recording: Recording, cells_deg: Array, step_s: float) -> Recording:
    """The recording with its intervals' last attitudes set so that the pre-launch residuals are these, (6, 3) deg."""
    initial = flight.read_published_parameters("prelaunch")
    prepared = prepare_measurements(recording, step_s, "skip")
    R = propagate(prepared.arcs, initial.G, initial.bias).R
    A = attitude.matrix_from_quaternion(recording.attitudes.quaternions)
    A_obs = A.copy()
    for j, theta in enumerate(np.deg2rad(cells_deg)):
        A_obs[prepared.row[j]] = attitude.rotation_matrix(theta) @ R[j] @ A[prepared.start[j]]
    quaternions = attitude.quaternion_from_matrix(A_obs)
    return replace(recording, attitudes=Attitudes(recording.attitudes.t_s, quaternions, recording.attitudes.sigma))


def calibrate_like_paper(
    recording: Recording, step_s: float, iterations: int, space: Parametrisation = "gyro"
) -> CalibrationResult:
    """Calibrate from the pre-launch parameters by skipping samples, with equal weights."""
    initial = flight.read_published_parameters("prelaunch")
    sampling: Any = {"step_s": step_s, "resampling": "skip"}
    return calibrate(
        recording, initial=initial, iterations=iterations, parametrisation=space, interval_covariance=EQUAL, **sampling
    )


# ---- one iteration, beside N's ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class StepCalibration:
    """The flight's residuals at one step, calibrated."""

    step_s: float  # of it
    recording: Recording  # the simulated motion with the flight's residuals
    results: tuple[CalibrationResult, CalibrationResult]  # what comes out of one iteration, and of two

    @property
    def after(self) -> tuple[Array, Array]:
        """(6, 3) residuals after one iteration, and after two, deg."""
        names = [f"after_{name}_deg" for name in flight.ROTATIONS]
        first, second = (result.residuals[names].to_numpy() for result in self.results)
        return first, second

    @property
    def flown(self) -> Array:
        """(6, 3) the flight's, the doubtful sign of N Table 2 as N Table 4 asks for, deg."""
        cells = flight.read_published_residuals("calibrated", self.step_s).copy()
        if self.step_s == DOUBTED[0]:
            cells[DOUBTED[1:]] *= -1
        return cells

    @property
    def published(self) -> GyroParameters:
        """Values that N found at this step; those of R (9) at the finest, which have more digits."""
        if self.step_s == flight.FLIGHT_STEPS_S[0]:
            return flight.read_published_calibration()
        return flight.read_published_parameters("calibrated", self.step_s)

    def gradient(self) -> Array:
        """(12,) the flown residuals along Θ's column of each parameter of (G, b), deg; zero at a least-squares solution."""
        prepared = prepare_measurements(self.recording, self.step_s, "skip")
        Theta = propagate(prepared.arcs, self.published.G, self.published.bias).Theta.reshape(18, 12)
        return np.asarray((Theta / np.linalg.norm(Theta, axis=0)).T @ self.flown.ravel())


def calibrate_each_step(scenario: Scenario) -> list[StepCalibration]:
    """The flight's residuals at each of N's steps, calibrated with the scenario's motion."""
    recording, out = flight_gap.simulate_without_noise(scenario), []
    for step_s in flight.FLIGHT_STEPS_S:
        own = set_final_attitudes(recording, flight.read_published_residuals("prelaunch", step_s), step_s)
        out.append(StepCalibration(step_s, own, (calibrate_like_paper(own, step_s, 1), calibrate_like_paper(own, step_s, 2))))
    return out


def compare_residuals_by_step(found: list[StepCalibration]) -> pd.DataFrame:
    """A row per step: how far the residuals after are from the flight's, and whether N's solution is that of least squares."""
    rows = []
    for step in found:
        printed = flight.read_published_residuals("calibrated", step.step_s)
        gradient = np.abs(step.gradient())
        rows.append(
            {
                "step_s": step.step_s,
                "rms_difference_deg": float(flight.compute_rms((step.after[0] - step.flown).ravel())),
                "as_printed_deg": float(flight.compute_rms((step.after[0] - printed).ravel())),
                "steepest": NAMES[int(gradient.argmax())],
                "gradient_deg": gradient.max(),
            }
        )
    return pd.DataFrame(rows)


def count_changed_digits(found: list[StepCalibration]) -> dict[str, dict[str, int]]:
    """Count, for each step, the printed digits of N Tables 2 and 4 that the second iteration changes, N's criterion."""
    counts = {f"{step.step_s:g}": count_digit_changes(*(theta[None] for theta in step.after)) for step in found}
    return {step: {"table2": int(table2[0]), "table4": int(table4[0])} for step, (table2, table4) in counts.items()}


# ---- the second iteration of N Table 5 -------------------------------------------------------------------------------------


def compute_second_correction(result: CalibrationResult) -> Array:
    """(12,) what the second iteration takes from G⁻¹ and b, x_old − x_new, in units of N Table 5: 1e-6 and 1e-8 deg/s."""
    change = result.corrections[1]
    G = result.G - change.G
    inverse = np.linalg.inv(G) - np.linalg.inv(result.G)
    return np.concatenate([inverse.ravel(), -np.rad2deg(change.bias)]) * PRINTED


def build_second_iteration_table(scenario: Scenario) -> pd.DataFrame:
    """N Table 5's twelve cells of the second iteration beside those found from the flight's residuals, in both spaces.

    At 1 s, whose corrections to b they are.
    """
    recording = flight_gap.simulate_without_noise(scenario)
    own = set_final_attitudes(recording, flight.read_published_residuals("prelaunch", BIAS_STEP_S), BIAS_STEP_S)
    G, bias = flight.read_published_corrections(2)
    table = pd.DataFrame(
        {
            "quantity": ["G_inverse"] * 9 + ["bias"] * 3,
            "row": [*np.repeat(list("xyz"), 3), *[""] * 3],
            "gyro": list("xyz") * 4,
            "unit": ["1e-6"] * 9 + ["1e-8 deg/s"] * 3,
            "flight": np.concatenate([G.ravel(), bias]) * PRINTED,
        }
    )
    for name, space in CALIBRATION_SPACES.items():
        table[name] = compute_second_correction(calibrate_like_paper(own, BIAS_STEP_S, 2, space))
    return table


def score_second_iteration(table: pd.DataFrame) -> dict[str, float]:
    """Compute the correlation of each space's prediction with N Table 5's second iteration."""
    return {name: float(np.corrcoef(table[name], table["flight"])[0, 1]) for name in CALIBRATION_SPACES}
